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
    Return the messages that are played as (due time in ms, side and kind).

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
    return [(round(1e3 * due_s), f'{message.side[0]}{message.kind[0]}'.upper())
            for due_s, message, _ in ReplayNode._due(node)]


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
    assert told(bag) == played


def test_last_calibrations_before_the_start_are_played():
    bag = 'LC 0, RC 0, LI 0, RI 0, LC 200, LI 200, RI 200, LI 400, RI 400'
    assert told(bag, start_s=0.3) == [(100, 'LC'), (100, 'RC'), (100, 'LI'), (100, 'RI')]
    assert told(bag, start_s=0.5) == []
