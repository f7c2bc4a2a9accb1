# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The comparison of trackers, worked by hand."""
from __future__ import annotations

import pytest
from stereo_speed.batch.job import Result
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.comparison import comparison_table, whole_figures
from stereo_speed.lab.evaluation.experiments import Experiment, Runs, Source
from stereo_speed.lab.evaluation.scorer import SequenceRun, VehicleRun

SOURCE = Source(files={'bag': 'one/bag'})


def experiment(tracker='constrained', particles=100):
    return Experiment(source=SOURCE, tracker=tracker, changes={'particles': particles})


def result(e, seed, errors_mph, vehicles=1):
    """Return a run with given errors of its readings at 50 mph; its pass equals the last one."""
    n = len(errors_mph)
    runs = [VehicleRun(
        vehicle=k, stamps_ns=list(range(n)), confirmed=[True] * n, truth_mps=[50 * MPH_MPS] * n,
        speeds_mps=[(50 + error) * MPH_MPS for error in errors_mph], verdict='measured',
        pass_mps=(50 + errors_mph[-1]) * MPH_MPS, pass_std_mps=0.1,
        pass_truth_mps=50 * MPH_MPS) for k in range(vehicles)]
    return Result(key=e.key(seed), value=SequenceRun(vehicles=runs, cpu_ms=5.0).to_json())


def test_row_by_hand():
    e = experiment()
    table = comparison_table([e], range(2), Runs([
        result(e, 0, [1.0, -0.5]), result(e, 1, [0.0, 0.25])]))
    row, = table.rows
    assert table.title == 'one' and row[0] == 'constrained'
    mean, worst, _, rms, last, final = row[2:8]
    assert (row[1], mean, worst) == pytest.approx((50.0, 50.1875, 1.0))
    assert rms == pytest.approx(((1 + 0.25 + 0 + 0.0625) / 4) ** 0.5)
    assert (last, final) == pytest.approx((0.5, 0.5))
    assert row[8:] == ['2/2', '0/2', 5.0]


def test_failed_runs_count_as_lost():
    e = experiment()
    figures = whole_figures(e, range(3), 0, Runs([result(e, 0, [0.0])]))
    assert (figures.runs, figures.lost) == (3, 2)


def test_label_contains_particles_and_vehicles_where_they_differ():
    few, many = experiment(), experiment(particles=400)
    runs = Runs([result(e, 0, [0.1], vehicles=2) for e in (few, many)])
    assert [row[0] for row in comparison_table([few, many], [0], runs).rows] == [
        f'constrained, N = {n} (vehicle {k})' for k in (0, 1) for n in (100, 400)]


def test_no_runs_give_a_row_of_dashes():
    row, = comparison_table([experiment()], range(2), Runs([])).rows
    assert row[8:10] == ['0/2', '2/2']
    assert '| - | - |' in comparison_table([experiment()], range(2), Runs([])).markdown()
