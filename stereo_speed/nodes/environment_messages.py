# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Targets of the monocular tracker as ROS messages."""
from __future__ import annotations

import math
from typing import Sequence

from geometry_msgs.msg import Point
import numpy as np
from rclpy.duration import Duration
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from ..monocular.boxes import corners, TargetEstimate, TargetState

# Fields of the point of a target, in px of the raw image except the angle.  x, y, z, the middle of
# the box's lower edge, come first, so that any viewer can show the points.
FIELDS = ('x', 'y', 'z', 'id', 'left', 'top', 'width', 'height', 'angle_rad', 'd_px', 'd_rate_px',
          'similarity', 'hidden')
_INTEGERS = ('id', 'hidden')
RECORD = np.dtype([(name, '<i4' if name in _INTEGERS else '<f4') for name in FIELDS])
_OFFSETS = range(0, RECORD.itemsize, 4)  # offsets of the fields, each of four bytes
_LIFETIME = Duration(nanoseconds=500_000_000)  # lifetime of markers, a few frames of any camera


def tracks_message(estimates: Sequence[TargetEstimate], header: Header) -> PointCloud2:
    """Return the message for the targets of a frame; infinite distances clear ``is_dense``."""
    rows = np.zeros(len(estimates), RECORD)
    for row, e in zip(rows, estimates):
        x, y, w, h = e.box_px
        values = (x + w / 2, y + h, 0.0, e.id, x, y, w, h, e.angle_rad, e.distance_px,
                  e.distance_rate_px, e.similarity, e.state is TargetState.OCCLUDED)
        for name, value in zip(FIELDS, values):
            row[name] = value
    dense = all(math.isfinite(e.distance_px) and math.isfinite(e.distance_rate_px)
                for e in estimates)
    fields = [PointField(name=name, offset=offset, count=1,
                         datatype=PointField.INT32 if name in _INTEGERS else PointField.FLOAT32)
              for name, offset in zip(FIELDS, _OFFSETS)]
    return PointCloud2(header=header, height=1, width=len(rows), fields=fields,
                       is_bigendian=False, point_step=RECORD.itemsize,
                       row_step=RECORD.itemsize * len(rows), is_dense=dense, data=rows.tobytes())


def target_markers(estimate: TargetEstimate, header: Header,
                   metres_per_px: float) -> list[Marker]:
    """Return a target's box and number as markers in the plane of the image."""
    box = _marker(estimate, header, 'boxes', Marker.LINE_STRIP)
    box.scale.x = 2.0 * metres_per_px
    outline = corners(estimate.box_px, estimate.angle_rad)
    box.points = [Point(x=float(x) * metres_per_px, y=float(y) * metres_per_px)
                  for x, y in (*outline, outline[0])]
    text = _marker(estimate, header, 'numbers', Marker.TEXT_VIEW_FACING)
    x, y, w, _ = estimate.envelope_px
    text.pose.position = Point(x=float(x + w / 2) * metres_per_px,
                               y=float(y - 10) * metres_per_px)
    text.scale.z = 16.0 * metres_per_px
    near = 'inaccessible' if math.isinf(estimate.distance_px) \
        else f'd {estimate.distance_px:.0f} px'
    text.text = f'{estimate.id} ({near})'
    return [box, text]


def target_deletions(number: int, header: Header) -> list[Marker]:
    """Return the messages that delete the markers of an ended target."""
    return [Marker(header=header, ns=ns, id=number, action=Marker.DELETE)
            for ns in ('boxes', 'numbers')]


def _marker(estimate: TargetEstimate, header: Header, ns: str, kind: int) -> Marker:
    marker = Marker(header=header, ns=ns, id=estimate.id, type=kind, action=Marker.ADD)
    marker.lifetime = _LIFETIME.to_msg()
    marker.pose.orientation.w = 1.0
    seen = estimate.state is TargetState.TRACKED
    marker.color.g, marker.color.r = (1.0, 0.0) if seen else (0.6, 1.0)
    marker.color.a = 1.0
    return marker
