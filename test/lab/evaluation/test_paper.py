# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's tables as data, the runs for them, and the results."""
from __future__ import annotations

import csv
import io

import pytest
from stereo_speed.batch.job import Result
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.experiments import plan, Runs
from stereo_speed.lab.evaluation.paper import FINDINGS, TABLE_1A, TABLE_1B, TABLE_2A, TABLE_2B
from stereo_speed.lab.evaluation.paper_sequences import SEQUENCES
from stereo_speed.lab.evaluation.paper_tables import (
    checks, checks_text, contest_table, paper_table, PaperPlan)
from stereo_speed.lab.evaluation.scorer import SequenceRun, VehicleRun

SMALL = PaperPlan(table_seeds=range(2), compare_seeds=range(2))


def test_cells_of_two_tables_with_one_experiment_are_run_once():
    def cell(table, value):
        return SMALL.cell(table, next(row for row in table.rows if row.value == value))
    assert cell(TABLE_1A, 200) == cell(TABLE_1B, 10)
    assert cell(TABLE_2A, 400) == cell(TABLE_2B, 0.15)


def test_cells_vary_what_their_table_varies():
    changes = [SMALL.cell(TABLE_2B, row).changes for row in TABLE_2B.rows]
    # per frame at 5 frames/s to per square root of a second
    assert [c['speed_rate_std'] for c in changes] == pytest.approx(
        [0.1118, 0.2236, 0.3354, 0.4472, 0.5590], abs=1e-4)
    assert {c['particles'] for c in changes} == {400}
    parts = [SMALL.cell(TABLE_1B, row).changes.get('parts', TrackerConfig().parts)
             for row in TABLE_1B.rows]
    assert parts == [4, 6, 8, 10, 12, 16]


def test_runs_are_planned_once_and_grouped_by_sequence():
    jobs = plan(SMALL.cells() + SMALL.contests())
    assert len({job.key for job in jobs}) == len(jobs)
    # 21 cells of which 2 are in two tables; of the 7 contests 2 are cells as well
    assert len(jobs) == 2 * (19 + 7 - 2)
    groups = [job.group for job in jobs]
    assert len(set(groups)) == 2 * len(SEQUENCES)
    assert groups == sorted(groups)


def test_findings_are_of_compared_sequences():
    assert {sequence for sequence, _ in FINDINGS} <= set(SMALL.compared) <= set(SEQUENCES)


def runs_with(plan_, errors_mph):
    """Make the runs of a plan: five readings, the last two with a given error, for each seed."""
    results = []
    for seed, error in enumerate(errors_mph):
        for e in {e.key(0): e for e, _ in plan_.cells() + plan_.contests()}.values():
            n = len(SEQUENCES[e.source.sequence].vehicles)
            speeds = [50 * MPH_MPS] * 3 + [(50 + 2 * error) * MPH_MPS, (50 + error) * MPH_MPS]
            done = SequenceRun(cpu_ms=10.0, vehicles=[VehicleRun(
                vehicle=k, stamps_ns=[0, 1, 2, 3, 4], speeds_mps=speeds,
                confirmed=[True] * 5, truth_mps=[50 * MPH_MPS] * 5) for k in range(n)])
            results.append(Result(key=e.key(seed), fingerprint='', value=done.to_json()))
    return Runs(results)


def test_table_has_the_papers_figures_beside_ours():
    runs = runs_with(SMALL, [0.1, -0.2])
    rows = list(csv.reader(io.StringIO(paper_table(SMALL, TABLE_1A, runs).csv())))
    assert rows[0][0] == 'particles N'
    assert [row[0] for row in rows[1:]] == ['100', '200', '400', '600', '800']
    second = dict(zip(rows[0][:6], rows[2][:6]))
    assert float(second['mean speed, mph: paper']) == 54.93
    assert float(second['max error, mph: paper']) == 0.33
    assert float(second['ours']) == pytest.approx(49.95)  # the last readings' mean
    assert float(second['ours, last reading']) == pytest.approx(0.2)
    assert float(second['ours, every reading']) == pytest.approx(0.4)


def test_comparison_has_a_row_per_vehicle_and_counts_failed_runs_as_lost():
    runs = runs_with(SMALL, [0.1])  # the second seed failed
    table = contest_table(SMALL, 'two_vehicles', runs)
    assert len(table.rows) == 2
    lost = table.columns.index('lost')
    assert [row[lost] for row in table.rows] == ['1/2', '1/2']


def test_checks_report_what_does_not_hold():
    good = checks(SMALL, runs_with(SMALL, [0.1, -0.05]))
    # half of 0.25 mph is the strictest limit
    assert [c for c in good if not c.holds] == []
    assert sum('times shorter' in c.claim for c in good) == 2
    bad = checks(SMALL, runs_with(SMALL, [0.1, -0.3]))
    assert {c.claim.split(':')[0] for c in bad if not c.holds} == {
        'Table I(a), 200', 'Table I(a), 400', 'Table I(a), 600', 'Table I(a), 800',
        'Table I(b), 10', 'Table I(b), 12', 'Table I(b), 16', 'Table II(a), 800'}
    missing = checks(SMALL, runs_with(SMALL, [0.1]))
    assert not any(c.holds for c in missing if 'maximum error' in c.claim)
    assert '- **NO**: ' in checks_text(bad)


def test_quick_plan_is_small():
    quick = SMALL.quick()
    assert [len(t.rows) for t in quick.tables] == [2] * 4
    assert len(plan(quick.cells() + quick.contests())) <= 9


def test_plan_without_our_tracker_has_no_checks():
    others = PaperPlan(tables=(), compared=('straight55',), trackers=('kalman',))
    assert checks(others, Runs([])) == []
