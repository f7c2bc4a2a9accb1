# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Summaries of both estimates, worked by hand, and one pass through the command."""
from __future__ import annotations

import csv

import pytest
from stereo_speed.cli.main import main
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.evaluation.second import second_table, SecondRun, wrong_firsts


def a_run(first, second, *, rejected=False, wrong=(True, True), path='straight'):
    """Make a pass at 20 m/s whose estimates have given errors in mph."""
    return SecondRun(
        kinds={'path': path}, truth_mps=20.0, rejected=rejected, wrong=wrong,
        first_mps=None if first is None else 20 + first * MPH_MPS, first_std_mps=0.1,
        second_mps=None if second is None else 20 + second * MPH_MPS, second_std_mps=0.2)


def test_figures_by_hand():
    passes = [a_run(0.0, 0.2), a_run(0.0, -0.1, wrong=(True, False)),
              a_run(0.1, None, rejected=None, wrong=(None, None), path='circle'),
              a_run(None, None, wrong=()),
              a_run(5.0, 0.0, rejected=True, wrong=()), a_run(0.0, 0.5, rejected=True)]
    table = second_table(passes)
    row = dict(zip(table.columns, next(r for r in table.rows if r[0] == 'all')))
    assert row['passes measured'] == 5
    assert row['with a second estimate'] == '4 of 5'
    assert row['mean error of the second, mph'] == '+0.150'
    assert row['max, mph'] == '0.500'
    assert row['right passes rejected'] == '1 of 4'
    assert row['right passes not compared'] == '1 of 4'
    assert row['wrong passes rejected'] == '5 of 8'
    assert row['wrong passes not compared'] == '2 of 8'
    assert row['wrong passes accepted'] == '1 of 8'
    assert [r[0] for r in table.rows] == ['all', 'path: circle', 'path: straight']
    assert wrong_firsts(passes) == (1, 1)


@pytest.mark.slow
def test_pass_through_the_command(tmp_path, capsys):
    assert main(['second', '--passes', '1', '--lines', 'exact', '--jobs', '0', '--out',
                 str(tmp_path)]) == 0
    row, = csv.DictReader((tmp_path / 'passes.csv').open())
    assert abs(float(row['second_mps']) - float(row['truth_mps'])) \
        < 4 * float(row['second_std_mps'])
    assert '| all | 1 | 1 of 1 |' in capsys.readouterr().out
    assert '2 of 2' in (tmp_path / 'second.md').read_text()  # both wrong ones are found
