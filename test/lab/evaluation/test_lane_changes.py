# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's lane changes: as long and as fast as it says, and measured."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.lane_changes import (
    CASES, change_config, ChangeError, HEADER, measure_changes, row, tracker_config, TRACKERS)
from stereo_speed.lab.sim.kinematics import lateral_m


@pytest.mark.parametrize('case', CASES)
def test_lane_changes_are_those_of_the_paper(case):
    mph, last_s = CASES[case]
    lanes = set()
    for seed in range(12):
        config = change_config(case, seed)
        vehicle, = config.vehicles
        (start, _), (end, step) = vehicle.lateral_knots
        assert end - start == pytest.approx(last_s) and 0.3 <= start
        assert end < (config.pairs - 1) / config.fps
        assert vehicle.speed_mps / MPH_MPS == pytest.approx(mph, abs=2.0)
        assert abs(lateral_m(vehicle, 9.0)) == 3.7
        assert 0 <= vehicle.lane + np.sign(step) < config.road.lanes
        lanes.add(vehicle.lane)
    assert lanes == {0, 1}


def test_straight_only_is_the_tracker_without_manoeuvres():
    assert tracker_config(TRACKERS[0], 300).manoeuvre_probability > 0
    assert tracker_config(TRACKERS[1], 300).manoeuvre_probability == 0


def test_a_fast_lane_change_is_measured():
    own, _ = measure_changes('30 mph, lane change over 3 s', 0, 200, 'exact')
    assert own.kept
    assert own.pass_mps is not None and abs(own.pass_mps) < 0.3 * MPH_MPS


def test_row_counts_by_hand():
    errors = [ChangeError(True, 0.1 * MPH_MPS, 0.2 * MPH_MPS, 0.3 * MPH_MPS, True),
              ChangeError(False, None, 0.4 * MPH_MPS, float('nan'), False)]
    text = row('a', 'b', errors)
    assert text.count('|') == HEADER.splitlines()[0].count('|')
    assert text == '| a | b | 1 of 2 | 1 of 2 | +0.100 ± 0.000 | 0.100 | 0.30 | 0.30 | 1 of 2 |'
