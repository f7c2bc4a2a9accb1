# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What is known of a pass from its images: mean and covariance of all states."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np
from numpy.typing import NDArray

from .onset import Unnoticed
from ..core.config import TrackerConfig
from ..core.records import Array


@dataclass(frozen=True, eq=False)
class Posterior:
    """
    Gaussian posterior of a whole pass.

    :param first_ns: stamp of the first pair, ns.
    :param stamps_s: (n,) time of each pair since the first, s.
    :param mean: (n, 4) s, a, b in m and the speed along the path in m/s.
    :param covariance: (4 n, 4 n) of the rows of ``mean`` in order.
    :param lateral_mps: (n,) rates at which the front moves across the path, m/s.
    :param heading_rad: (n,) headings against the path.
    :param path_scale: (n,) metres that the front travels per metre of the path.
    :param cross_ncc: (n,) left-right NCC of each observation.
    :param unoccluded: (n,) whether the observation shows the whole front; others do not count.
    :param seen: (n,) whether it shows the vehicle at all.
    :param speed_rate_std: random walk of the speed, r.m.s. of those of the motion models by their
        weights, m/s/sqrt(s).
    :param unnoticed: by how much the newest speed may be wrong while braking does not show; None
        where that is not known.
    """

    first_ns: int
    stamps_s: Array
    mean: Array
    covariance: Array
    lateral_mps: Array
    heading_rad: Array
    path_scale: Array
    cross_ncc: Array
    unoccluded: NDArray[np.bool_]
    seen: NDArray[np.bool_]
    speed_rate_std: float
    unnoticed: Optional[Unnoticed] = None

    @property
    def newest_ns(self) -> int:
        """Return the stamp of the newest pair, ns."""
        return self.first_ns + round(float(self.stamps_s[-1]) * 1e9)

    def at(self, k: int) -> tuple[Array, Array]:
        """Return the mean (4,) and the covariance (4, 4) of pair ``k``."""
        n = range(len(self.mean))[k]
        block = slice(4 * n, 4 * n + 4)
        return self.mean[n], self.covariance[block, block]

    def ahead(self, after_s: float, config: TrackerConfig) -> tuple[Array, Array]:
        """
        Return the mean (4,) and the covariance (4, 4) some time after the newest pair.

        The vehicle goes on as it does from the last pair but one to the last: it may brake.  What
        it may do otherwise is the random walk of its speed and its drift (eq. 24, 27).

        :param after_s: time since the newest of two pairs or more, s.
        :param config: rates of the random walks.
        """
        share = after_s / float(self.stamps_s[-1] - self.stamps_s[-2])
        goes: Array = np.zeros((4, 8))  # by the last two states
        goes[:, 4:] = np.eye(4)
        goes[0, [3, 7]] = after_s * np.array([-0.5 * share, 1 + 0.5 * share])
        goes[3, [3, 7]] = -share, 1 + share
        return gone_on((self.mean[-2:].ravel(), self.covariance[-8:, -8:]), goes, after_s,
                       float(self.lateral_mps[-1]), walks(after_s, self.speed_rate_std, config))

    def unnoticed_mps(self, stamp_ns: int) -> float:
        """Return by how much the speed may be wrong at a stamp while braking does not show."""
        after_s = max((stamp_ns - self.newest_ns) * 1e-9, 0.0)
        return 0.0 if self.unnoticed is None else self.unnoticed.after(after_s)

    def ground_speeds(self) -> Array:
        """Return the speeds (n,) over ground, m/s."""
        along = self.mean[:, 3] * self.path_scale
        return np.asarray(np.copysign(np.hypot(along, self.lateral_mps), along))

    def ground_ratio(self) -> Array:
        """Return the ground speeds (n,) per speed along the path, which carry over its sigma."""
        along = self.mean[:, 3]
        return np.asarray(self.ground_speeds() / np.where(along == 0, 1.0, along))


def gone_on(known: tuple[Array, Array], goes: Array, after_s: float, lateral_mps: float,
            strays: Array) -> tuple[Array, Array]:
    """
    Return the mean (4,) and the covariance (4, 4) of s, a, b, v some time later.

    :param known: mean (n,) and covariance (n, n) of what it goes on from.
    :param goes: (4, n) how it does.
    :param after_s: time until then, s.
    :param lateral_mps: rate at which the vehicle crosses its path, m/s.
    :param strays: (4, 4) covariance of what it may do otherwise.
    """
    mean = goes @ known[0]
    mean[1] += after_s * lateral_mps
    return mean, goes @ known[1] @ goes.T + strays


def walks(after_s: float, speed_rate_std: float, config: TrackerConfig, parts: float = 3.0
          ) -> Array:
    """
    Return the covariance (4, 4) of the random walks of s, a, b, v over a time (eq. 24-27).

    :param after_s: the time, s.
    :param speed_rate_std: random walk of the speed, m/s/sqrt(s).
    :param config: rates of the others.
    :param parts: the way varies by one in so many of (time times change of speed) squared: three
        where the speed walks all the time, four where it changes once, evenly.
    """
    walk = speed_rate_std ** 2 * after_s
    strays = np.diag([walk * after_s ** 2 / parts, config.drift_across_std_m ** 2 * after_s,
                      config.drift_up_std_m ** 2 * after_s, walk])
    strays[0, 3] = strays[3, 0] = walk * after_s / 2
    return strays


@dataclass(frozen=True, eq=False)
class SolvedPass:
    """
    A pass solved from all its keyframes.

    :param posterior: of all of them.
    :param occluded_ns: stamps of those that show the front occluded in part.
    :param exact_stamps: (n, n) covariance of the speeds, were the stamps exact.
    :param exact_path: (n, n) the same, were the path's heading exact as well.
    """

    posterior: Posterior
    occluded_ns: frozenset[int]
    exact_stamps: Array
    exact_path: Array
