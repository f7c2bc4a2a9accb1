# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The live rig against its site: ``tracker_node`` looks at it in a process of its own."""
from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402, I100

from stereo_speed.cli.demo import (  # noqa: E402
    EVERY_PAIR, Process, RELIABLE_IMAGES, RELIABLE_INFOS)

STARTUP_S, LOOK_S = 60.0, 240.0


def test_a_look_at_the_rig_is_told(stand_in, sample):
    states = []
    stand_in.create_subscription(
        DiagnosticArray, '/diagnostics',
        lambda m: states.extend(s for s in m.status if s.name.endswith(': rig')), 10)
    with Process('speed_camera_node', *RELIABLE_IMAGES, *RELIABLE_INFOS, *EVERY_PAIR,
                 f'site:={sample / "site.yaml"}', 'rig_check_interval_s:=3600',
                 'rig_check_pairs:=4', 'rig_check_spread_s:=0.0'):
        stand_in.wait(lambda: stand_in.count_subscribers('/left/image_raw'), STARTUP_S)
        with Process('replay_node', f'bag:={sample / "bag"}', 'rate:=2'):
            stand_in.wait(lambda: states and states[-1].message.startswith('rig and lines'),
                          LOOK_S)
    assert states[-1].level == b'\x00'
