# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Rows of ``faults`` are made of what was heard, and judged, by hand."""
from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from stereo_speed.io.truth import VehicleTruth
from stereo_speed.lab.cli.fault_rows import HEADING, is_back, Row, row_of, Times
from stereo_speed.lab.cli.fault_trials import TRIALS
from stereo_speed.lab.cli.fault_truth import Truth

SECOND = 10 ** 9
STAMPS = SECOND * np.arange(5)
# It brakes from 20 to 12 m/s.
Z_M = np.array([100.0, 81, 64, 49, 36])
TRUTH = Truth([VehicleTruth(7, STAMPS, np.array([20.0, 18, 16, 14, 12]),
                            np.stack([np.zeros(5), np.ones(5), Z_M], axis=1))])
TIMES = Times(10.0, 10.5, 11.0, SECOND, 10.0)
ROW = Row('black', True, 30, 0, 4, 0, 0, 0.7, 0.4, '', {'left camera': 2}, True)


def reading(row, speed_mps, std_mps):
    return SimpleNamespace(at_s=10.0 + row, ns=row * SECOND, frame_id='vehicle_0',
                           speed_mps=speed_mps, std_mps=std_mps)


def heard(*readings, passes=(), levels=(), x_m=0.0):
    return SimpleNamespace(
        readings=list(readings), passes=list(passes), levels=list(levels), begun_s=10.0,
        places={(int(ns), 'vehicle_0'): (x_m, 1.0, float(z_m))
                for ns, z_m in zip(STAMPS, Z_M)})


def row_with(*args, **kwargs):
    return row_of('none', heard(*args, **kwargs), TRUTH, TIMES, True, True)


def test_worst_reading_in_sigmas_is_reported_even_if_none_is_wrong(capsys):
    """Errors of 1 m/s at a sigma of 0.5 against 0.5 at 0.1; the truth is 16 and 14 m/s."""
    row = row_with(reading(2, 17.0, 0.5), reading(3, 13.5, 0.1))
    assert (row.readings, row.wrong, row.nowhere) == (2, 1, 0)
    wrong, worst = capsys.readouterr().err.splitlines()
    assert wrong.startswith('none: wrong: vehicle_0 3.0 s after the start: ')
    assert worst == wrong.replace('wrong', 'worst reading') and '-5.0 sigma' in worst
    assert row_with(reading(2, 17.0, 0.5)).wrong == 0
    assert 'off by +2.24, +2.0 sigma' in capsys.readouterr().err
    assert row_with().silent_s is None
    assert not capsys.readouterr().err


def test_silence_ends_with_the_first_right_reading_after_the_fault():
    """
    The fault ends 1 s after the start; the reading of 2 s is wrong.

    A reading of a pair before the end that comes late does not end the silence.
    """
    late = SimpleNamespace(**{**vars(reading(0, 20.0, 0.1)), 'at_s': 11.5})
    assert row_with(late).silent_s is None
    row = row_with(late, reading(2, 20.0, 0.1), reading(3, 14.0, 0.1))
    assert row.silent_s == pytest.approx(2.0)


def test_results_on_no_vehicle_are_counted_and_reported(capsys):
    """The places are 5 m beside the only vehicle; a rejected pass says nothing."""
    one = {'track': 0, 'speed_mps': 16.0, 'speed_std_mps': 0.1, 'first_stamp_ns': 0,
           'last_stamp_ns': 4 * SECOND}
    rejected = {**one, 'speed_mps': None, 'speed_std_mps': None}
    astray = {'passes': [one, rejected], 'x_m': 5.0}
    row = row_with(reading(2, 16.0, 0.1), reading(3, 14.0, 0.1), **astray)
    assert (row.readings, row.wrong, row.measured, row.wrong_passes, row.nowhere) == (
        0, 0, 0, 0, 3)
    err = capsys.readouterr().err
    assert err.count('none: on no vehicle: vehicle_0') == 2 and 'z = 5.0, 1.0, 64.0 m' in err
    assert err.count('none: pass on no vehicle') == 1
    assert row_with(passes=[one, rejected]).nowhere == 0
    missing = row_with(SimpleNamespace(**{**vars(reading(2, 16.0, 0.1)), 'frame_id': 'other'}))
    assert missing.nowhere == 1 and 'no position heard' in capsys.readouterr().err


def test_levels_are_the_highest_of_each_task_while_output_is_expected():
    """From 2 s after the start to its end; what only tells of a slow machine does not count."""
    row = row_with(levels=[
        (11.9, 'node: pairs', 2, 'no pair for 2 s'), (13.0, 'node: pairs', 1, '3 lost: x'),
        (14.0, 'node: left camera', 1, 'late'), (15.0, 'node: left camera', 2, 'black'),
        (15.5, 'node: pipeline', 1, 'measuring does not keep up: 3 pairs skipped; measuring '
         'barely keeps up: most'), (16.0, 'node: stamps', 0, 'fine'),
        (20.1, 'node: rig', 2, 'moved')])
    assert row.levels == {'pairs': 1, 'left camera': 2}
    assert row.said == ('pairs: WARN N lost; left camera: WARN late; left camera: ERROR black; '
                        'pipeline: WARN measuring does not keep up')


