# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Steps and transport of particles, against closed forms."""
from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.tracking.cloud import begun_lane_change_m, lateral_steps, transport


def at_most(level, errors):
    """Return the bound, in sigmas, on the largest of ``n`` normal errors at a level."""
    return stats.norm.isf(level / (2 * errors))


@pytest.mark.parametrize('dt_s', [0.03, 0.2, 0.8, 3.0])
def test_weighted_lateral_steps_have_the_moments_of_the_mixture(dt_s):
    """The mixture of drift and lane change has closed-form moments."""
    config, n = TrackerConfig(), 400_000
    across, log_weights = lateral_steps(
        np.random.default_rng(1).standard_normal(n), dt_s, config)
    weights = np.exp(log_weights)
    drift_m = config.drift_across_std_m * np.sqrt(dt_s)
    change_m, p = begun_lane_change_m(dt_s, config), config.manoeuvre_probability
    variance = drift_m ** 2 + p * change_m ** 2
    for values, wanted in ((weights, 1.0), (weights * across, 0.0),
                           (weights * across ** 2, variance)):
        error = values.std() / np.sqrt(n)
        assert abs(values.mean() - wanted) < at_most(0.001, 12) * error + 1e-12


@pytest.mark.parametrize('dt_s', [0.05, 0.5, 2.0])
def test_lane_change_displacement_is_the_integral_of_its_rate(dt_s):
    """By another computation: the double integral of the covariance of the rate."""
    config = TrackerConfig()
    tau = config.manoeuvre_across_s
    rate_variance = config.manoeuvre_across_std_m ** 2 / (2 * tau)
    t = (np.arange(1000) + 0.5) * dt_s / 1000
    double = rate_variance * np.exp(-np.abs(t[:, None] - t) / tau).mean() * dt_s ** 2
    assert begun_lane_change_m(dt_s, config) ** 2 == pytest.approx(double, rel=1e-4)


def test_lateral_steps_are_drift_without_lane_changes():
    noise = np.random.default_rng(0).standard_normal(50)
    across, log_weights = lateral_steps(noise, 0.5, TrackerConfig(manoeuvre_probability=0.0))
    np.testing.assert_array_equal(log_weights, np.zeros(50))
    np.testing.assert_allclose(across, 0.2236 * np.sqrt(0.5) * noise)


def test_transport_reaches_the_wanted_moments_exactly():
    rng = np.random.default_rng(0)
    states = rng.normal(size=(50, 4)) @ rng.normal(size=(4, 4))
    goal = rng.normal(size=4), np.diag([4.0, 1.0, 0.25, 2.0])
    moments = states.mean(axis=0), np.cov(states.T, ddof=0)
    moved = transport(states, moments, goal, rng)
    np.testing.assert_allclose(moved.mean(axis=0), goal[0], atol=1e-9)
    np.testing.assert_allclose(np.cov(moved.T, ddof=0), goal[1], atol=1e-8)


def test_degenerate_particle_cloud_is_redrawn():
    rng = np.random.default_rng(0)
    states = np.repeat(rng.normal(size=(3, 4)), 1000, axis=0)
    goal = np.ones(4), np.diag([4.0, 1.0, 0.25, 2.0])
    moved = transport(states, (states.mean(axis=0), np.cov(states.T)), goal, rng)
    z = (moved.mean(axis=0) - goal[0]) / np.sqrt(np.diag(goal[1]) / 3000)
    assert np.abs(z).max() < at_most(0.001, 4)
