# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Weights of particles, kept as logarithms until they are normalised (2012, eq. 1-3)."""
from __future__ import annotations

import numpy as np

from ..core.records import Array


class DegenerateWeightsError(ValueError):
    """Raised when all particles are impossible, or a weight is not a number."""


def normalise_log_weights(log_weights: Array) -> Array:
    """
    Return weights that sum to one.

    :param log_weights: (N,) unnormalised log weights; -inf for an impossible particle.
    :return: (N,) weights.
    :raises DegenerateWeightsError: any NaN or +inf, or all -inf.
    """
    top = np.max(log_weights)
    if not np.isfinite(top):
        raise DegenerateWeightsError(f'largest log weight is {top}')
    weights = np.exp(log_weights - top)
    return np.asarray(weights / weights.sum())


def effective_sample_size(weights: Array) -> float:
    """Return Kish's effective sample size 1 / sum w^2 of normalised weights, from 1 to N."""
    return float(1.0 / np.sum(np.square(weights)))


def mean_and_covariance(weights: Array, states: Array) -> tuple[Array, Array]:
    """
    Return the posterior mean (eq. 3) and covariance of weighted particles.

    :param weights: (N,) normalised weights.
    :param states: (N, D) states of the particles.
    :return: (D,) mean and (D, D) covariance.
    """
    mean = weights @ states
    centred = states - mean
    return mean, (weights[:, None] * centred).T @ centred