def test_levels_before_the_fault_are_shown_but_not_judged():
    row = row_of('none', heard(levels=[(13.0, 'node: pairs', 1, 'lost'),
                                       (14.5, 'node: rig', 1, 'moved')]),
                 TRUTH, Times(10.0, 14.0, 15.0, 5 * SECOND, 10.0), True, True)
    assert (row.levels, row.said) == ({'rig': 1}, 'pairs: WARN lost; rig: WARN moved')


@pytest.mark.parametrize('message, back', [
    ('stamps jumped back: all passes ended', False),
    ('measuring barely keeps up: most pairs are hurried', True),
    ('stamps jumped back: all passes ended; measuring does not keep up: 2 pairs skipped', False)])
def test_levels_are_back_if_the_newest_of_each_task_is_fine(message, back):
    before = [(1.0, 'node: pairs', 2, 'no pair'), (2.0, 'node: pairs', 0, 'fine')]
    assert is_back(heard(levels=before))
    assert is_back(heard(levels=[*before, (3.0, 'node: pipeline', 1, message)])) is back


def failures(name='black', length_s=3.0, rate=1.0, slack=3.0, **changed):
    return replace(ROW, fault=name, **changed).failures(TRIALS[name], length_s, rate, slack)


@pytest.mark.parametrize('changed, failure', [
    ({}, None),
    ({'alive': False}, 'a node has ended by itself'),
    ({'wrong': 1}, 'wrong results'),
    ({'wrong_passes': 1}, 'wrong results'),
    ({'nowhere': 1}, 'results on no vehicle'),
    ({'levels': {}}, 'left camera was at most OK, not ERROR'),
    ({'levels': {'left camera': 1, 'pipeline': 2}}, 'left camera was at most WARN, not ERROR'),
    ({'back': False}, '/diagnostics was not OK again'),
    ({'readings': 0, 'silent_s': None}, 'no reading'),
    ({'silent_s': None}, 'no right reading after the fault'),
    ({'silent_s': 5.9}, None),
    ({'silent_s': 6.1}, 'no right reading for more than 6.0 s')])
def test_row_fails_for_whatever_is_not_as_expected(changed, failure):
    """2 s are allowed after ``black``, and three times as many on a slow machine."""
    assert failures(**changed) == ([failure] if failure else [])


def test_level_must_not_be_higher_than_the_fault_is_bad():
    assert failures('none', levels={}) == []
    assert failures('none', levels={'pairs': 1}) == ['/diagnostics was WARN, not at most OK']
    assert failures('twice', levels={'left camera': 1, 'pipeline': 2}) == [
        '/diagnostics was ERROR, not at most WARN']
    # The images of a camera without the profile may be lost, and are counted.
    for levels in {}, {'left camera': 1}:
        assert failures('camera_without_profile', levels=levels) == []
    assert failures('camera_without_profile', levels={'pairs': 2})


def test_fault_that_is_too_brief_for_an_error_is_a_warning_of_any_task():
    assert failures('black', 2.0, levels={'pipeline': 1}) == []
    assert failures('black', 2.0, levels={}) == ['/diagnostics was at most OK, not WARN']
    assert failures('black', 3.0, levels={'pipeline': 1})
    assert failures('black', 3.0, rate=2.0, levels={'pipeline': 1}) == []


def test_fault_to_the_end_need_not_be_over_before_it():
    assert failures('jitter', levels={'stamps': 1}, back=False) == []
    assert failures('twice', levels={'left camera': 1}, back=False)


@pytest.mark.parametrize('name', ['swapped', 'right_50_ms', 'no_info'])
def test_no_reading_is_wanted_where_none_can_be(name):
    levels = {TRIALS[name].task: 2}
    assert failures(name, readings=0, silent_s=None, levels=levels, back=False) == []


def test_limits_of_silence_follow_slack_and_a_slow_replay():
    for slack, rate, limit_s in (1.0, 1.0, 2.0), (3.0, 0.5, 12.0), (2.0, 2.0, 4.0):
        assert failures(rate=rate, slack=slack, silent_s=limit_s - 0.1) == []
        assert failures(rate=rate, slack=slack, silent_s=limit_s + 0.1) == [
            f'no right reading for more than {limit_s:.1f} s']


def test_line_has_all_columns_and_tells_of_lateness_and_failure():
    late = replace(ROW, silent_s=2.1)
    assert late.is_late(TRIALS['black'], 1.0) and not ROW.is_late(TRIALS['black'], 1.0)
    assert not replace(ROW, silent_s=None).is_late(TRIALS['black'], 1.0)
    columns = [word.strip() for word in HEADING.splitlines()[0].split('|')]
    cells = [word.strip() for word in late.line([], True).split('|')]
    assert len(cells) == len(columns)
    told = dict(zip(columns, cells))
    assert told['right again after, s'] == '2.1 (late)' and told['result'] == 'as expected'
    assert told['on no vehicle'] == '0'
    assert ROW.line(['no reading', 'wrong results'], False).endswith(
        '| 0.4 |  | yes | FAILED: no reading, wrong results |')
