# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The particle filter's posterior against a Kalman filter where both are exact."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.estimation.particle_filter import weigh
from stereo_speed.estimation.weights import (
    DegenerateWeightsError, mean_and_covariance, normalise_log_weights)
from stereo_speed.lab.baselines.constant_velocity import correct, Gaussian, predict, transition

PARTICLES, STEPS, NOISE, RUNS = 20000, 6, 0.5, 10
PRIOR = Gaussian(np.array([0.0, 0, 0, 20, 0, 0]), np.diag([1.0, 1, 1, 9, 1, 1]))
RATE = np.diag([2.0, 1.5, 1.0]) ** 2


def data(seed):
    """Return a random track: steps, measurements and the Kalman filter's last posterior."""
    rng = np.random.default_rng(seed)
    belief = PRIOR
    truth = rng.multivariate_normal(PRIOR.mean, PRIOR.cov)
    steps, measured = [], []
    for dt_s in rng.uniform(0.1, 0.3, STEPS):
        steps.append(transition(dt_s, RATE))
        truth = steps[-1].F @ truth + rng.multivariate_normal(np.zeros(6), steps[-1].Q)
        measured.append(truth[:3] + NOISE * rng.standard_normal(3))
        belief = correct(predict(belief, steps[-1]), measured[-1], NOISE ** 2 * np.eye(3))
    return steps, measured, belief


def particles_moments(steps, measured, resample_ess, rng):
    """Run the particle filter; return mean and covariance of its last posterior."""
    particles = rng.multivariate_normal(PRIOR.mean, PRIOR.cov, PARTICLES)
    log_weights = np.zeros(PARTICLES)
    for step, z in zip(steps, measured):
        noise = rng.multivariate_normal(np.zeros(6), step.Q, PARTICLES)
        particles = particles @ step.F.T + noise
        likelihood = -0.5 * np.sum(np.square((particles[:, :3] - z) / NOISE), axis=1)
        found = weigh(log_weights, likelihood, resample_ess, rng)
        moments = mean_and_covariance(found.weights, particles)
        particles, log_weights = particles[found.ancestors], found.log_weights
    return moments


@pytest.mark.parametrize('resample_ess', [0.5, 1.0])
def test_posterior_equals_that_of_the_kalman_filter(resample_ess):
    steps, measured, exact = data(4)
    root = np.linalg.cholesky(exact.cov)
    runs = [particles_moments(steps, measured, resample_ess, rng)
            for rng in np.random.default_rng(0).spawn(RUNS)]
    # In units of the exact posterior: the mean should be 0 and the covariance 1.
    means = np.array([np.linalg.solve(root, m - exact.mean) for m, _ in runs])
    covs = np.array([np.linalg.solve(root, np.linalg.solve(root, c).T) for _, c in runs])
    for found, wanted, most in ((means, np.zeros(6), 0.2), (covs, np.eye(6), 0.3)):
        scatter = found.std(axis=0, ddof=1)
        assert scatter.max() < most  # of one run
        # No bias: the mean over the runs within 6 of its own standard errors.
        assert np.all(np.abs(found.mean(axis=0) - wanted) < 6 * scatter / np.sqrt(RUNS))


def test_weights_add_up_until_resampled():
    rng, likelihood = np.random.default_rng(0), np.log([0.1, 0.2, 0.3, 0.4])
    kept = weigh(np.log([0.4, 0.3, 0.2, 0.1]), likelihood, 0.0, rng)
    assert not kept.resampled
    np.testing.assert_allclose(normalise_log_weights(kept.log_weights),
                               np.array([4, 6, 6, 4]) / 20)
    drawn = weigh(np.zeros(4), np.array([0.0, -np.inf, -np.inf, -np.inf]), 0.5, rng)
    assert drawn.resampled and drawn.ancestors.tolist() == [0, 0, 0, 0]
    np.testing.assert_allclose(normalise_log_weights(drawn.log_weights), 0.25)


def test_all_particles_impossible_is_an_error():
    with pytest.raises(DegenerateWeightsError):
        weigh(np.zeros(3), np.full(3, -np.inf), 0.5, np.random.default_rng(0))
