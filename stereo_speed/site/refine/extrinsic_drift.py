# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Whether the right camera has turned since its calibration.

Each of its three angles either stands as calibrated, within a small tolerance, or has moved by
anything up to some hundredths of a degree. The eight combinations are weighed by how well they
predict the angles that the lines and the background show. What remains uncertain, that of the
decision included, goes into the covariance.
"""
from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ..extras import CALIBRATED_STD_DEG
from ...core.records import Array

MOVED_STD_DEG = 0.05
MOVED_PROBABILITY = 0.05  # of each angle, beforehand
MOST_TURN_DEG = 0.3  # more than that is another rig: calibrate again


@dataclass(frozen=True, eq=False)
class Turn:
    """
    What is known of the turn of the right camera.

    :param shown_rad: (3,) pan, tilt and roll that the images show by themselves.
    :param shown_std_rad: (3,) 1-sigma of them.
    :param moved_probability: that any of them is more than the tolerance.
    :param turn_rad: (3,) to be corrected; zeros unless it is more likely than not.
    :param covariance_rad2: (3, 3) of the truth about ``turn_rad``.
    """

    shown_rad: Array
    shown_std_rad: Array
    moved_probability: float
    turn_rad: Array
    covariance_rad2: Array

    @property
    def moved(self) -> bool:
        """Say whether something is to be corrected."""
        return bool(np.any(self.turn_rad))


def judged(shown_rad: Array, covariance_rad2: Array,
           calibrated_std_deg: float = CALIBRATED_STD_DEG) -> Turn:
    """
    Decide whether the camera has turned, and about which axes.

    :param shown_rad: (3,) pan, tilt and roll as the images show them.
    :param covariance_rad2: (3, 3) of them, without any prior.
    :param calibrated_std_deg: 1-sigma of an angle as calibrated.
    """
    still, far = np.radians(calibrated_std_deg)**2, np.radians(MOVED_STD_DEG)**2
    branches = []
    for moved in product((False, True), repeat=3):
        prior = np.diag(np.where(moved, far, still))
        total = covariance_rad2 + prior
        gain = prior @ np.linalg.inv(total)
        score = -0.5 * (shown_rad @ np.linalg.solve(total, shown_rad)
                        + np.linalg.slogdet(total)[1])
        score += sum(np.log(MOVED_PROBABILITY if m else 1 - MOVED_PROBABILITY) for m in moved)
        branches.append((score, moved, gain @ shown_rad, prior - gain @ prior))
    weight = np.exp(np.array([b[0] for b in branches]) - max(b[0] for b in branches))
    weight /= weight.sum()
    best = branches[int(np.argmax(weight))]
    # an axis that stands as calibrated is left alone
    turn = np.where(best[1], best[2], 0.0)
    spread = [w * (b[3] + np.outer(b[2] - turn, b[2] - turn)) for w, b in zip(weight, branches)]
    return Turn(np.asarray(shown_rad), np.sqrt(np.diag(covariance_rad2)), float(1 - weight[0]),
                turn, np.sum(spread, axis=0))
