# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The self-test of ``tracker_node``: ERROR and no readings until it has passed."""
from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402, I100

from stereo_speed.cli.demo import Process, RELIABLE_INFOS  # noqa: E402

STARTUP_S, EVENT_S = 60.0, 40.0


def levels(stand_in):
    """Collect the states of the self-test as they arrive: level and message."""
    found = []

    def take(msg):
        found.extend((one.level, one.message) for one in msg.status
                     if one.name.endswith(': self-test'))
    stand_in.create_subscription(DiagnosticArray, '/diagnostics', take, 10)
    return found


def test_result_of_the_self_test_is_reported(stand_in, sample):
    """Reports during the test are tested in ``test/nodes/test_self_test.py``."""
    found = levels(stand_in)
    with Process('tracker_node', *RELIABLE_INFOS, f'site:={sample / "site.yaml"}',
                 f'self_test:={sample}'):
        stand_in.wait(lambda: found and found[-1] == (b'\x00', 'passed'), STARTUP_S + EVENT_S)


def test_failed_self_test_is_an_error(stand_in, sample):
    found = levels(stand_in)
    with Process('tracker_node', *RELIABLE_INFOS, f'site:={sample / "site.yaml"}',
                 f'self_test:={sample}', 'verdict.most_speed_mps:=10.0'):
        stand_in.wait(lambda: any('rejected: implausible' in text for _, text in found),
                      STARTUP_S + EVENT_S)
    assert found[-1][0] == b'\x02'
