# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The weighing step that every bootstrap particle filter has (2012, eq. 1-3).

The loop knows nothing of the model: whoever calls it moves the particles and scores them.
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

    :param weights: (N,) normalised, of the particles before resampling.
    :param ancestors: (N,) which particles go on.
    :param log_weights: (N,) of those that go on.
    """

    weights: Array
    ancestors: NDArray[np.intp]
    log_weights: Array

    @property
    def resampled(self) -> bool:
        """Return whether the ancestors are anything but the particles themselves."""
        return bool(np.any(self.ancestors != np.arange(len(self.ancestors))))


def weigh(log_weights: Array, log_likelihood: Array, resample_ess: float,
          rng: np.random.Generator) -> Weighed:
    """
    Weigh particles by a measurement (eq. 2), and resample when few of them carry the weight.

    :param log_weights: (N,) so far.
    :param log_likelihood: (N,) of the measurement; -inf where impossible.
    :param resample_ess: resample when the effective sample size is below this share of N.
    :raises DegenerateWeightsError: all are impossible, or a number is none.
    """
    weights = normalise_log_weights(log_weights + log_likelihood)
    n = len(weights)
    if effective_sample_size(weights) < resample_ess * n:
        return Weighed(weights, systematic(weights, n, rng), np.full(n, -np.log(n)))
    with np.errstate(divide='ignore'):
        return Weighed(weights, np.arange(n), np.log(weights))
