# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""When messages of a bag are due, whatever their first stamps are."""
from __future__ import annotations

from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy')

from stereo_speed.io.bags import BagMessage  # noqa: E402, I100
from stereo_speed.nodes.replay_node import ReplayNode  # noqa: E402

T0 = 1_700_000_000_000_000_000
MS = 1_000_000


def told(text, start_s=0.0):
    """
    Return the messages that are played.

    :param text: side, kind and stamp in ms of each message, such as ``LI 200`` or ``LC zero``, and
        the time in ms at which it was recorded.
    """
    messages = []
    for number, word in enumerate(text.split(', ')):
        what, stamp, *log = word.split()
        messages.append(BagMessage(
            '', None, T0 + (int(log[0]) if log else 100 * number) * MS, '',
            {'L': 'left', 'R': 'right'}[what[0]], {'I': 'image', 'C': 'camera_info'}[what[1]],
            0 if stamp == 'zero' else T0 + int(stamp) * MS))
    node = SimpleNamespace(messages=lambda: iter(messages), start_s=start_s, _message=id)
    return list(ReplayNode._due(node))


def times(played):
    """Return when messages are due, ms, and what they are."""
    return [(round(1e3 * one.due_s), f'{one.message.side[0]}{one.message.kind[0]}'.upper())
            for one in played]


@pytest.mark.parametrize(('bag', 'played'), [
    ('LC 0, RC 0, LI 0, RI 0, LC 200, LI 200, RI 200',
     [(0, 'LC'), (0, 'RC'), (0, 'LI'), (0, 'RI'), (200, 'LC'), (200, 'LI'), (200, 'RI')]),
    ('LC zero, RC zero, LI 0, RI 0, LI 200', [
        (0, 'LC'), (0, 'RC'), (0, 'LI'), (0, 'RI'), (200, 'LI')]),  # drivers without a stamp
    ('LI 0, LC zero, RC zero, RI 0, LI 200, LC 200', [
        (0, 'LI'), (0, 'LC'), (0, 'RC'), (0, 'RI'), (200, 'LI'), (200, 'LC')]),
    ('LC -90000, RC 90000, LI 0, RI 0', [(0, 'LC'), (0, 'RC'), (0, 'LI'), (0, 'RI')]),
    ('LI 0, RI -5, LI 200, RI 195', [(0, 'LI'), (-5, 'RI'), (200, 'LI'), (195, 'RI')]),
    ('LI 0 0, LI 3600000 200, LI 400 400, LI 600 600', [  # one stamp is an hour ahead
        (0, 'LI'), (200, 'LI'), (400, 'LI'), (600, 'LI')]),
    ('LI zero 0, LI 200 200, LI 400 400', [(0, 'LI'), (200, 'LI'), (400, 'LI')]),
    ('LI 0 0, LI 60000 60000', [(0, 'LI'), (60000, 'LI')])])  # the recording paused
def test_messages_are_due_by_the_stamps_of_images(bag, played):
    assert times(told(bag)) == played


@pytest.mark.parametrize(('stamps', 'clock_ms'), [
    ('0 200 400', [0, 200, 400]), ('0 3600000 400 600 800', [0, 0, 0, 600, 800]),
    ('zero 200 400 600', [None, None, 400, 600]), ('0 -200 400', [0, 0, 400])])
def test_clock_does_not_follow_single_wrong_stamps(stamps, clock_ms):
    played = told(', '.join(f'LI {stamp}' for stamp in stamps.split()))
    assert [None if not one.clock_ns else (one.clock_ns - T0) // MS
            for one in played] == clock_ms


def test_clock_goes_on_after_a_pause_of_the_recording():
    played = told('LI 0 0, LI 60000 60000')
    assert [(one.clock_ns - T0) // MS for one in played] == [0, 60000]


def test_last_calibrations_before_the_start_are_played():
    bag = 'LC 0, RC 0, LI 0, RI 0, LC 200, LI 200, RI 200, LI 400, RI 400'
    assert times(told(bag, start_s=0.3)) == [(100, 'LC'), (100, 'RC'), (100, 'LI'), (100, 'RI')]
    assert told(bag, start_s=0.5) == []
