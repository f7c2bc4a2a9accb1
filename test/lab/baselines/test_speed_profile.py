# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Speed profiles: exact motion, noise, and the covariance of the mean."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.lab.baselines.constant_velocity import Gaussian, transition
from stereo_speed.lab.baselines.speed_profile import fitted_profile, smoothed_profile

TIMES = np.array([0.0, 0.2, 0.41, 0.6, 1.0, 1.2, 1.4, 1.61])


def places(speed, slow=0.0):
    way = speed * TIMES - 0.5 * slow * TIMES ** 2
    return np.column_stack([0.1 * way, 0 * way, 80 - np.sqrt(0.99) * way])


@pytest.mark.parametrize('slow', [0.0, 3.0])
def test_exact_places_give_exact_speeds(slow):
    covs = np.tile(1e-6 * np.eye(3), (len(TIMES), 1, 1))
    found = fitted_profile(TIMES, places(20.0, slow), covs)
    np.testing.assert_allclose(found.speed_mps, 20 - slow * TIMES, atol=1e-5)


def test_sigma_of_fitted_speeds_equals_the_scatter_of_many_trials():
    rng = np.random.default_rng(0)
    depth_std = np.linspace(1.0, 0.1, len(TIMES))
    covs = np.array([np.diag([0.01, 0.01, s]) ** 2 for s in depth_std])
    speeds, told = [], []
    for _ in range(300):
        noise = np.array([0.01, 0.01, 1]) * rng.standard_normal((len(TIMES), 3))
        noise[:, 2] *= depth_std
        found = fitted_profile(TIMES, places(20.0) + noise, covs)
        speeds.append(found.speed_mps.mean())
        told.append(found.mean_std_mps)
    assert np.mean(speeds) == pytest.approx(20.0, abs=0.1)
    # The choice of the degree and the scale make both a little wider than one model's.
    assert np.std(speeds) == pytest.approx(np.median(told), rel=0.35)


def test_smoothed_profile_of_one_known_velocity():
    velocity = np.array([0.0, 3.0, -4.0])
    beliefs = [Gaussian(np.concatenate([t * velocity, velocity]),
                        np.diag([1.0, 1, 1, 0.04, 0.04, 0.04])) for t in (0.0, 0.2, 0.4)]
    steps = [transition(0.2, np.zeros((3, 3)))] * 2
    found = smoothed_profile(beliefs, steps, [True, False, True])
    np.testing.assert_allclose(found.speed_mps, [5.0, 5.0], atol=1e-9)
    # Without process noise all speeds are one number, so their mean is known no better.
    assert found.mean_std_mps == pytest.approx(found.std_mps[0], rel=1e-4)
    assert found.std_mps[0] <= 0.2


def test_depth_noise_at_a_high_frame_rate_does_not_increase_the_speed():
    """Steps of 0.8 m with 0.5 m of depth noise: their bare lengths would read 10 % too much."""
    rng, times = np.random.default_rng(3), np.arange(45) / 30
    means = []
    for _ in range(40):
        noise = np.zeros((45, 3))
        noise[:, 2] = rng.normal(0, 0.5, 45)
        spots = np.outer(times, [0.0, 0.0, -24.6]) + [1.0, 2.0, 60.0] + noise
        covs = np.tile(np.diag([1e-4, 1e-4, 0.25]), (45, 1, 1))
        means.append(fitted_profile(times, spots, covs).speed_mps.mean())
    assert abs(np.mean(means) - 24.6) < 3 * np.std(means) / np.sqrt(len(means)) + 0.02
