# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Weights of heavy-tailed residuals, against scipy's fit of the same distribution."""
from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from stereo_speed.estimation.student import student_weights


def settled(residual, dof, rounds=30):
    weights = np.ones_like(residual)
    for _ in range(rounds):
        weights, variance = student_weights(residual, weights, dof, 1e-12)
    return weights, variance


@pytest.mark.parametrize('dof', [2.0, 5.0])
def test_variance_equals_that_of_the_most_likely_t_distribution(dof):
    rows = stats.t.rvs(dof, scale=[[0.3], [2.0]], size=(2, 4000), random_state=3)
    _, variance = settled(rows, dof)
    fits = [stats.t.fit(row, fdf=dof, floc=0)[2] for row in rows]
    np.testing.assert_allclose(np.sqrt(variance), fits, rtol=2e-3)


def test_usual_residual_counts_once_and_an_outlier_hardly_at_all():
    residual = np.array([[1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 30.0]])
    weights, variance = settled(residual, 2.0)
    assert weights[0, -1] < 0.01
    assert weights[0, 0] == pytest.approx(3 / (2 + 1 / variance[0]))


def test_many_degrees_of_freedom_weigh_normal_residuals_alike():
    residual = np.random.default_rng(0).normal(size=(3, 500))
    weights, variance = student_weights(residual, np.ones_like(residual), 1e6, 0.0)
    np.testing.assert_allclose(weights, 1.0, atol=1e-4)
    np.testing.assert_allclose(variance, np.square(residual).mean(axis=1), rtol=1e-4)


def test_identical_patches_have_the_minimum_variance():
    weights, variance = student_weights(np.zeros((1, 10)), np.ones((1, 10)), 2.0, 1e-4)
    assert variance[0] == 1e-4 and np.isfinite(weights).all()
