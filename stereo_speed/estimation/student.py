# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Residuals with heavy tails: Student's t by expectation maximisation.

Each residual is Gaussian with its own variance, which scatters about a common one.  A large
residual then probably has a large variance and gets a small weight, without a threshold.  Liu and
Rubin 1995, "ML estimation of the t distribution using EM and its extensions, ECM and ECME".
"""
from __future__ import annotations

import numpy as np

from ..core.records import Array

_ROUNDS = 3  # alternations of weights and variance, which start close to their solution


def student_weights(residual: Array, weights: Array, dof: float, least_variance: float
                    ) -> tuple[Array, Array]:
    """
    Return the weights of residuals and the common variance of each row, after a few rounds.

    :param residual: (N, G) rows of residuals about 0; each row has one common variance.
    :param weights: (N, G) initial weights: ones, or those of nearly the same residuals.
    :param dof: degrees of freedom; fewer give heavier tails.
    :param least_variance: lower bound of a variance.
    :return: (N, G) weights, about 1 for usual residuals, and (N,) variances.
    """
    square = np.square(residual)
    variance = _variance(square, weights, least_variance)
    for _ in range(_ROUNDS):
        weights = (dof + 1) / (dof + square / variance[:, None])
        variance = _variance(square, weights, least_variance)
    return weights, variance


def _variance(square: Array, weights: Array, least: float) -> Array:
    """Return the weighted mean squares (N,), limited by a lower bound."""
    return np.asarray(np.maximum(np.einsum('ng,ng->n', weights, square) / square.shape[1], least))
