# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The rest of a swaying rig: its mean pose, about which it sways, and how well that is known.

Angles are pan, tilt and roll from the rig's pose in a reference pair, rad.
"""
from __future__ import annotations

import numpy as np

from ..core.records import Array

STILL_PAIRS = 5  # a rig that has not swayed in its first pairs is at rest in them
SETTLED_PAIRS = 20  # pairs from which the rest is known well enough to measure with
REST_PAIRS = 100  # pairs that the rest is averaged over; a later mean follows slow changes
_MOST_CORRELATED = 0.98  # bound of the correlation of successive poses
_MOST_ALIKE = 0.8  # largest share of the poses that counts as one


class Rest:
    """
    Averages the poses of a rig.

    :param prior_std_rad: 1-sigma of the sway as assumed before any is seen, rad; it weighs as
        much as one pair.
    """

    def __init__(self, prior_std_rad: float) -> None:
        self.pairs = 0
        self.mean_rad: Array = np.zeros(3)
        self.moves = False  # whether the rig sways at all
        self._square: Array = np.full(3, prior_std_rad ** 2)  # sum of squares about the mean
        self._product = 0.0  # sum of products of successive deviations, over all angles
        self._last_rad: Array = np.zeros(3)  # last deviation

    def add(self, angles_rad: Array) -> None:
        """Add the pose (3,) in another pair."""
        self.pairs += 1
        off = angles_rad - self.mean_rad
        self.mean_rad = self.mean_rad + off / min(self.pairs, REST_PAIRS)
        off = angles_rad - self.mean_rad
        if self.pairs <= REST_PAIRS:
            self._square = self._square + off ** 2
            self._product += float(off @ self._last_rad)
            self._last_rad = off

    @property
    def covariance_rad2(self) -> Array:
        """
        Return the covariance (3, 3) of the mean; zero for a rig that does not sway, rad^2.

        A mast sways slower than pairs come, so successive poses are alike: of a first-order
        autoregression, ``n / (1 + r) * (1 - r)`` of ``n`` poses count as independent.  Deviations
        are from the poses' own mean, which makes them too small, and the correlation ``r`` too low
        by about ``(1 + 4 r) / n`` (Kendall 1954).
        """
        if not self.moves:
            return np.zeros((3, 3))
        n = max(min(self.pairs, REST_PAIRS), 1)
        r = self._product / float(self._square.sum())
        r = min(max((n * r + 1) / (n - 4), 0.0), _MOST_CORRELATED) if n >= SETTLED_PAIRS else 0.0
        alike = min((1 + r) / (1 - r), _MOST_ALIKE * n)  # successive poses that count as one
        return np.diag(self._square / n * alike / (n - alike))
