# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Residuals with heavy tails: Student's t by expectation maximisation.

A residual is normal with a variance of its own, scattered about a common one.  What is far off is
then likely to have a great variance, and weighs little, without a threshold.  Liu and Rubin 1995,
"ML estimation of the t distribution using EM and its extensions, ECM and ECME".
"""
from __future__ import annotations

import numpy as np

from ..core.records import Array

_ROUNDS = 3  # of weights and variance; they start near where they end


def student_weights(residual: Array, weights: Array, dof: float, least_variance: float
                    ) -> tuple[Array, Array]:
    """
    Return the weights of residuals and their common variances, after a few rounds.

    :param residual: (N, G) rows of residuals about 0; a row has one variance.
    :param weights: (N, G) to start from; ones, or those of nearly the same residuals.
    :param dof: degrees of freedom: the fewer, the heavier the tails.
    :param least_variance: lower bound of a variance.
    :return: (N, G) weights, 1 for what is as far off as usual, and (N,) variances.
    """
    square = np.square(residual)
    variance = _variance(square, weights, least_variance)
    for _ in range(_ROUNDS):
        weights = (dof + 1) / (dof + square / variance[:, None])
        variance = _variance(square, weights, least_variance)
    return weights, variance


def _variance(square: Array, weights: Array, least: float) -> Array:
    """Return the weighted mean squares (N,), not below a bound."""
    return np.asarray(np.maximum(np.einsum('ng,ng->n', weights, square) / square.shape[1], least))
