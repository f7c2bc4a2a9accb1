# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Speeds from positions: straight lines by hand, least squares as an oracle, braking."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.second.speed import RATES, speeds_at


def test_line_equals_least_squares(monkeypatch):
    """Without acceleration the process is a weighted straight line."""
    monkeypatch.setattr('stereo_speed.second.speed.RATES', (1e-6,))
    t = np.array([0.0, 0.2, 0.5, 0.6, 1.1])
    std = np.array([0.2, 0.1, 0.3, 0.1, 0.05])
    places = 3 + 20 * t + np.array([0.1, -0.05, 0.2, 0.0, 0.02])
    speed, covariance = speeds_at(t, places, np.diag(std ** 2), np.array([0.3]))
    (slope, _), line = np.polyfit(t, places, 1, w=1 / std, cov='unscaled')
    assert speed[0] == pytest.approx(slope, rel=1e-6)
    assert covariance[0, 0] == pytest.approx(line[0, 0], rel=1e-4)


def test_mean_speed_of_a_braking_vehicle_is_measured():
    t = np.linspace(0.0, 3.0, 31)
    speed = 20 - 3 * np.maximum(t - 0.8, 0.0)
    places = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(t))])
    rng = np.random.default_rng(1)
    found, covariance = speeds_at(t, places + rng.normal(0, 0.02, 31), 4e-4 * np.eye(31), t)
    std = np.sqrt(covariance.mean())
    assert abs(found.mean() - speed.mean()) < 3 * std < 0.1
    assert np.abs(found - speed).max() < 0.8


@pytest.mark.parametrize('rate', RATES[1:4])
def test_sigmas_fit_the_errors_of_random_drives(rate):
    rng, t = np.random.default_rng(2), np.linspace(0.0, 2.0, 11)
    ratios = []
    for _ in range(150):
        fine = np.cumsum(rng.normal(0, rate * np.sqrt(0.01), 201)) + 25
        speed = fine[::20]
        places = np.concatenate([[0.0], np.cumsum(fine[:-1] * 0.01)])[::20]
        found, covariance = speeds_at(t, places + rng.normal(0, 0.05, 11), 0.0025 * np.eye(11), t)
        ratios.append((found.mean() - speed.mean()) / np.sqrt(covariance.mean()))
    assert 0.75 < np.std(ratios) < 1.25  # 1-sigma of it is 0.06; rates are a grid
