# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Arguments of ``faults`` that cannot be used are refused before anything is started."""
from __future__ import annotations

import argparse
import os

import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.lab.cli import faults
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


def test_slack_is_three_and_at_least_one(capsys):
    assert parsed().slack == 3.0
    with pytest.raises(SystemExit):
        parsed('--slack', '0.5')
    assert 'not in [1, 100]' in capsys.readouterr().err


@pytest.mark.parametrize('name, role, there', [
    ('none', 'camera', True), ('camera_without_profile', 'camera', False),
    ('camera_without_profile', 'nodes', True), ('all_without_profile', 'camera', False),
    ('all_without_profile', 'nodes', False)])
def test_processes_start_without_the_profile_and_others_keep_it(monkeypatch, name, role, there):
    variable = 'FASTRTPS_DEFAULT_PROFILES_FILE'
    monkeypatch.setenv(variable, 'a.xml')
    with faults.profile_of(role, TRIALS[name]):
        assert os.environ.get(variable) == ('a.xml' if there else None)
    assert os.environ[variable] == 'a.xml'
    monkeypatch.delenv(variable)
    with faults.profile_of(role, TRIALS[name]):
        pass
    assert variable not in os.environ
