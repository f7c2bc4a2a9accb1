# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Boxes through their message, and malformed messages."""
from __future__ import annotations

import struct

import pytest

pytest.importorskip('rclpy')

from sensor_msgs.msg import PointCloud2, PointField  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from stereo_speed.core.errors import InputError  # noqa: E402
from stereo_speed.detection.protocol import ImageBox  # noqa: E402
from stereo_speed.nodes.boxes import boxes_from_message, boxes_message  # noqa: E402


@pytest.mark.parametrize('boxes', [
    [], [ImageBox(left_px=1.5, top_px=2.0, width_px=30.0, height_px=20.0, score=0.5)],
    [ImageBox(left_px=float(k), top_px=0.0, width_px=8.0, height_px=4.0) for k in range(3)]],
    ids=len)
def test_boxes_come_back(boxes):
    msg = boxes_message(boxes, Header())
    assert msg.width == len(boxes) and boxes_from_message(msg) == boxes


def test_cloud_without_points_is_no_vehicle_whatever_its_layout():
    assert boxes_from_message(PointCloud2()) == []
    assert boxes_from_message(cloud(FLOATS, b'', 0, width=0)) == []


def cloud(fields, data, step, width=1, **changes):
    """Return a cloud of fields (name, datatype, offset)."""
    return PointCloud2(
        height=1, width=width, point_step=step, row_step=step * width, data=data,
        fields=[PointField(name=n, datatype=kind, offset=at, count=1) for n, kind, at in fields],
        **changes)


def test_other_layouts_are_read_by_their_fields():
    """Big-endian doubles and a short, other fields between them, no score."""
    fields = [('height', PointField.FLOAT64, 0), ('class', PointField.UINT8, 8),
              ('y', PointField.INT16, 9), ('x', PointField.FLOAT64, 11),
              ('width', PointField.FLOAT64, 19)]
    data = struct.pack('>dBhdd', 40.0, 7, -3, 12.25, 60.0)
    assert boxes_from_message(cloud(fields, data, len(data), is_bigendian=True)) == [
        ImageBox(left_px=12.25, top_px=-3.0, width_px=60.0, height_px=40.0, score=1.0)]


FLOATS = [(n, PointField.FLOAT32, 4 * k) for k, n in enumerate(('x', 'y', 'width', 'height'))]


@pytest.mark.parametrize(('msg', 'words'), [
    (cloud(FLOATS[:3], bytes(12), 12), 'fields: found x, y, width, wanted x, y, width, height'),
    (cloud(FLOATS, bytes(15), 16), 'data: found 15 bytes, wanted 16 for 1 points'),
    (cloud(FLOATS, struct.pack('<4f', 1, 2, float('nan'), 4), 16), 'not finite'),
    (cloud(FLOATS, bytes(12), 12), 'point_step: found 12, wanted 16, where the fields end'),
    (cloud(FLOATS, bytes(16), 0), 'point_step: found 0, wanted 16, where the fields end'),
], ids=['field', 'short', 'nan', 'beyond', 'no step'])
def test_invalid_box_is_refused(msg, words):
    with pytest.raises(InputError, match=words):
        boxes_from_message(msg)
