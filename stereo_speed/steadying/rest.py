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
# From so many pairs over such a time on, the rest is known well enough to measure with.
_SETTLED_PAIRS, _SETTLED_S = 20, 3.0
# The rest is averaged over so many pairs, and such a time; a later mean follows slow changes.
REST_PAIRS, _REST_S = 100, 10.0
_SWAYED_PAIRS = 2  # a rig that has swayed in fewer is taken to stand still
_FEWEST = 7  # fewest poses that tell how alike they are
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
        self._prior2 = prior_std_rad ** 2
        self._square: Array = np.full(3, self._prior2)  # sum of squares about the mean
        self._product = 0.0  # sum of products of successive deviations, over all angles
        self._last_rad: Array = np.zeros(3)  # last deviation
        self._swayed = self._averaged = 0
        self._first_ns = self._last_ns = 0

    def add(self, angles_rad: Array, stamp_ns: int, swayed: bool) -> None:
        """
        Add the pose in another pair.

        :param angles_rad: (3,) the pose.
        :param swayed: whether it differs from that in the reference, rather than being it.
        """
        self._first_ns, self._last_ns = self._first_ns if self.pairs else stamp_ns, stamp_ns
        within = not self.is_averaged
        self.pairs += 1
        self._averaged += within
        self._swayed += swayed
        off = angles_rad - self.mean_rad
        self.mean_rad = self.mean_rad + off / (self.pairs if within else REST_PAIRS)
        off = angles_rad - self.mean_rad
        if within:
            self._square = self._square + off ** 2
            self._product += float(off @ self._last_rad)
            self._last_rad = off

    @property
    def moves(self) -> bool:
        """Return whether the rig sways at all."""
        return self._swayed >= _SWAYED_PAIRS

    @property
    def is_settled(self) -> bool:
        """Return whether the poses suffice to measure with."""
        return self._has(_SETTLED_PAIRS, _SETTLED_S)

    @property
    def is_averaged(self) -> bool:
        """Return whether the mean has all the poses that it is averaged over."""
        return self._has(REST_PAIRS, _REST_S)

    def _has(self, pairs: int, time_s: float) -> bool:
        return self.pairs >= pairs and self._last_ns - self._first_ns >= time_s * 1e9

    @property
    def standing(self) -> tuple[Array, Array]:
        """
        Return the mean (3,) and its covariance (3, 3), rad and rad^2; zeros if the rig stands.

        A mast sways slower than pairs come, so successive poses are alike: of a first-order
        autoregression, ``n / (1 + r) * (1 - r)`` of ``n`` poses count as independent.  Deviations
        are from the poses' own mean, which makes them too small, and the correlation ``r`` too low
        by about ``(1 + 4 r) / n`` (Kendall 1954).  Poses that are all alike hardly tell how far
        the rig sways, so that as much of what was assumed beforehand counts.
        """
        if not self.moves:
            return np.zeros(3), np.zeros((3, 3))
        n = self._averaged
        alike = _MOST_ALIKE * n
        if n >= _FEWEST:
            r = (n * self._product / float(self._square.sum()) + 1) / (n - 4)
            r = min(max(r, 0.0), _MOST_CORRELATED)
            alike = min((1 + r) / (1 - r), alike)
        return self.mean_rad, np.diag(
            self._square / n * alike / (n - alike) + (alike / n) ** 2 * self._prior2)
