# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Targets as messages, field by field."""
from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip('rclpy')

from std_msgs.msg import Header  # noqa: E402, I100
from stereo_speed.monocular.boxes import TargetEstimate, TargetState  # noqa: E402
from stereo_speed.nodes.environment_messages import (  # noqa: E402
    FIELDS, RECORD, target_deletions, target_markers, tracks_message)
from visualization_msgs.msg import Marker  # noqa: E402


def estimate(number=7, **changes):
    fields = {'state': TargetState.TRACKED, 'box_px': np.array([10.0, 20, 30, 40]),
              'angle_rad': 0.0, 'distance_px': -2.5, 'distance_rate_px': 0.5, 'similarity': 0.75,
              'velocity_px': np.zeros(2), **changes}
    return TargetEstimate(frame=3, id=number, **fields)


def test_points_by_hand():
    header = Header(frame_id='camera')
    message = tracks_message([estimate(), estimate(9, state=TargetState.OCCLUDED,
                                                   distance_px=math.inf)], header)
    rows = np.frombuffer(bytes(message.data), RECORD)
    assert rows[0].tolist() == (25.0, 60.0, 0.0, 7, 10.0, 20.0, 30.0, 40.0, 0.0, -2.5, 0.5, 0.75,
                                0)
    assert rows[1]['id'] == 9 and rows[1]['hidden'] == 1 and math.isinf(rows[1]['d_px'])
    assert (message.header.frame_id, message.width, message.height) == ('camera', 2, 1)
    assert not message.is_dense and tracks_message([estimate()], header).is_dense
    assert message.point_step * 2 == message.row_step == len(message.data)


def test_fields_describe_the_bytes():
    """Independent reference: the record type, by which numpy reads them."""
    message = tracks_message([], Header())
    assert [(f.name, f.offset) for f in message.fields] == [
        (name, RECORD.fields[name][1]) for name in FIELDS]
    kinds = {f.name: f.datatype for f in message.fields}
    assert {n for n, kind in kinds.items() if kind == message.fields[0].INT32} == {'id', 'hidden'}
    assert len(message.data) == 0


def test_markers_and_their_removal():
    box, text = target_markers(estimate(), Header(), 0.01)
    corners = [(p.x, p.y) for p in box.points]
    np.testing.assert_allclose(corners, np.array(
        [[10, 20], [40, 20], [40, 60], [10, 60], [10, 20]]) / 100)
    assert text.text == '7 (d -2 px)'
    removed = target_deletions(7, Header())
    assert [(m.ns, m.id) for m in removed] == [(m.ns, m.id) for m in (box, text)]
    assert all(m.action == Marker.DELETE for m in removed)
    occluded, text = target_markers(
        estimate(state=TargetState.OCCLUDED, distance_px=math.inf), Header(), 0.01)
    assert occluded.color != box.color and text.text == '7 (inaccessible)'
