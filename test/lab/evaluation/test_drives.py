# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Drives: simulated ones with and without tolerances, and what is set beside their truth."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.core.config import TrackerConfig
from stereo_speed.core.errors import InputError
from stereo_speed.core.records import PassResult, StereoPair, TrackState, Verdict
from stereo_speed.core.units import MPH_MPS
from stereo_speed.io.truth import truth_of_rows
from stereo_speed.lab.evaluation.accuracy import (
    accuracy_jobs, accuracy_table, gather, late_errors, measure_job, passes_table, rejections)
from stereo_speed.lab.evaluation.drives import (
    beside_truth, disturbed, DriveRun, simulated_drive, track_drive, VehicleRun)
from stereo_speed.lab.evaluation.metrics import pass_error, readings
from stereo_speed.lab.evaluation.runner import Result
from stereo_speed.lab.sim.config import RoadConfig, straight_config
from stereo_speed.lab.sim.scene import make_rig
from stereo_speed.lab.sim.sequence import SimSequence

CONFIG = straight_config('55 mph', pairs=6, start_m=50.0, road=RoadConfig(lanes=1))


@pytest.fixture(scope='module')
def drive():
    return simulated_drive(CONFIG, (0,), 'exact')


def test_a_drive_is_tracked_as_replay_would_and_the_same_again(drive):
    one, again = (track_drive(drive, 'constrained', TrackerConfig(), 4) for _ in range(2))
    assert replace(one, cpu_ms=0) == replace(again, cpu_ms=0)
    run, = one.vehicles
    speed, truth = readings(run)
    assert (one.stray_tracks, run.seen_pairs, run.verdict) == (0, 6, 'measured')
    assert np.allclose(truth, 55 * MPH_MPS, atol=1e-4)
    assert np.abs(speed - truth).max() < 0.5
    assert abs(pass_error(run)) < 0.2
    assert DriveRun.from_json(one.to_json()) == one


def test_refined_lines_give_a_better_road(drive):
    moved = replace(CONFIG, pairs=3, rig_moved_deg=(0.02, 0.0, 0.0))
    refined = simulated_drive(moved, (0,), 'refined')
    assert np.degrees(refined.rig.drift_rad[0]) == pytest.approx(0.02, abs=0.004)
    truth = drive.lanes['lane_0'].path.frame(np.array(10.0))[:, 0]  # of the exact lines
    path = refined.lanes['lane_0'].path
    ahead = path.frame(np.array(path.length_m / 2))[:, 0]
    assert np.degrees(np.arccos(min(float(ahead @ truth), 1.0))) < 0.05


def test_another_kind_of_lines_is_refused():
    with pytest.raises(InputError, match='guessed'):
        simulated_drive(CONFIG, (0,), 'guessed')


def test_disturbances_are_as_large_as_the_tolerances():
    tolerances, rig, image = TrackerConfig(), make_rig(CONFIG.rig), np.zeros((2, 2), np.uint8)
    pairs = tuple(StereoPair(k, k * 10 ** 9, k * 10 ** 9 + 7, image, image) for k in range(5))
    rows = tuple({'stamp_ns': k * 10 ** 9, 'vehicle': 0} for k in range(5))
    sequence = SimSequence(CONFIG, None, rig, {}, {}, {}, pairs, rows)
    drawn = [disturbed(sequence, tolerances, np.random.default_rng(k)) for k in range(300)]
    focal = np.array([s.rig.left.K[0, 0] / rig.left.K[0, 0] - 1 for s in drawn])
    base = np.array([s.rig.baseline_m - rig.baseline_m for s in drawn])
    late = np.array([[p.stamp_ns - q.stamp_ns for p, q in zip(s.pairs, pairs)] for s in drawn])
    for values, std in ((focal, tolerances.focal_std), (base, tolerances.baseline_std_m),
                        (late.ravel() * 1e-9, tolerances.stamp_std_s)):
        bound = 4 / np.sqrt(2 * len(values))  # of a standard deviation's share, 4 sigma
        assert abs(values.std() / std - 1) < bound
        assert abs(values.mean()) < 4 * std / np.sqrt(len(values))
    s = drawn[0]
    assert np.array_equal(s.rig.left.K[:2, 2], rig.left.K[:2, 2])
    assert [r['stamp_ns'] for r in s.truth] == [p.stamp_ns for p in s.pairs]
    assert {p.right_stamp_ns - p.stamp_ns for p in s.pairs} == {7}


