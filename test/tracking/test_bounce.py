# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Vehicles that bounce on their springs."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.labeled_sequence import (
    LineKnowledge, run_tracker, simulated_sequence)
from stereo_speed.lab.evaluation.metrics import pass_error, readings, sigma_share
from stereo_speed.lab.sim.config import straight_config
from stereo_speed.lab.sim.ride import with_ride
from stereo_speed.tracking.motion_prior import bounce


@pytest.mark.parametrize('lag_rad', [0.0, 0.5, -1.0, 3.0])
def test_correlation_is_that_of_a_critically_damped_oscillator(lag_rad):
    """By its spectrum, 1 / (1 + w^2)^2, in units of the natural frequency."""
    def power(w):
        return 1 / (1 + w * w) ** 2
    along = quad(power, 0, np.inf, weight='cos', wvar=lag_rad)[0] if lag_rad else np.pi / 4
    assert bounce(np.array(lag_rad)) == pytest.approx(along / (np.pi / 4), abs=1e-7)


@pytest.mark.parametrize('seed', [0, 3])
def test_bounce_on_a_rough_road_is_not_read_as_a_change_of_speed(seed):
    """15 pairs a second on a road of class C (ISO 8608): the front rises and sinks by 15 mm."""
    config = with_ride(straight_config('70 mph', fps=15.0, pairs=18, start_m=60.0), 'C', seed)
    sequence = simulated_sequence(config, (0, seed), LineKnowledge.EXACT)
    run, = run_tracker(sequence, 'constrained', TrackerConfig(), seed).vehicles
    assert run.measured and abs(sigma_share(run)) < 3 and abs(pass_error(run)) < 0.2 * MPH_MPS
    speed, truth = readings(run)
    assert len(speed) > 8 and np.abs(speed - truth).max() < 1.2 * MPH_MPS
