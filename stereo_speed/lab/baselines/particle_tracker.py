# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Tracking of a front by particles: the loop that both particle filters of the baselines share.

Predict, weight, resample (2012, eq. 1-3); report mean and covariance.  The state, its motion and
its likelihood are defined by each filter.
"""
from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from .baseline import Baseline, Estimate, OwnSettings
from .constant_velocity import directional_rate, Gaussian, transition
from ...core.records import Array, StereoPair
from ...estimation.particle_filter import weigh
from ...estimation.weights import (
    DegenerateWeightsError, mean_and_covariance, normalise_log_weights)
from ...tracking.initialise import Placement
from ...tracking.protocol import TrackStart

_LEAST_SPREAD = 1e-6  # least variance of collapsed particles, m^2 or m^2/s^2


class ParticleTracker(Baseline[OwnSettings]):
    """
    Track a front by particles; see the module's docstring and :class:`Baseline`.

    Subclasses fill ``states`` (N, D).
    """

    states: Array
    freedom: int  # number of independent unknowns of a state

    def __init__(self, start: TrackStart, placed: Placement, settings: OwnSettings) -> None:
        super().__init__(start, placed, settings)
        self.log_weights = np.zeros(self.config.particles)
        self._dt_s = 0.0

    # -- implemented by each filter --------------------------------------------------------

    @abstractmethod
    def _move(self, dt_s: float) -> None:
        """Move the particles, with noise."""

    @abstractmethod
    def _score(self, pair: StereoPair) -> Array:
        """Return the (N,) log-likelihood of a pair; -inf where the front would be invisible."""

    @abstractmethod
    def _accept(self, pair: StereoPair) -> bool:
        """Return whether the mean state shows the vehicle; if so, adapt to it."""

    @abstractmethod
    def _quads(self, states: Array, lag_s: float = 0.0) -> tuple[Array, Array]:
        """Return (N, 4, 2) corners in the left view, and in the right one ``lag_s`` later, px."""

    @abstractmethod
    def _axes(self, states: Array) -> Array:
        """Return the (N, 3, 3) axes: heading, left and up."""

    @abstractmethod
    def _centres(self, states: Array) -> Array:
        """Return the (N, 3) centres of the front, m."""

    @abstractmethod
    def _velocities(self, states: Array) -> Array:
        """Return the (N, 3) velocities of the centres, m/s."""

    # -- the loop ---------------------------------------------------------------------------

    def _predict(self, dt_s: float) -> None:
        """Predict (2012, eq. 9 or 24)."""
        self._dt_s = dt_s
        if dt_s > 0:
            self._move(dt_s)

    def _observe(self, pair: StereoPair) -> bool:
        """Weight, resample, adapt; keep the predicted particles when the vehicle is not seen."""
        before = self.states.copy(), self.log_weights.copy()
        seen = self._weigh(pair) and self._accept(pair)
        if not seen:
            self.states, self.log_weights = before
        self._record(seen)
        return seen

    def _weigh(self, pair: StereoPair) -> bool:
        try:
            found = weigh(self.log_weights, self._score(pair), self.config.resample_ess,
                          self.rng)
        except DegenerateWeightsError:
            return False
        if found.resampled:
            self._spread(found.weights, found.ancestors)
        self.log_weights = found.log_weights
        return True

    def _spread(self, weights: Array, ancestors: NDArray[np.intp]) -> None:
        """
        Resample with a Gaussian kernel, with shrinkage that preserves the moments.

        (Shrinkage: Liu and West 2001; kernel width: Musso, Oudjane and Le Gland 2001.)
        """
        mean, cov = mean_and_covariance(weights, self.states)
        n, dim = len(self.states), self.freedom
        h = (4 / (n * (dim + 2))) ** (1 / (dim + 4))
        values, vectors = np.linalg.eigh(cov)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        noise = self.rng.standard_normal(self.states.shape) @ root.T
        self.states = mean + np.sqrt(1 - h * h) * (self.states[ancestors] - mean) + h * noise

    def _record(self, seen: bool) -> None:
        """Store the moments of the particles for the smoothing of the pass."""
        mean, cov = self._moments()
        if self.filtered:
            tries = self.config.manoeuvre_probability
            along = np.sqrt((1 - tries) * self.config.speed_rate_std ** 2
                            + tries * self.settings.along_rate_std ** 2)
            rate = directional_rate(
                mean[3:] + 1e-6, self._mean_axes()[:, 2], float(along),
                self.settings.across_rate_std, self.settings.climb_rate_std)
            self.steps.append(transition(self._dt_s, rate))
        self.filtered.append(Gaussian(mean, cov + _LEAST_SPREAD * np.eye(6)))
        self.seen.append(seen)

    def _manoeuvres(self, usual_std: float, unusual_std: float) -> Array:
        """
        Return the 1-sigma of each particle's noise; a few particles try a manoeuvre.

        Without them no particle would be near a braking vehicle, and the track would be lost.

        :return: (N,), 1-sigmas.
        """
        tries = self.rng.random(len(self.states)) < self.config.manoeuvre_probability
        return np.where(tries, max(usual_std, unusual_std), usual_std)

    # -- what is reported -------------------------------------------------------------------

    def _moments(self) -> tuple[Array, Array]:
        """Return the mean (6,) and the covariance of position and velocity."""
        both = np.hstack([self._centres(self.states), self._velocities(self.states)])
        return mean_and_covariance(normalise_log_weights(self.log_weights), both)

    def _mean_axes(self) -> Array:
        """Return the rotation (3, 3) nearest to the mean of the particles' axes."""
        mean = np.tensordot(normalise_log_weights(self.log_weights), self._axes(self.states), 1)
        u, _, v = np.linalg.svd(mean)
        return np.asarray(u @ v)

    def _mean_quads(self, lag_s: float = 0.0) -> tuple[Array, Array]:
        """Return the mean quads (1, 4, 2): the 2-D sub-states' posterior means (eq. 3)."""
        weights = normalise_log_weights(self.log_weights)
        left, right = self._quads(self.states, lag_s)
        return _mean(weights, left)[None], _mean(weights, right)[None]

    def _estimate(self) -> Estimate:
        mean, cov = self._moments()
        left, right = self._mean_quads()
        return Estimate(mean[:3], cov[:3, :3], mean[3:], cov[3:, 3:], self._mean_axes(),
                        (left[0], right[0]))


def _mean(weights: Array, quads: Array) -> Array:
    """Return the weighted mean (4, 2) of the quads (N, 4, 2) in front of the camera."""
    w = weights * np.isfinite(quads).all(axis=(1, 2))
    total = w.sum()
    if not total > 0:
        return np.full((4, 2), np.nan)
    return np.tensordot(w / total, np.where(w[:, None, None] > 0, quads, 0.0), 1)