def update(track, stamp_ns, z_m, speed, confirmed=True):
    return SimpleNamespace(
        track=track, stamp_ns=stamp_ns, position_m=np.array([0.0, 1.0, z_m]), speed_mps=speed,
        speed_std_mps=0.1,
        state=TrackState.CONFIRMED if confirmed else TrackState.COASTING)


def test_what_is_said_is_set_beside_the_truth():
    truths = truth_of_rows([{'stamp_ns': k, 'vehicle': 0, 'speed': 10.0 + k, 'x': 0.0, 'y': 1.0,
                             'z': 50.0 - k} for k in range(0, 40000, 10000)])
    updates = [update(8, k, 50.0 - k, 11.0, k > 0) for k in range(0, 50000, 10000)]
    updates.append(update(9, 0, 500.0, 3.0))
    result = PassResult(
        track=8, lane='a', first_ns=10000, last_ns=20000, pairs=2, speed_mps=12.0,
        speed_std_mps=0.1, verdict=Verdict.MEASURED, reason='',
        smoothed={10000: 11.0, 20000: 12.0}, smoothed_std={})
    run = beside_truth(updates, {8: result}, truths, 1.0)
    vehicle, = run.vehicles
    assert run.stray_tracks == 1
    assert vehicle.truth_mps == [10.0, 10010.0, 20010.0, 30010.0, None]
    assert vehicle.confirmed == [False, True, True, True, True]
    assert vehicle.pass_truth_mps == 15010.0  # over the pairs of the pass alone


def test_a_vehicle_without_a_track_has_no_readings():
    truths = truth_of_rows([{'stamp_ns': 0, 'vehicle': 4, 'speed': 1.0, 'x': 0., 'y': 0.,
                             'z': 9.}])
    run, = beside_truth([], {}, truths, 0.0).vehicles
    assert (run.vehicle, run.verdict, run.seen_pairs, run.measured) == (4, '', 1, False)


def accuracy_result(errors_mph):
    """Make the results of passes that are off as told; None for a rejected one."""
    jobs = accuracy_jobs(len(errors_mph), seed=0, site='picked', pan_deg=0.0, tolerances=False,
                         changes={'particles': 100})
    results = []
    for job, error in zip(jobs, errors_mph):
        run = VehicleRun(
            vehicle=0, verdict='measured' if error is not None else 'rejected',
            reason='' if error is not None else 'too_far', pass_truth_mps=20.0,
            pass_mps=20.0 + (error or 0.0) * MPH_MPS, pass_std_mps=0.1 * MPH_MPS, seen_pairs=5)
        drive = DriveRun(vehicles=[run], stray_tracks=0, cpu_ms=9.0)
        results.append(Result(key=job.key, value=drive.to_json()))
    return jobs, results


def test_accuracy_sums_up_by_kind():
    jobs, results = accuracy_result([0.1, -0.1, 0.3, None, 0.1, -0.1])
    results[5] = Result(key=jobs[5].key, error='no road')
    passes = gather(jobs, results)
    table = accuracy_table(passes)
    rows = {row[0]: row for row in table.rows}
    assert rows['all'][1:5] == [6, '66.7 %', '+0.100', '0.141']
    assert rows['all'][5] == '0.300'
    assert rows['all'][6] == pytest.approx(np.sqrt((1 + 1 + 9 + 1) / 4))
    assert rows['path: straight'][1:3] == [2, '50.0 %']
    assert rejections(passes) == {'failed': 1, 'too_far': 1}
    listed = passes_table(passes).csv().splitlines()
    assert len(listed) == 7
    assert 'no road' in listed[6]


def test_readings_of_the_second_half():
    run = VehicleRun(vehicle=0, stamps_ns=list(range(6)), speeds_mps=[1., 2, 3, 4, 5, 6],
                     confirmed=[False, False, True, True, True, True], truth_mps=[0.0] * 6)
    assert late_errors(run) == [4.0, 5.0, 6.0]


def test_a_job_measures_its_pass():
    job = accuracy_jobs(1, seed=0, site='picked', pan_deg=0.0, tolerances=True,
                        changes={'particles': 100})[0]
    run, = DriveRun.from_json(measure_job(job.parameters)).vehicles
    assert run.verdict == 'measured'
    assert abs(pass_error(run)) < 0.5 * MPH_MPS
