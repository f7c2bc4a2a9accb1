# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Vehicles that bounce on their springs."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from stereo_speed.core.tracker_config import NoiseConfig, TrackerConfig
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.labeled_sequence import (
    LineKnowledge, run_tracker, simulated_sequence)
from stereo_speed.lab.evaluation.metrics import pass_error, readings, sigma_share
from stereo_speed.lab.sim.config import straight_config
from stereo_speed.lab.sim.ride import with_ride
from stereo_speed.tracking.motion_prior import (
    bounce, motion_models, PassMotion, PassPrior, StateIndex)


@pytest.mark.parametrize('lag_rad', [0.0, 0.5, -1.0, 3.0])
def test_correlation_is_that_of_a_critically_damped_oscillator(lag_rad):
    """By its spectrum, 1 / (1 + w^2)^2, in units of the natural frequency."""
    def power(w):
        return 1 / (1 + w * w) ** 2
    along = quad(power, 0, np.inf, weight='cos', wvar=lag_rad)[0] if lag_rad else np.pi / 4
    assert bounce(np.array(lag_rad)) == pytest.approx(along / (np.pi / 4), abs=1e-7)


@pytest.mark.parametrize('smooth_m, rough_m', [(0.003, 0.03), (0.02, 0.01)])
def test_heights_are_a_drift_an_independent_part_and_a_bounce(smooth_m, rough_m):
    """The prior of the offsets above the path against its covariance, entry by entry."""
    config = TrackerConfig(smooth_ride_std_m=smooth_m, rough_ride_std_m=rough_m, ride_hz=2.0)
    times_s = np.array([0.0, 0.05, 0.3, 0.4])
    prior = PassPrior(s_m=0.0, s_std_m=1.0, offset_m=np.zeros(2), offset_slope=np.zeros(2),
                      speed_mps=20.0, speed_std_mps=5.0, heading_std_rad=np.full(2, 1e-3))
    motion = PassMotion(prior, config, 1e-4)
    state = np.column_stack([20 * times_s, 0 * times_s, 0 * times_s, 20 + 0 * times_s])
    model, = [m for m in motion_models(config) if m.ride_std_m == rough_m
              and m.speed_rate_std == config.cruise_rate_std]
    given, = motion.equations(times_s, state, [model])
    above = StateIndex(4).poses[:, 2]
    information = (given.H - motion.beginning(4).leading(len(given.g)).H)[np.ix_(above, above)]
    alone_m = min(smooth_m, rough_m)

    def heights(i, j):
        x = 2 * np.pi * 2.0 * abs(times_s[i] - times_s[j])
        return alone_m ** 2 * (i == j) + (rough_m ** 2 - alone_m ** 2) * (1 + x) * np.exp(-x)
    drift = np.diag(alone_m ** 2 * np.diff(times_s))
    moves = drift + [[heights(i + 1, j + 1) - heights(i + 1, j) - heights(i, j + 1)
                      + heights(i, j) for j in range(3)] for i in range(3)]
    step = np.diff(np.eye(4), axis=0)
    wanted = step.T @ np.linalg.inv(moves) @ step
    np.testing.assert_allclose(information, wanted, atol=1e-6 * wanted.max())


@pytest.mark.parametrize('seed', [0, 3])
def test_bounce_on_a_rough_road_is_not_read_as_a_change_of_speed(seed):
    """15 pairs a second on a road of class C (ISO 8608): the front rises and sinks by 15 mm."""
    config = with_ride(straight_config('70 mph', fps=15.0, pairs=18, start_m=60.0), 'C', seed)
    sequence = simulated_sequence(config, (0, seed), LineKnowledge.EXACT)
    # drawn pixels average grey levels
    config = TrackerConfig(noise=NoiseConfig(gamma=1.0))
    run, = run_tracker(sequence, 'constrained', config, seed).vehicles
    assert run.measured and abs(sigma_share(run)) < 3 and abs(pass_error(run)) < 0.2 * MPH_MPS
    speed, truth = readings(run)
    assert len(speed) > 8 and np.abs(speed - truth).max() < 1.2 * MPH_MPS
