# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The content of an evaluation's plots."""
from __future__ import annotations

import cv2
import pytest
from stereo_speed.batch.job import Result
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.experiments import Experiment, Runs, Source
from stereo_speed.lab.evaluation.paper import TABLE_1A
from stereo_speed.lab.evaluation.paper_tables import PaperPlan
from stereo_speed.lab.evaluation.pictures import (
    draw_errors, draw_speeds, paper_curves, particle_curves)
from stereo_speed.lab.evaluation.scorer import SequenceRun, VehicleRun


def experiment(tracker, particles=100):
    return Experiment(source=Source(files={'bag': 'one/bag'}), tracker=tracker,
                      changes={'particles': particles})


def result(e, seed, error_mph):
    run = VehicleRun(vehicle=0, stamps_ns=[0, 200_000_000], confirmed=[True, True],
                     speeds_mps=[20.0, 20.0 + error_mph * MPH_MPS], truth_mps=[20.0, 20.0])
    return Result(key=e.key(seed), value=SequenceRun(vehicles=[run], cpu_ms=1.0).to_json())


def test_particle_curves_are_by_tracker_in_rising_order():
    experiments = [experiment(t, n) for t in ('constrained', 'kalman') for n in (400, 100)]
    runs = Runs([result(e, 0, e.changes['particles'] / 1000) for e in experiments])
    curves = particle_curves(experiments, [0], runs, lambda f: f.max_error_mps)
    assert [curve.name for curve in curves] == ['constrained', 'kalman']
    for curve in curves:
        assert curve.values == [100, 400]
        assert curve.errors_mph == pytest.approx([0.1, 0.4])


def test_curves_of_the_paper_are_beside_ours():
    plan = PaperPlan(table_seeds=range(1))
    runs = Runs([result(plan.cell(TABLE_1A, row), 0, -0.25) for row in TABLE_1A.rows])
    theirs, ours = paper_curves(plan, TABLE_1A, runs)
    assert theirs.dashed and not ours.dashed
    assert theirs.errors_mph == [row.max_error_mph for row in TABLE_1A.rows]
    assert ours.errors_mph == pytest.approx([0.25] * len(TABLE_1A.rows))


def test_plots_are_pictures_and_none_is_made_without_readings(tmp_path):
    e = experiment('constrained')
    draw_speeds(tmp_path / 'speed.png', 'one', [e], 0, Runs([result(e, 0, 0.1)]))
    draw_speeds(tmp_path / 'none.png', 'one', [e], 0, Runs([]))
    draw_errors(tmp_path / 'error.png', 'one', 'particles N', particle_curves(
        [e], [0], Runs([result(e, 0, 0.1)]), lambda f: f.rms_mps))
    for name in ('speed.png', 'error.png'):
        assert cv2.imread(str(tmp_path / name)).std() > 1
    assert not (tmp_path / 'none.png').exists()
