# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``/diagnostics`` reports that the neighbour of a node is missing, until it is back."""
from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402, I100
from nav_msgs.msg import Odometry  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402

from stereo_speed.cli.demo import Process  # noqa: E402
from stereo_speed.nodes.common import PAIR_TOPIC, RELIABLE  # noqa: E402
from stereo_speed.nodes.health import ERROR, OK, WARN  # noqa: E402

STARTUP_S, EVENT_S = 60.0, 30.0
FAST = 'diagnostic_updater.period:=0.1'
SPEED, SYNC = 'speed_node: readings', 'stereo_sync_node: pairs'
NOBODY = 'nobody subscribes to stereo/image_pair'


def test_missing_tracker_is_reported_by_both_of_its_neighbours(stand_in):
    """No images come, which has its own finding."""
    said = {}
    stand_in.create_subscription(
        DiagnosticArray, '/diagnostics',
        lambda msg: said.update({s.name: (s.level, s.message) for s in msg.status}), 50)

    def tracker():
        """Return the ends of the topics that the tracker would have."""
        return (stand_in.create_publisher(Odometry, 'tracks', RELIABLE),
                stand_in.create_subscription(Image, PAIR_TOPIC, lambda msg: None, RELIABLE))

    def is_reported():
        return said[SPEED] == (ERROR, 'nobody publishes tracks') \
            and said[SYNC][0] >= WARN and NOBODY in said[SYNC][1]

    def is_well():
        return said[SPEED] == (OK, 'publishing') and NOBODY not in said[SYNC][1]
    with Process('speed_node', FAST), Process('stereo_sync_node', FAST):
        stand_in.wait(lambda: {SPEED, SYNC} <= set(said), STARTUP_S)
        assert is_well()  # it may still be starting
        stand_in.wait(is_reported, EVENT_S)
        ends = tracker()
        stand_in.wait(is_well, EVENT_S)
        stand_in.destroy_publisher(ends[0])
        stand_in.destroy_subscription(ends[1])
        stand_in.wait(is_reported, EVENT_S)
        tracker()
        stand_in.wait(is_well, EVENT_S)
