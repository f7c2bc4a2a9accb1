# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's tables as data, what is run for them, and what comes out."""
from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from stereo_speed.core.config import TrackerConfig
from stereo_speed.core.errors import InputError
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.drives import DriveRun, VehicleRun
from stereo_speed.lab.evaluation.experiments import plan, Runs, sequence_experiment
from stereo_speed.lab.evaluation.paper import FINDINGS, TABLE_1A, TABLE_1B, TABLE_2A, TABLE_2B, TABLES
from stereo_speed.lab.evaluation.paper_tables import (
    checks, checks_text, contest_table, paper_table, PaperPlan)
from stereo_speed.lab.evaluation.runner import Result
from stereo_speed.lab.evaluation.sequences import SEQUENCES
from stereo_speed.lab.evaluation.tables import Table

SMALL = PaperPlan(table_seeds=range(2), compare_seeds=range(2))


def test_cells_that_are_the_same_experiment_have_the_same_figures():
    def row(table, value):
        return next(r for r in table.rows if r.value == value)
    assert row(TABLE_1A, 200).max_error_mph == row(TABLE_1B, 10).max_error_mph == 0.33
    assert row(TABLE_2A, 400).max_error_mph == row(TABLE_2B, 0.15).max_error_mph == 0.961
    assert row(TABLE_2A, 400).speed_mph == row(TABLE_2B, 0.15).speed_mph == 27.86
    for a, na, b, nb in ((TABLE_1A, 200, TABLE_1B, 10), (TABLE_2A, 400, TABLE_2B, 0.15)):
        assert SMALL.cell(a, row(a, na)) == SMALL.cell(b, row(b, nb))


@pytest.mark.parametrize('table', [TABLE_1A, TABLE_2A], ids=lambda t: t.name)
def test_the_papers_times_grow_evenly_with_the_particles(table):
    n, ms = np.array([(r.value, r.ms) for r in table.rows]).T
    slope, start = np.polyfit(n, ms, 1)
    assert np.abs(np.polyval([slope, start], n) - ms).max() < 0.05 * ms.max()


def test_the_papers_maximum_is_no_less_than_its_mean_error():
    for table in TABLES:
        for row in table.rows:
            assert row.max_error_mph >= abs(row.speed_mph - table.truth_mph)


def test_cells_vary_what_their_table_varies():
    changes = [SMALL.cell(TABLE_2B, row).changes for row in TABLE_2B.rows]
    # per frame at 5 frames/s to per square root of a second
    assert [c['speed_rate_std'] for c in changes] == pytest.approx(
        [0.1118, 0.2236, 0.3354, 0.4472, 0.5590], abs=1e-4)
    assert {c['particles'] for c in changes} == {400}
    parts = [SMALL.cell(TABLE_1B, row).changes.get('parts', TrackerConfig().parts)
             for row in TABLE_1B.rows]
    assert parts == [4, 6, 8, 10, 12, 16]


def test_each_run_is_planned_once_and_those_of_one_drive_follow_one_another():
    jobs = plan(SMALL.cells() + SMALL.contests(), range(2))
    assert len({job.key for job in jobs}) == len(jobs)
    # 21 cells of which 2 are in two tables; of the 7 contests 2 are cells as well
    assert len(jobs) == 2 * (19 + 7 - 2)
    groups = [job.group for job in jobs]
    assert len(set(groups)) == 2 * len(SEQUENCES)
    assert groups == sorted(groups)


def test_findings_are_of_sequences_we_compare():
    assert {sequence for sequence, _ in FINDINGS} <= set(SMALL.compared) <= set(SEQUENCES)


@pytest.mark.parametrize(('sequence', 'tracker'), [('moon', 'constrained'), ('curve28', 'luck')])
def test_unknown_names_are_refused(sequence, tracker):
    with pytest.raises(InputError, match=sequence if sequence == 'moon' else tracker):
        sequence_experiment(sequence, tracker)


def runs_with(plan_, errors_mph):
    """Make the runs of a plan: five readings, the last two off as told, seed by seed."""
    results = []
    for seed, error in enumerate(errors_mph):
        for e in plan_.cells() + plan_.contests():
            n = len(SEQUENCES[e.source.sequence].vehicles)
            speeds = [50 * MPH_MPS] * 3 + [(50 + 2 * error) * MPH_MPS, (50 + error) * MPH_MPS]
            drive = DriveRun(stray_tracks=0, cpu_ms=10.0, vehicles=[VehicleRun(
                vehicle=k, stamps_ns=[0, 1, 2, 3, 4], speeds_mps=speeds, stds_mps=[0.1] * 5,
                confirmed=[True] * 5, truth_mps=[50 * MPH_MPS] * 5, seen_pairs=5)
                for k in range(n)])
            results.append(Result(key=e.key(seed), fingerprint='', value=drive.to_json()))
    return Runs(results)


def test_a_table_shows_the_papers_figures_beside_ours():
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


def test_a_comparison_has_a_row_for_each_vehicle_and_counts_failed_runs_as_lost():
    runs = runs_with(SMALL, [0.1])  # the second seed failed
    table = contest_table(SMALL, 'two_vehicles', runs)
    assert len(table.rows) == 2
    lost = table.columns.index('lost')
    assert [row[lost] for row in table.rows] == ['1/2', '1/2']


def test_checks_tell_what_does_not_hold():
    good = checks(SMALL, runs_with(SMALL, [0.1, -0.05]))
    # half of 0.25 mph is the least that is asked for
    assert [c for c in good if not c.holds] == []
    assert sum('times shorter' in c.claim for c in good) == 2
    bad = checks(SMALL, runs_with(SMALL, [0.1, -0.3]))
    assert {c.claim.split(':')[0] for c in bad if not c.holds} == {
        'Table I(a), 200', 'Table I(a), 400', 'Table I(a), 600', 'Table I(a), 800',
        'Table I(b), 10', 'Table I(b), 12', 'Table I(b), 16', 'Table II(a), 800'}
    missing = checks(SMALL, runs_with(SMALL, [0.1]))
    assert not any(c.holds for c in missing if 'maximum error' in c.claim)
    assert '- **NO**: ' in checks_text(bad)


def test_quick_is_small():
    quick = SMALL.quick()
    assert [len(t.rows) for t in quick.tables] == [2] * 4
    assert len(plan(quick.cells() + quick.contests(), range(1))) <= 9


def test_markdown_shows_dashes_where_nothing_is_known():
    table = Table(title='t', columns=('a', 'b', 'c'), rows=[['x|y', float('nan'), 1.23456]],
                  digits=(0, 2, 3))
    assert table.markdown() == '**t**\n\n| a | b | c |\n|---|---|---|\n| x\\|y | - | 1.235 |\n'
    assert table.csv() == 'a,b,c\nx|y,,1.23456\n'


def test_without_ours_nothing_is_asked_of_it():
    others = PaperPlan(tables=(), compared=('straight55',), trackers=('kalman',))
    assert checks(others, Runs([])) == []
