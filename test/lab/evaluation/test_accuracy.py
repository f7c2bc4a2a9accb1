# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Summaries of random passes, worked by hand."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.batch.job import Result
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.accuracy import (
    accuracy_jobs, accuracy_table, classes_told, gather, late_errors, measure_job,
    passes_table, PassRun, rejections, silently_wrong)
from stereo_speed.lab.evaluation.labeled_sequence import LineKnowledge
from stereo_speed.lab.evaluation.metrics import pass_error
from stereo_speed.lab.evaluation.scorer import SequenceRun, VehicleRun


def jobs_of(count, tolerances=False):
    return accuracy_jobs(count, seed=0, lines=LineKnowledge.PICKED, pan_deg=0.0,
                         tolerances=tolerances, changes={'particles': 100})


def accuracy_result(errors_mph):
    """Make results of passes with given errors; None for a rejected one."""
    jobs = jobs_of(len(errors_mph))
    results = []
    for job, error in zip(jobs, errors_mph):
        run = VehicleRun(
            vehicle=0, verdict='measured' if error is not None else 'rejected',
            reason='' if error is not None else 'too_far', pass_truth_mps=20.0,
            pass_mps=20.0 + (error or 0.0) * MPH_MPS, pass_std_mps=0.1 * MPH_MPS)
        done = SequenceRun(vehicles=[run], cpu_ms=9.0)
        results.append(Result(key=job.key, value=done.to_json()))
    return jobs, results


def test_accuracy_is_summarised_by_kind():
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


def test_classes_are_right_unknown_or_wrong():
    passes = [PassRun(number=0, kinds=kinds, run=VehicleRun(vehicle=0, told_class=told))
              for kinds, told in [
                  ({'vehicle': 'bus'}, 'heavy_vehicle'), ({'vehicle': 'suv'}, 'car'),
                  ({'vehicle': 'suv'}, 'van'), ({'vehicle': 'truck'}, 'unknown'),
                  ({'vehicle': 'motorcycle'}, ''), ({'path': 'circle'}, 'car')]]
    assert classes_told(passes) == {'right': 2, 'unknown': 1, 'wrong': 1}


def test_readings_of_the_second_half():
    run = VehicleRun(vehicle=0, stamps_ns=list(range(6)), speeds_mps=[1., 2, 3, 4, 5, 6],
                     confirmed=[False, False, True, True, True, True], truth_mps=[0.0] * 6)
    assert late_errors(run) == [4.0, 5.0, 6.0]


def test_only_wrong_results_beyond_their_sigmas_are_silently_wrong():
    # 0.1 mph is 1 sigma here
    assert silently_wrong(gather(*accuracy_result([0.15, 0.25, -0.3, None]))) == 2


@pytest.mark.slow
def test_job_measures_its_pass():
    job, = jobs_of(1, tolerances=True)
    run, = SequenceRun.from_json(measure_job(job.parameters)).vehicles
    assert run.verdict == 'measured'
    assert abs(pass_error(run)) < 4 * run.pass_std_mps
