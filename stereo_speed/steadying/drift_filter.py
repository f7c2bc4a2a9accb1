# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The rotation of the right camera against the left one, from pair to pair.

A filter with two ways to go on: it stays, but for a slow creeping, or it has turned to anywhere.
Both are weighed by how well they foretell the next pair, and their mixture is taken for Gaussian.
"""
from __future__ import annotations

import math

import numpy as np

from .config import SteadyingConfig
from ..core.records import Array


class DriftFilter:
    """
    Follows pan, tilt and roll of the right camera since the first pair.

    ``mean_rad`` (3,) is what they are, ``turns`` how often they have changed at once.

    :param config: parameters.
    """

    def __init__(self, config: SteadyingConfig) -> None:
        self.config, self.turns = config, 0
        self.mean_rad: Array = np.zeros(3)
        self._covariance: Array = np.zeros((3, 3))

    @property
    def covariance_rad2(self) -> Array:
        """Return the covariance (3, 3) of the angles, systematic errors among it."""
        return np.asarray(
            self._covariance + np.radians(self.config.drift_floor_deg) ** 2 * np.eye(3))

    @property
    def turned(self) -> bool:
        """Return whether the camera has turned beyond doubt."""
        off = float(self.mean_rad @ np.linalg.solve(self.covariance_rad2, self.mean_rad))
        return off > self.config.drift_sigmas ** 2

    @property
    def corrected_rad(self) -> Array:
        """Return the angles (3,) to be corrected: zeros unless the camera has turned."""
        return self.mean_rad if self.turned else np.zeros(3)

    @property
    def too_far(self) -> bool:
        """Return whether it has turned by more than can be corrected."""
        return bool(np.degrees(np.abs(self.mean_rad)).max() > self.config.most_drift_deg)

    def update(self, seen_rad: Array, covariance_rad2: Array, pairs: int = 1) -> None:
        """
        Take in what one pair shows.

        :param seen_rad: (3,) pan, tilt and roll.
        :param covariance_rad2: (3, 3) of them.
        :param pairs: number of pairs since the one taken in before.
        """
        c, eye = self.config, np.eye(3)
        stays = self._covariance + pairs * np.radians(c.drift_rate_deg) ** 2 * eye
        unturned = (1 - c.drift_probability) ** pairs
        scores, answers = [], []
        for share, before in ((unturned, stays),
                              (1 - unturned, stays + np.radians(c.drift_std_deg) ** 2 * eye)):
            total, off = before + covariance_rad2, seen_rad - self.mean_rad
            gain = np.linalg.solve(total, before).T
            scores.append((math.log(share) if share else -math.inf) - 0.5 * float(
                off @ np.linalg.solve(total, off) + np.linalg.slogdet(total)[1]))
            answers.append((self.mean_rad + gain @ off, before - gain @ before))
        weights = np.exp(np.array(scores) - max(scores))
        weights /= weights.sum()
        self.turns += int(weights[1] > 0.5)
        mean = sum(w * m for w, (m, _) in zip(weights, answers))
        self._covariance = np.sum([w * (p + np.outer(m - mean, m - mean))
                                   for w, (m, p) in zip(weights, answers)], axis=0)
        self.mean_rad = np.asarray(mean)
