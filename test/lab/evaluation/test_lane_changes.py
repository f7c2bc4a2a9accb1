# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's lane changes: their duration and speed, and their measurement."""
from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from stereo_speed.batch.job import Result
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.labeled_sequence import LineKnowledge
from stereo_speed.lab.evaluation.lane_changes import (
    CASES, change_config, change_job, change_jobs, ChangeError, changes_table, MANOEUVRE_MODELS,
    tracker_config)
from stereo_speed.lab.sim.kinematics import lateral_m


@pytest.mark.parametrize('case', CASES)
def test_lane_changes_equal_those_of_the_paper(case):
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
    own, straight = (tracker_config(model, 300) for model in MANOEUVRE_MODELS)
    assert own.manoeuvre_probability > 0
    assert straight.manoeuvre_probability == 0


@pytest.mark.slow
def test_fast_lane_change_is_measured():
    job = change_jobs([0], 200, LineKnowledge.EXACT)[1]
    own = ChangeError(**change_job(job.parameters)[MANOEUVRE_MODELS[0]])
    assert own.followed
    assert abs(own.pass_mps) < 0.3 * MPH_MPS


def test_failed_jobs_do_not_count_in_the_table():
    nan = float('nan')
    good = asdict(ChangeError(True, 0.1 * MPH_MPS, 0.2 * MPH_MPS, 0.3 * MPH_MPS, True))
    poor = asdict(ChangeError(False, nan, 0.4 * MPH_MPS, nan, False))
    jobs = change_jobs([3, 4, 5], 200, LineKnowledge.PICKED)
    values = [dict.fromkeys(MANOEUVRE_MODELS, good), dict.fromkeys(MANOEUVRE_MODELS, poor), None]
    results = [Result(key=job.key, value=value) for job, value in zip(jobs, values + [None] * 3)]
    lines = changes_table(jobs, results).markdown().splitlines()
    assert len(lines) == 2 + len(CASES) * len(MANOEUVRE_MODELS)
    assert lines[2] == ('| 35 mph, lane change over 5 s | lane changes | 1 of 2 | 1 of 2 '
                        '| +0.100 ± 0.000 | 0.100 | 0.30 | 0.30 | 1 of 2 |')
    assert lines[-1].endswith('| straight only | 0 of 0 | 0 of 0 | - | - | - | - | 0 of 0 |')
