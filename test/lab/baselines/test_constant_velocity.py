# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Kalman filter and smoother against the joint Gaussian of all states and measurements."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad_vec

from stereo_speed.lab.baselines.constant_velocity import (
    correct, directional_rate, distance2, Gaussian, predict, smooth, transition)


def problem(seed=0, count=6):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6))
    prior = Gaussian(rng.normal(size=6), root @ root.T)
    rate = directional_rate(np.array([1.0, 0.2, 0.1]), np.array([0.0, 0, 1]), 0.5, 2.0, 0.1)
    steps = [transition(dt, rate) for dt in rng.uniform(0.05, 0.6, count - 1)]
    noises = [a @ a.T + 0.1 * np.eye(3) for a in rng.normal(size=(count, 3, 3))]
    return prior, steps, rng.normal(size=(count, 3)), noises


def joint(prior, steps, measured, noises):
    """Condition all states jointly: a dense Gaussian of 6 n unknowns."""
    n = len(measured)
    rows, cov = [prior.mean], np.zeros((6 * n, 6 * n))
    cov[:6, :6] = prior.cov
    for k, step in enumerate(steps):
        a, b = slice(6 * k, 6 * k + 6), slice(6 * k + 6, 6 * k + 12)
        rows.append(step.F @ rows[-1])
        cov[b, :6 * k + 6] = step.F @ cov[a, :6 * k + 6]
        cov[:6 * k + 6, b] = cov[b, :6 * k + 6].T
        cov[b, b] = step.F @ cov[a, a] @ step.F.T + step.Q
    h = np.kron(np.eye(n), np.eye(3, 6))
    noise = np.zeros((3 * n, 3 * n))
    for k, r in enumerate(noises):
        noise[3 * k:3 * k + 3, 3 * k:3 * k + 3] = r
    mean, gain = np.concatenate(rows), cov @ h.T @ np.linalg.inv(h @ cov @ h.T + noise)
    return mean + gain @ (measured.ravel() - h @ mean), cov - gain @ h @ cov


def filtered(prior, steps, measured, noises):
    beliefs = [correct(prior, measured[0], noises[0])]
    for step, z, r in zip(steps, measured[1:], noises[1:]):
        beliefs.append(correct(predict(beliefs[-1], step), z, r))
    return beliefs


@pytest.mark.parametrize('seed', range(3))
def test_filter_and_smoother_equal_the_joint_gaussian(seed):
    prior, steps, measured, noises = problem(seed)
    beliefs = filtered(prior, steps, measured, noises)
    mean, cov = joint(prior, steps, measured, noises)
    np.testing.assert_allclose(beliefs[-1].mean, mean[-6:], atol=1e-8)
    np.testing.assert_allclose(beliefs[-1].cov, cov[-6:, -6:], atol=1e-8)
    means, joint_cov = smooth(beliefs, steps)
    np.testing.assert_allclose(means.ravel(), mean, atol=1e-7)
    dense = joint_cov.transpose(0, 2, 1, 3).reshape(cov.shape)
    np.testing.assert_allclose(dense, cov, atol=1e-7)


def test_process_noise_is_the_integral_of_its_rate():
    rate = directional_rate(np.array([3.0, 1, 0]), np.array([0.0, 0, 1]), 1.0, 2.0, 0.5)
    dt = 0.4
    step = transition(dt, rate)

    def spread(t):
        g = np.vstack([(dt - t) * np.eye(3), np.eye(3)])
        return g @ rate @ g.T
    np.testing.assert_allclose(step.Q, quad_vec(spread, 0, dt)[0], atol=1e-12)


def test_rates_lie_along_the_motion():
    rate = directional_rate(np.array([0.0, 2.0, 0]), np.array([0.1, 0, 1]), 1.0, 2.0, 0.5)
    assert rate[1, 1] == pytest.approx(1.0)
    assert np.linalg.eigvalsh(rate) == pytest.approx([0.25, 1.0, 4.0])


def test_distance_by_hand():
    belief = Gaussian(np.zeros(6), np.eye(6))
    assert distance2(belief, np.array([2.0, 0, 0]), np.eye(3)) == pytest.approx(2.0)
