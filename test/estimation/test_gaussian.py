# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Gaussian inference by normal equations, against numpy's inverses and scipy's densities."""
from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from stereo_speed.estimation.gaussian import condition, NormalEquations


def test_rows_equal_weighted_least_squares():
    rng = np.random.default_rng(0)
    A, std = rng.normal(size=(6, 2)), rng.uniform(0.2, 2.0, 6)
    normal = NormalEquations(3)
    normal.rows(np.tile([2, 0], (6, 1)), A, std, rest=1.5)
    want = np.linalg.lstsq(A / std[:, None], 1.5 / std, rcond=None)[0]
    found = np.linalg.solve(normal.H[np.ix_([2, 0], [2, 0])], normal.g[[2, 0]])
    np.testing.assert_allclose(found, want)
    assert not normal.H[1].any() and normal.g[1] == 0


def test_correlated_rows_are_whitened_by_their_covariance():
    rng = np.random.default_rng(1)
    A, root = rng.normal(size=(4, 3)), rng.normal(size=(4, 4))
    covariance = root @ root.T + np.eye(4)
    normal = NormalEquations(3)
    normal.correlated(np.tile(np.arange(3), (4, 1)), A, covariance)
    np.testing.assert_allclose(normal.H, A.T @ np.linalg.inv(covariance) @ A)


def test_two_priors_combine_to_their_sum():
    one, other = NormalEquations(1), NormalEquations(1)
    one.row([0], [1.0], 2.0, 0.5)
    other.row([0], [1.0], 6.0, 0.5)
    both = one + other
    assert (both.g / both.H[0, 0]).tolist() == [4.0] and both.H[0, 0] == 8.0
    assert one.H[0, 0] == 4.0


def test_measurements_condition_like_the_joint_gaussian():
    """Mean and covariance against the inverse of the joint covariance of state and data."""
    rng = np.random.default_rng(2)
    root, A, noise = rng.normal(size=(4, 4)), rng.normal(size=(5, 2)), 0.3
    P, y = root @ root.T + np.eye(4), rng.normal(size=5)
    prior = NormalEquations(4)
    prior.correlated(np.tile(np.arange(4), (4, 1)), np.eye(4), P)
    found = condition(prior, A.T @ A / noise ** 2, A.T @ y / noise ** 2)
    whole = np.hstack([A, np.zeros((5, 2))])
    gain = P @ whole.T @ np.linalg.inv(whole @ P @ whole.T + noise ** 2 * np.eye(5))
    np.testing.assert_allclose(found.mean, gain @ y, atol=1e-9)
    np.testing.assert_allclose(found.covariance, P - gain @ whole @ P, atol=1e-9)


def test_unconstrained_unknowns_are_refused():
    with pytest.raises(np.linalg.LinAlgError, match='positive definite'):
        condition(NormalEquations(2), np.eye(1), np.zeros(1))


def test_evidence_difference_of_priors_equals_the_marginal_density():
    rng = np.random.default_rng(5)
    A, noise = rng.normal(size=(7, 3)), 0.5
    y = rng.normal(size=7)
    logs, densities = [], []
    for std in (0.3, 1.0, 4.0):
        prior = NormalEquations(3)
        for k in range(3):
            prior.row([k], [1.0], 0.0, std)
        logs.append(condition(prior, A.T @ A / noise ** 2, A.T @ y / noise ** 2).log_evidence)
        cov = std ** 2 * A @ A.T + noise ** 2 * np.eye(7)
        densities.append(stats.multivariate_normal(np.zeros(7), cov).logpdf(y))
    np.testing.assert_allclose(np.diff(logs), np.diff(densities), rtol=1e-9)


def test_constant_known_through_an_almost_noise_free_chain_is_measured():
    n, std, expected = 60, 1e-7, 3.0
    chain, k = NormalEquations(n), np.arange(n - 1)
    chain.row([0], [1.0], expected, 100.0)
    chain.rows(np.column_stack([k + 1, k]), [1.0, -1.0], np.full(n - 1, std))
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(chain.H)  # the prior alone is beyond double precision
    found = condition(chain, np.eye(n), np.full(n, 5.0))
    np.testing.assert_allclose(found.mean, 5.0, atol=0.05)
    information = n + 1e-4
    exact = 0.5 * (np.log(1e-4 / information) + (5.0 * n + expected * 1e-4) ** 2 / information)
    assert found.log_evidence == pytest.approx(exact, rel=0.05)
