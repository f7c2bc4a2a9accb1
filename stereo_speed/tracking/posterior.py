# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The posterior of a pass: mean and covariance of all its states."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np
from numpy.typing import NDArray

from .onset import Unnoticed
from ..core.records import Array
from ..core.tracker_config import TrackerConfig


@dataclass(frozen=True, eq=False)
class Posterior:
    """
    Gaussian posterior of a whole pass.

    :param first_ns: stamp of the first pair, ns.
    :param stamps_s: (n,) time of each pair since the first, s.
    :param mean: (n, 4) s, a, b in m and the speed along the path in m/s.
    :param covariance: (4 n, 4 n) of the states, in the order of ``mean.ravel()``.
    :param lateral_mps: (n,) rates at which the front moves across the path, m/s.
    :param heading_rad: (n,) headings against the path.
    :param path_scale: (n,) metres that the front travels per metre of the path.
    :param cross_ncc: (n,) left-right NCC of each observation.
    :param unoccluded: (n,) whether the observation shows the whole front; others do not count.
    :param seen: (n,) whether the observation shows the vehicle at all.
    :param speed_rate_std: random walk of the speed, weighted r.m.s. of those of the motion models,
        m/s/sqrt(s).
    :param unnoticed: errors of the newest speed due to braking that does not show yet; None where
        they are not computed.
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
        Return the mean (4,) and the covariance (4, 4) predicted for a time after the newest pair.

        The speed continues to change as between the last two pairs, because the vehicle may be
        braking.  The random walk of the speed and the drift are added (eq. 24, 27).

        :param after_s: time since the newest of two or more pairs, s.
        :param config: rates of the random walks.
        """
        share = after_s / float(self.stamps_s[-1] - self.stamps_s[-2])
        goes: Array = np.zeros((4, 8))  # transition from the last two states
        goes[:, 4:] = np.eye(4)
        goes[0, [3, 7]] = after_s * np.array([-0.5 * share, 1 + 0.5 * share])
        goes[3, [3, 7]] = -share, 1 + share
        return gone_on((self.mean[-2:].ravel(), self.covariance[-8:, -8:]), goes, after_s,
                       float(self.lateral_mps[-1]), walks(after_s, self.speed_rate_std, config))

    def unnoticed_mps(self, stamp_ns: int) -> float:
        """Return the error of the speed at a stamp from braking that does not show yet, m/s."""
        after_s = max((stamp_ns - self.newest_ns) * 1e-9, 0.0)
        return 0.0 if self.unnoticed is None else self.unnoticed.after(after_s)

    def ground_speeds(self) -> Array:
        """Return the speeds (n,) over ground, m/s."""
        along = self.mean[:, 3] * self.path_scale
        return np.asarray(np.copysign(np.hypot(along, self.lateral_mps), along))

    def ground_stds(self) -> Array:
        """
        Return the 1-sigmas (n,) of the speeds over ground, m/s.

        That of the path's direction is taken for all of it: the speed across the path is small
        unless a vehicle creeps, and then its direction is not known.
        """
        return np.asarray(self.path_scale * np.sqrt(np.diag(self.covariance)[3::4]))


def gone_on(known: tuple[Array, Array], goes: Array, after_s: float, lateral_mps: float,
            strays: Array) -> tuple[Array, Array]:
    """
    Return the mean (4,) and the covariance (4, 4) of s, a, b, v predicted for a later time.

    :param known: mean (n,) and covariance (n, n) to predict from.
    :param goes: (4, n) transition matrix.
    :param after_s: time to predict over, s.
    :param lateral_mps: rate at which the vehicle crosses its path, m/s.
    :param strays: (4, 4) covariance of the process noise.
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
    :param config: rates of the other random walks.
    :param parts: ratio of (time times change of speed) squared to the variance of the distance: 3
        for a random walk of the speed, 4 for one change at a constant rate.
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

    :param posterior: posterior of all keyframes.
    :param occluded_ns: stamps of the pairs in which the front is partly occluded.
    :param exact_stamps: (n, n) covariance of the speeds if stamps were exact.
    :param exact_path: (n, n) the same if the path's heading were exact as well.
    :param clock_set: whether the clock of the stamps seems to have been set forward in it.
    :param scatter_px: r.m.s. of the systematic scatter of its disparities, px.
    """

    posterior: Posterior
    occluded_ns: frozenset[int]
    exact_stamps: Array
    exact_path: Array
    clock_set: bool = False
    scatter_px: float = 0.0
