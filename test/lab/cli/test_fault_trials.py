# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The table of trials is complete and gives its reasons."""
from __future__ import annotations

from pathlib import Path
import re

import pytest
from stereo_speed.lab.cli.fault_trials import ERROR, OK, played, TRIALS, WARN

THREE = ('stereo_sync_node', 'tracker_node', 'speed_node')


def test_every_fault_of_the_stream_is_played():
    pytest.importorskip('rclpy')
    from stereo_speed.nodes.faulty_replay_node import FAULTS
    streams = {name if trial.stream is None else trial.stream for name, trial in TRIALS.items()}
    assert streams == set(FAULTS)
    assert set(FAULTS) <= set(TRIALS)


@pytest.mark.parametrize('name', TRIALS)
def test_what_is_unusual_has_a_reason(name):
    trial = TRIALS[name]
    assert trial.level in (OK, WARN, ERROR)
    assert (trial.level == OK) == bool(trial.why_ok) == (not trial.task)
    assert trial.most is None or trial.most >= trial.level
    assert (trial.silent_s > 2.0) == bool(trial.why_silent)
    assert trial.reads or trial.always


def test_nodes_are_killed_only_where_they_are():
    """A vehicle's bag plays all but the one fault that needs a bag of its own."""
    one, three = played(('speed_camera_node',)), played(THREE)
    assert set(three) - set(one) == {f'kill_{node}' for node in THREE}
    assert set(one) - set(three) == {'kill_speed_camera_node'}
    assert set(TRIALS) - set(one) - set(three) == {'exposed_apart'}


def test_late_calibration_is_waited_for_by_more_pairs_than_are_kept():
    """50 pairs are kept; 20 come in a second."""
    trial = TRIALS['start_without_info']
    assert (trial.stream, trial.first_s, trial.always) == ('no_info', 0.0, False)
    assert trial.length_s is not None and 20 * trial.length_s > 50


def test_make_plays_every_trial():
    """All of one node with FAULTS empty, KILLS of three nodes, and one with a bag of its own."""
    text = (Path(__file__).resolve().parents[3] / 'Makefile').read_text()
    assert re.search('^FAULTS :=$', text, re.MULTILINE)
    kills = re.search('^KILLS := (.*)$', text, re.MULTILINE)[1].split()
    own = re.findall(r'--fault (\w+)', text)
    assert {*played(('speed_camera_node',)), *kills, *own} == set(TRIALS)
    assert set(kills) <= set(played(THREE))
