# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Whether the right camera has rotated since its calibration.

Each of its three angles either stands as calibrated, within a small tolerance, or has moved by
anything up to some hundredths of a degree. The eight combinations are weighed by how well they
predict the angles that the lines and the background show. What remains uncertain, that of the
decision included, goes into the covariance.
"""
from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from .config import RefineConfig
from ...core.records import Array
from ...road.problem import RoadPrior


@dataclass(frozen=True, eq=False)
class Drift:
    """
    What is known of the rotation of the right camera.

    :param shown_rad: (3,) pan, tilt and roll that the images show by themselves.
    :param shown_std_rad: (3,) 1-sigma of them.
    :param moved_probability: that any of them is more than the tolerance.
    :param drift_rad: (3,) to be corrected; zeros unless it is more likely than not.
    :param covariance_rad2: (3, 3) of the truth about ``drift_rad``.
    """

    shown_rad: Array
    shown_std_rad: Array
    moved_probability: float
    drift_rad: Array
    covariance_rad2: Array

    @property
    def moved(self) -> bool:
        """Return whether something is to be corrected."""
        return bool(np.any(self.drift_rad))

    @property
    def std_rad(self) -> Array:
        """Return the 1-sigmas (3,) of the truth about ``drift_rad``."""
        return np.asarray(np.sqrt(np.diag(self.covariance_rad2)))


class _Branch(NamedTuple):
    """
    One combination of angles that have moved and angles that have not.

    :param score: logarithm of its probability, but for a constant.
    :param moved: which angles have.
    :param mean_rad: (3,) the angles in that case.
    :param covariance_rad2: (3, 3) of them.
    """

    score: float
    moved: tuple[bool, ...]
    mean_rad: Array
    covariance_rad2: Array


def decide_drift(shown_rad: Array, covariance_rad2: Array, config: RefineConfig = RefineConfig(),
                 prior: RoadPrior = RoadPrior()) -> Drift:
    """
    Decide whether the camera has rotated, and about which axes.

    :param shown_rad: (3,) pan, tilt and roll as the images show them.
    :param covariance_rad2: (3, 3) of them, without any prior.
    :param config: how often and how far cameras move.
    :param prior: how well angles stay as calibrated.
    """
    branches = [_branch(shown_rad, covariance_rad2, moved, config, prior)
                for moved in product((False, True), repeat=3)]
    scores = np.array([b.score for b in branches])
    weight = np.exp(scores - scores.max())
    weight /= weight.sum()
    best = branches[int(np.argmax(weight))]
    # an axis that stands as calibrated is left alone
    drift = np.where(best.moved, best.mean_rad, 0.0)
    spread = [w * (b.covariance_rad2 + np.outer(b.mean_rad - drift, b.mean_rad - drift))
              for w, b in zip(weight, branches)]
    return Drift(np.asarray(shown_rad), np.sqrt(np.diag(covariance_rad2)), float(1 - weight[0]),
                 drift, np.sum(spread, axis=0))


def _branch(shown_rad: Array, covariance_rad2: Array, moved: tuple[bool, ...],
            config: RefineConfig, prior: RoadPrior) -> _Branch:
    """Weigh one combination."""
    still, far = np.radians(prior.calibrated_std_deg)**2, np.radians(config.moved_std_deg)**2
    before = np.diag(np.where(moved, far, still))
    total = covariance_rad2 + before
    gain = before @ np.linalg.inv(total)
    score = -0.5 * (shown_rad @ np.linalg.solve(total, shown_rad) + np.linalg.slogdet(total)[1])
    chance = config.moved_probability
    score += sum(np.log(chance if m else 1 - chance) for m in moved)
    return _Branch(float(score), moved, gain @ shown_rad, before - gain @ before)
