# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A filter for the rotation of the right camera relative to the left one, from pair to pair.

It has two motion models: the camera stays, apart from slow creeping, or it has turned to any
angle. Both are weighed by how well they predict the next pair, and their mixture is approximated
by a Gaussian. All pairs are compared with one reference and share its noise, which averaging over
pairs does not reduce; the error of the reference is therefore estimated along with the rotation.
"""
from __future__ import annotations

import math

import numpy as np

from .config import SteadyingConfig
from ..core.records import Array

_REFERENCE_SHARE = 0.5  # share of the reference in the variance of a comparison of two images


class DriftFilter:
    """
    Estimates pan, tilt and roll of the right camera since the first pair.

    ``turns`` counts sudden changes of the angles.

    :param config: parameters.
    """

    def __init__(self, config: SteadyingConfig) -> None:
        self.config, self.turns = config, 0
        # State: the angles (3), then the error that the reference adds to them in every pair (3).
        self._mean: Array = np.zeros(6)
        self._covariance: Array = np.zeros((6, 6))
        self.renew()

    def renew(self) -> None:
        """Expect that the following pairs are compared with another reference."""
        self._is_new = True

    @property
    def mean_rad(self) -> Array:
        """Return the estimated angles (3,), rad."""
        return self._mean[:3]

    @property
    def covariance_rad2(self) -> Array:
        """Return the covariance (3, 3) of the angles, including systematic errors, rad^2."""
        return np.asarray(
            self._covariance[:3, :3] + np.radians(self.config.drift_floor_deg) ** 2 * np.eye(3))

    @property
    def turned(self) -> bool:
        """Return whether the camera has significantly turned."""
        significance = float(self.mean_rad @ np.linalg.solve(self.covariance_rad2, self.mean_rad))
        return significance > self.config.drift_sigmas ** 2

    @property
    def corrected_rad(self) -> Array:
        """Return the angles (3,) to correct, rad; zeros unless the camera has turned."""
        return self.mean_rad if self.turned else np.zeros(3)

    @property
    def too_far(self) -> bool:
        """Return whether the camera has turned by more than may be corrected."""
        return bool(np.degrees(np.abs(self.mean_rad)).max() > self.config.most_drift_deg)

    def update(self, seen_rad: Array, covariance_rad2: Array, pairs: int = 1) -> None:
        """
        Update the filter with the measurement of one pair.

        :param seen_rad: (3,) measured pan, tilt and roll relative to the reference, rad.
        :param covariance_rad2: (3, 3) their covariance by the noise of the pair and of the
            reference, rad^2.
        :param pairs: number of pairs since the previous measurement.
        """
        c = self.config
        if self._is_new:
            self._forget_reference(_REFERENCE_SHARE * covariance_rad2)
        pair_noise = (1 - _REFERENCE_SHARE) * covariance_rad2
        predicted = self._covariance + _of_angles(pairs * np.radians(c.drift_rate_deg) ** 2)
        stay_probability = (1 - c.drift_probability) ** pairs
        scores, posteriors = [], []
        for share, before in ((stay_probability, predicted), (
                1 - stay_probability, predicted + _of_angles(np.radians(c.drift_std_deg) ** 2))):
            joint = before[:, :3] + before[:, 3:]  # covariance of the state with a measurement
            spread = joint[:3] + joint[3:] + pair_noise  # covariance of the innovation
            innovation = seen_rad - self._mean[:3] - self._mean[3:]
            gain = np.linalg.solve(spread, joint.T).T
            scores.append((math.log(share) if share else -math.inf) - 0.5 * float(
                innovation @ np.linalg.solve(spread, innovation) + np.linalg.slogdet(spread)[1]))
            posteriors.append((self._mean + gain @ innovation, before - gain @ joint.T))
        weights = np.exp(np.array(scores) - max(scores))
        weights /= weights.sum()
        self.turns += int(weights[1] > 0.5)
        mean = sum(w * m for w, (m, _) in zip(weights, posteriors))
        self._covariance = np.sum([w * (p + np.outer(m - mean, m - mean))
                                   for w, (m, p) in zip(weights, posteriors)], axis=0)
        self._mean = np.asarray(mean)

    def _forget_reference(self, covariance_rad2: Array) -> None:
        """Reset the error of the reference to its prior."""
        self._mean = np.concatenate([self._mean[:3], np.zeros(3)])
        covariance = np.zeros((6, 6))
        covariance[:3, :3], covariance[3:, 3:] = self._covariance[:3, :3], covariance_rad2
        self._covariance, self._is_new = covariance, False


def _of_angles(variance_rad2: float) -> Array:
    """Return the process noise (6, 6) of the angles, with none for the reference."""
    return variance_rad2 * np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
