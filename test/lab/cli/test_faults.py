# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Arguments that cannot be used are refused at once; rows are played again only when late."""
from __future__ import annotations

import argparse
from dataclasses import replace
import os

import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.lab.cli import fault_play, faults
from stereo_speed.lab.cli.fault_rows import Row
from stereo_speed.lab.cli.fault_trials import TRIALS


def parsed(*words):
    parser = argparse.ArgumentParser()
    faults.add_arguments(parser)
    return parser.parse_args(['folder', *words])


@pytest.mark.parametrize('words, match', [
    (('--fault', 'sabotage'), 'sabotage.*one of none, '),
    (('--fault', 'kill_tracker_node', '--single'), 'kill_tracker_node.*one of the nodes'),
    (('--fault', 'none', '--fault', 'kill_speed_camera_node'), 'kill_speed_camera_node')])
def test_fault_that_cannot_be_played_is_refused(words, match):
    with pytest.raises(InputError, match=match):
        faults.run(parsed(*words))


def test_slack_is_four_and_at_least_one(capsys):
    assert parsed().slack == 4.0
    with pytest.raises(SystemExit):
        parsed('--slack', '0.5')
    assert 'not in [1, 100]' in capsys.readouterr().err


GOOD = Row('black', True, 30, 0, 4, 0, 0, 1.0, 0.4, '', {'left camera': 2})


@pytest.mark.parametrize('rows, played, status', [
    ([GOOD], 1, 0), ([replace(GOOD, silent_s=20.0), GOOD], 2, 0),
    ([replace(GOOD, silent_s=20.0)] * 2, 2, 1), ([replace(GOOD, wrong=1), GOOD], 1, 1),
    ([replace(GOOD, nowhere=1), GOOD], 1, 1), ([replace(GOOD, alive=False), GOOD], 1, 1),
    ([replace(GOOD, levels={}), GOOD], 2, 0)])
def test_late_row_is_played_again_and_a_wrong_one_is_not(
        rows, played, status, monkeypatch, capsys):
    monkeypatch.setattr(faults, 'recorded', lambda folder: None)
    monkeypatch.setattr(faults, 'private_graph', lambda: None)
    left = list(rows)
    monkeypatch.setattr(faults, 'play', lambda how, recorded: left.pop(0))
    assert faults.run(parsed('--single', '--fault', 'black', '--again', '1')) == status
    out, err = capsys.readouterr()
    assert out.count('| `black`') == played
    assert err.count(': FAILED: ') == played - (status == 0)
    assert err.endswith('\nFAILED: black\n') is (status == 1)  # once more, after all rows


def test_trial_keeps_times_of_its_own():
    args = parsed('--single', '--start', '6', '--length', '2')
    of_its_own = faults.playing('start_with_info_nan', args)
    assert (of_its_own.first_s, of_its_own.length_s) == (0.0, 1.0)
    usual = faults.playing('black', args)
    assert (usual.first_s, usual.length_s) == (6.0, 2.0)


@pytest.mark.parametrize('name, role, there', [
    ('none', 'camera', True), ('camera_without_profile', 'camera', False),
    ('camera_without_profile', 'nodes', True), ('all_without_profile', 'camera', False),
    ('all_without_profile', 'nodes', False)])
def test_processes_start_without_the_profile_and_others_keep_it(monkeypatch, name, role, there):
    variable = 'FASTRTPS_DEFAULT_PROFILES_FILE'
    monkeypatch.setenv(variable, 'a.xml')
    with fault_play.profile_of(role, TRIALS[name]):
        assert os.environ.get(variable) == ('a.xml' if there else None)
    assert os.environ[variable] == 'a.xml'
    monkeypatch.delenv(variable)
    with fault_play.profile_of(role, TRIALS[name]):
        pass
    assert variable not in os.environ
