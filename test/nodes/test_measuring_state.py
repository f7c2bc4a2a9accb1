# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Counts of pairs and stamps raise diagnostic levels, and lower them again."""
from __future__ import annotations

from math import copysign
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy')

from stereo_speed.core.stamp_watch import StampWatch  # noqa: E402, I100
from stereo_speed.nodes.health import ERROR, OK, State, WARN  # noqa: E402
from stereo_speed.nodes.measuring_state import (  # noqa: E402
    ClockSteps, Counts, tell_rig, tell_stamps)
from stereo_speed.steadying.view_focus import Focus, ViewFocus  # noqa: E402


def stepped(times):
    """Return a stand-in for a pipeline with a number of clock steps."""
    watch = StampWatch()
    watch.steps, watch.last_step_s = times, 0.03
    return SimpleNamespace(doubt=SimpleNamespace(stamps=watch))


def told(steps, pipeline):
    state = State('fine')
    steps.tell(pipeline, state)
    return state.level, state.message, state.values['clock_steps']


def test_step_of_the_clock_is_reported():
    assert told(ClockSteps(), stepped(1)) == (
        WARN, 'the clock stepped by +30.0 ms: passes at that moment are rejected', 1)


def test_steps_of_a_new_pipeline_are_counted_from_its_start():
    """Otherwise the first check after a new calibration finds fewer steps, and warns."""
    now_s = [0.0]
    steps, before = ClockSteps(lambda: now_s[0]), stepped(3)
    assert told(steps, before)[0] == WARN
    now_s[0] = 60.0
    assert told(steps, before)[0] == OK
    assert told(steps, stepped(0)) == (OK, 'fine', 0)


@pytest.mark.parametrize(('name', 'level', 'says'), [
    ('resets', WARN, 'stamps jumped back'),
    ('skipped', WARN, 'measuring does not keep up: 1 pairs'),
    ('early', WARN, 'pairs were too old when measuring began: 1'),
    ('frozen', WARN, '1 pairs withheld'), ('failed', ERROR, 'measuring failed 1 times')])
def test_faults_are_reported_with_their_counts(name, level, says):
    counts, state = Counts(), State('fine')
    counts.tell(state)
    assert (state.level, state.message) == (OK, 'fine')
    getattr(counts, name).add()
    counts.tell(state)
    assert state.level == level and says in state.message and state.values[name] == 1


def test_latencies_are_reported_once_there_are_any():
    counts, state = Counts(), State('fine')
    counts.tell(state)
    assert 'latency_p50_s' not in state.values
    counts.latencies_s.extend([0.01, 0.02, 0.03])
    counts.tell(state)
    assert state.values['latency_p50_s'] == 0.02


@pytest.mark.parametrize(('lag', 'level', 'says'), [
    ({'std_s': 3e-3}, ERROR, 'not known yet'), ({'correction_s': 5e-3}, WARN, 'corrected'),
    ({'constant': True}, WARN, 'corrected'), ({}, WARN, 'as the exposures are')])
def test_image_evidence_on_the_lag_between_views_is_reported(lag, level, says):
    known = {'gap_s': 5e-3, 'looks': 9, 'correction_s': 0.0, 'std_s': 1e-3, 'constant': False}
    state = State('fine')
    estimated = SimpleNamespace(state=SimpleNamespace(**{**known, **lag}))
    tell_stamps(SimpleNamespace(
        uneven_stamps_s=None, doubt=SimpleNamespace(lag=estimated)), state)
    assert state.level == level and '5.0 ms apart' in state.message and says in state.message


@pytest.mark.parametrize('blur_px2, level, says', [
    (4.0, WARN, 'the right camera is out of focus'), (-4.0, WARN, 'the left camera'),
    (0.3, OK, '')])
def test_focus_of_the_cameras_is_reported_on_a_rigid_mount_too(blur_px2, level, says):
    state, focus = State('fine'), ViewFocus()
    focus.state = Focus(looks=2, blur_px2=blur_px2)
    tell_rig(SimpleNamespace(focus=focus, steadier=None), state)
    assert state.level == level and says in state.message
    assert state.values['focus_right_blur_px'] == pytest.approx(
        copysign(abs(blur_px2) ** 0.5, blur_px2), abs=0.01)
