# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The right camera's rotation from pair to pair: noise, turns and slow drift."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.steadying.config import SteadyingConfig
from stereo_speed.steadying.drift_filter import DriftFilter

STD = np.radians(4e-4)  # of one pair, as images show it


def fed(turn_deg, pairs=60, config=SteadyingConfig(), seed=0):
    """Return a filter after ten pairs of a camera at rest, and some pairs after a turn."""
    rng, drift = np.random.default_rng(seed), DriftFilter(config)
    for turned in [np.zeros(3)] * 10 + [np.radians(turn_deg)] * pairs:
        drift.update(turned + STD * rng.standard_normal(3), STD ** 2 * np.eye(3))
    return drift


@pytest.mark.parametrize('seed', range(5))
def test_fixed_camera_is_unchanged(seed):
    drift = fed([0.0, 0.0, 0.0], 500, seed=seed)
    assert not drift.turned and drift.turns == 0
    assert not drift.corrected_rad.any()


@pytest.mark.parametrize('turn_deg', [[0.02, 0, 0], [-0.005, 0, 0], [0, 0.02, -0.03]])
def test_rotation_is_noticed_at_once_and_soon_known_better(turn_deg):
    first, later = fed(turn_deg, 1), fed(turn_deg, 60)
    for drift in (first, later):
        assert drift.turned and drift.turns == 1 and not drift.too_far
        off = drift.corrected_rad - np.radians(turn_deg)
        assert off @ np.linalg.solve(drift.covariance_rad2, off) < 16
    assert np.trace(later.covariance_rad2) < 0.6 * np.trace(first.covariance_rad2)


def test_uncertainty_includes_systematic_errors():
    std = np.sqrt(np.diag(fed([0.02, 0, 0], 1000).covariance_rad2))
    assert np.all(np.degrees(std) >= SteadyingConfig().drift_floor_deg)


def test_creeping_camera_is_followed():
    config = SteadyingConfig(drift_rate_deg=1e-4)
    rng, drift = np.random.default_rng(0), DriftFilter(config)
    for pan in np.linspace(0.0, 0.01, 1000):
        drift.update(np.radians([pan, 0, 0]) + STD * rng.standard_normal(3), STD ** 2 * np.eye(3))
    assert drift.turned and drift.turns == 0
    assert np.degrees(drift.corrected_rad[0]) == pytest.approx(0.01, abs=5e-4)


def test_rotation_beyond_the_limit_is_not_corrected():
    assert fed([0.5, 0, 0], 5).too_far


def test_pairs_without_a_look_count():
    rate = np.radians(SteadyingConfig().drift_rate_deg)
    one, many = (DriftFilter(SteadyingConfig(drift_probability=0.0)) for _ in range(2))
    one.update(np.zeros(3), 1e-8 * np.eye(3))
    many.update(np.zeros(3), 1e-8 * np.eye(3), pairs=100)
    floor = np.radians(SteadyingConfig().drift_floor_deg) ** 2
    for drift, before in ((one, rate ** 2), (many, 100 * rate ** 2)):
        wanted = floor + before * 1e-8 / (before + 1e-8)
        assert np.allclose(drift.covariance_rad2, wanted * np.eye(3))


def test_noise_of_the_reference_is_no_rotation():
    std = np.radians(0.01)  # of one pair by night; the reference is as noisy
    shares = []
    for seed in range(40):
        rng, drift = np.random.default_rng(seed), DriftFilter(SteadyingConfig())
        by_reference = std * rng.standard_normal(3)
        for _ in range(300):
            drift.update(by_reference + std * rng.standard_normal(3), 2 * std ** 2 * np.eye(3))
        shares.append(drift.mean_rad @ np.linalg.solve(drift.covariance_rad2, drift.mean_rad) / 3)
        assert not drift.turned and drift.turns == 0
    assert np.mean(shares) < 1.5  # of 120 squared unit normals: 1 +- 0.13


def test_rotation_is_separated_from_reference_noise_and_survives_renewal():
    std, turn = np.radians(0.002), np.radians([0.02, 0.0, -0.01])
    shares = []
    for seed in range(20):
        rng, drift = np.random.default_rng(seed), DriftFilter(SteadyingConfig())
        for turned in (np.zeros(3), turn, turn):
            by_reference = std * rng.standard_normal(3)
            for _ in range(100):
                drift.update(turned + by_reference + std * rng.standard_normal(3),
                             2 * std ** 2 * np.eye(3))
            drift.renew()
        off = drift.mean_rad - turn
        shares.append(off @ np.linalg.solve(drift.covariance_rad2, off) / 3)
        assert drift.turned
    assert np.mean(shares) < 1.6  # of 60 squared unit normals: 1 +- 0.18
