# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The particles of one vehicle: their moments, their prediction, and their transport to others."""
from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np

from .posterior import gone_on, walks
from ..core.records import Array
from ..core.tracker_config import TrackerConfig
from ..estimation.weights import mean_and_covariance, normalise_log_weights

_JITTER = 1e-12  # keeps the covariance of equal particles positive definite
_LANE_CHANGE_STRIDE = 4  # every fourth particle is predicted as if a lane change had begun
_DISTINCT_PER_DIM = 3  # distinct particles per unknown below which the cloud has no shape


@dataclass(frozen=True, eq=False)
class Cloud:
    """
    Weighted particles.

    :param states: (N, 4) s, a, b in m and v in m/s.
    :param log_weights: (N,) logarithms of their weights, up to a constant.
    :param stamp_ns: stamp of the pair that they belong to.
    """

    states: Array
    log_weights: Array
    stamp_ns: int

    @property
    def weights(self) -> Array:
        """Return the normalised weights of the particles, one each."""
        return normalise_log_weights(self.log_weights)

    @property
    def mean(self) -> Array:
        """Return the mean state (4,), eq. 3."""
        return np.asarray(self.weights @ self.states)

    def moments(self) -> tuple[Array, Array]:
        """Return the mean (4,) and the covariance (4, 4)."""
        return mean_and_covariance(self.weights, self.states)

    def until_s(self, stamp_ns: int) -> float:
        """Return the time until a stamp, s."""
        return (stamp_ns - self.stamp_ns) * 1e-9

    def ahead(self, stamp_ns: int, config: TrackerConfig, lateral_mps: float
              ) -> tuple[Array, Array]:
        """
        Return the mean (4,) and the covariance (4, 4) predicted for a later pair (eq. 24-27).

        :param stamp_ns: stamp of that pair.
        :param config: rates of the random walks.
        :param lateral_mps: rate at which the vehicle crosses its path.
        """
        dt_s, goes = max(self.until_s(stamp_ns), 0.0), np.eye(4)
        goes[0, 3] = dt_s
        noise = walks(dt_s, config.speed_rate_std, config, parts=4.0)
        noise[1, 1] += config.manoeuvre_probability * begun_lane_change_m(dt_s, config) ** 2
        return gone_on(self.moments(), goes, dt_s, lateral_mps, noise)

    def predicted(self, stamp_ns: int, config: TrackerConfig, lateral_mps: float,
                  rng: np.random.Generator) -> Cloud:
        """
        Return the cloud moved along the path by a random-walk speed, with drift (eq. 24-27).

        Parameters are as for :meth:`ahead`.
        """
        dt_s = self.until_s(stamp_ns)
        if dt_s <= 0:
            return replace(self, stamp_ns=stamp_ns)
        root = np.sqrt(dt_s)
        s, a, b, v = self.states.T
        noise = rng.standard_normal((4, len(self.states))) * root
        v_next = v + config.speed_rate_std * noise[3]
        across, log_ratios = lateral_steps(noise[1] / root, dt_s, config)
        states = np.column_stack([
            s + 0.5 * (v + v_next) * dt_s, a + lateral_mps * dt_s + across,
            b + config.drift_up_std_m * noise[2], v_next])
        return Cloud(states, self.log_weights + log_ratios, stamp_ns)


def begun_lane_change_m(dt_s: float, config: TrackerConfig) -> float:
    """
    Return the 1-sigma of the lateral displacement by a lane change that begins within a time, m.

    :param dt_s: the time, s.
    """
    tau_s = config.manoeuvre_across_s
    # The variance of the integral of an Ornstein-Uhlenbeck process is proportional to this time.
    effective_s = dt_s + tau_s * math.expm1(-dt_s / tau_s)
    return config.manoeuvre_across_std_m * math.sqrt(max(effective_s, 0.0))


def lateral_steps(noise: Array, dt_s: float, config: TrackerConfig) -> tuple[Array, Array]:
    """
    Return random lateral displacements (N,) of particles, m, and log importance weights (N,).

    Displacements are a mixture of drift (eq. 27) and, rarely, a lane change that has begun.  After
    missing pairs it may have moved the vehicle by 1 m, where too few particles of that mixture
    lie.  Therefore every fourth particle is drawn for a lane change, and weights correct for this.

    :param noise: (N,) standard normal.
    :param dt_s: time of the prediction, s.
    """
    drift_m = config.drift_across_std_m * math.sqrt(dt_s)
    change_m = begun_lane_change_m(dt_s, config)
    wide_m = math.hypot(drift_m, change_m)
    probability, share = config.manoeuvre_probability, 1 / _LANE_CHANGE_STRIDE
    if not (probability and change_m and drift_m):
        return drift_m * noise, np.zeros(len(noise))
    std_m = np.full(len(noise), drift_m)
    std_m[::_LANE_CHANGE_STRIDE] = wide_m
    across = std_m * noise
    # Logarithm of the density for a lane change over that for drift alone.
    log_wider = math.log(drift_m / wide_m) + 0.5 * np.square(across) * (
        drift_m ** -2 - wide_m ** -2)
    target, proposal = (np.logaddexp(math.log(1 - p), math.log(p) + log_wider)
                        for p in (probability, share))
    return across, target - proposal


def transport(states: Array, moments: tuple[Array, Array], target: tuple[Array, Array],
              rng: np.random.Generator) -> Array:
    """
    Return particles mapped affinely from one mean and covariance to another.

    The map L_to L_from^-1 of the Cholesky factors keeps each particle's relative place, and so the
    shape of the cloud.  Where resampling has left too few distinct particles to span the state,
    new ones are drawn from the target.

    :param states: (N, D).
    :param moments: their mean (D,) and covariance (D, D).
    :param target: mean (D,) and covariance (D, D) to map them to.
    """
    n, dim = states.shape
    goal = np.linalg.cholesky(0.5 * (target[1] + target[1].T) + _JITTER * np.eye(dim))
    try:
        if len(np.unique(states[:, 0])) < _DISTINCT_PER_DIM * dim:
            raise np.linalg.LinAlgError('too few distinct particles')
        start = np.linalg.cholesky(moments[1] + _JITTER * np.eye(dim))
    except np.linalg.LinAlgError:
        return np.asarray(target[0] + rng.standard_normal((n, dim)) @ goal.T)
    return np.asarray(target[0] + np.linalg.solve(start, (states - moments[0]).T).T @ goal.T)
