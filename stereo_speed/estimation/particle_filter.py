# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The weighting step of a bootstrap particle filter (2012, eq. 1-3).

It is independent of the model: the caller moves the particles and computes their likelihood.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .resampling import systematic
from .weights import effective_sample_size, normalise_log_weights
from ..core.records import Array


@dataclass(frozen=True, eq=False)
class Weighed:
    """
    Particles after a measurement.

    :param weights: (N,) normalised weights before resampling.
    :param ancestors: (N,) indices of the particles that survive.
    :param log_weights: (N,) log weights of the survivors.
    """

    weights: Array
    ancestors: NDArray[np.intp]
    log_weights: Array

    @property
    def resampled(self) -> bool:
        """Return whether the ancestors differ from the particles themselves."""
        return bool(np.any(self.ancestors != np.arange(len(self.ancestors))))


def weigh(log_weights: Array, log_likelihood: Array, resample_ess: float,
          rng: np.random.Generator) -> Weighed:
    """
    Weight particles by a measurement (eq. 2), and resample if few of them carry the weight.

    :param log_weights: (N,) log weights before the measurement.
    :param log_likelihood: (N,) log likelihoods of the measurement; -inf if impossible.
    :param resample_ess: effective sample size, as a share of N, below which to resample.
    :param rng: source of randomness.
    :raises DegenerateWeightsError: all particles are impossible, or a number is NaN or +inf.
    """
    weights = normalise_log_weights(log_weights + log_likelihood)
    n = len(weights)
    if effective_sample_size(weights) < resample_ess * n:
        return Weighed(weights, systematic(weights, n, rng), np.full(n, -np.log(n)))
    with np.errstate(divide='ignore'):
        return Weighed(weights, np.arange(n), np.log(weights))
