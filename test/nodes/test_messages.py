# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Markers that a viewer has received are deleted by name."""
from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip('rclpy')

from stereo_speed.core.records import TrackState, TrackUpdate  # noqa: E402, I100
from stereo_speed.nodes.messages import deletions, markers  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402


def test_each_marker_of_a_track_has_its_deletion():
    """A viewer knows a marker by namespace and number."""
    update = TrackUpdate(
        stamp_ns=1, track=7, lane='lane_0', state=TrackState.CONFIRMED, speed_mps=20.0,
        speed_std_mps=0.1, s_m=5.0, lateral_m=0.0, position_m=np.array([0.0, 1.0, 30.0]),
        position_cov_m2=np.eye(3), axes=np.eye(3), quad_left_px=np.zeros((4, 2)),
        quad_right_px=np.zeros((4, 2)))
    shown, gone = markers(update, 'left', 0.5), deletions(7, 'left')
    assert [(m.ns, m.id) for m in gone] == [(m.ns, m.id) for m in shown]
    assert {m.action for m in shown} == {Marker.ADD}
    assert {(m.action, m.header.frame_id) for m in gone} == {(Marker.DELETE, 'left')}
