# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Track updates as ROS messages."""
from __future__ import annotations

from typing import Mapping

from geometry_msgs.msg import Point
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.duration import Duration
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from .common import to_stamp
from .speeds import UNKNOWN
from ..core.records import Array, TrackState, TrackUpdate
from ..core.units import KMH_MPS, MPH_MPS
from ..road.lanes import LanePath


def odometry(update: TrackUpdate, frame_id: str) -> Odometry:
    """
    Return a track's pose in the left optical frame and its speed in the vehicle's own frame.

    ``twist.covariance[0]`` is the variance of the speed. It is ``UNKNOWN`` while the track is not
    confirmed. The variances of the orientation, which is that of the path, and of all other
    components of the twist are always ``UNKNOWN``, as these are not measured.
    """
    msg = Odometry(child_frame_id=f'vehicle_{update.track}')
    msg.header = Header(stamp=to_stamp(update.stamp_ns), frame_id=frame_id)
    pose, twist = msg.pose, msg.twist
    p, q = pose.pose.position, pose.pose.orientation
    p.x, p.y, p.z = map(float, update.position_m)
    q.x, q.y, q.z, q.w = map(float, Rotation.from_matrix(update.axes).as_quat())
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = update.position_cov_m2
    covariance[3:, 3:] = UNKNOWN * np.eye(3)
    pose.covariance = covariance.ravel()
    twist.twist.linear.x = float(update.speed_mps)
    variances = np.full(6, UNKNOWN)
    if update.state is TrackState.CONFIRMED:
        variances[0] = update.speed_std_mps ** 2
    twist.covariance = np.diag(variances).ravel()
    return msg


def markers(update: TrackUpdate, frame_id: str, lifetime_s: float) -> list[Marker]:
    """Return markers of a vehicle's front and its speed, with a limited lifetime."""
    front = _marker(update, frame_id, 'vehicles', Marker.CUBE, lifetime_s)
    front.pose = odometry(update, frame_id).pose.pose
    front.scale.x, front.scale.y, front.scale.z = 0.1, 1.8, 0.8
    text = _marker(update, frame_id, 'speed_text', Marker.TEXT_VIEW_FACING, lifetime_s)
    text.pose.position = _point(update.position_m + 1.5 * update.axes[:, 2])
    text.scale.z = 1.0
    text.text = (f'{update.track}: {update.speed_mps / MPH_MPS:.1f} mph '
                 f'({update.speed_mps / KMH_MPS:.1f} km/h)')
    return [front, text]


def deletions(track: int, frame_id: str) -> list[Marker]:
    """Return the messages that delete the markers of an ended track."""
    out = []
    for ns in ('vehicles', 'speed_text'):
        marker = Marker(ns=ns, id=track, action=Marker.DELETE)
        marker.header.frame_id = frame_id
        out.append(marker)
    return out


def path_markers(lanes: Mapping[str, LanePath], frame_id: str) -> list[Marker]:
    """Return markers of the lanes' paths, which replace all earlier ones."""
    out = [Marker(ns='path', action=Marker.DELETEALL)]
    out[0].header.frame_id = frame_id
    for number, lane in enumerate(lanes.values()):
        marker = Marker(ns='path', id=number, type=Marker.LINE_STRIP, action=Marker.ADD)
        marker.header.frame_id = frame_id
        marker.frame_locked = True
        marker.pose.orientation.w, marker.scale.x = 1.0, 0.1
        marker.color.b = marker.color.a = 1.0
        s_m = np.linspace(0, lane.path.length_m, 50)
        marker.points = [_point(p) for p in lane.path.position(s_m)]
        out.append(marker)
    return out


def _marker(update: TrackUpdate, frame_id: str, ns: str, kind: int, lifetime_s: float) -> Marker:
    marker = Marker(ns=ns, id=update.track, type=kind, action=Marker.ADD)
    marker.header = Header(stamp=to_stamp(update.stamp_ns), frame_id=frame_id)
    marker.lifetime = Duration(nanoseconds=round(lifetime_s * 1e9)).to_msg()
    marker.pose.orientation.w = 1.0
    confirmed = update.state is TrackState.CONFIRMED
    marker.color.g, marker.color.r = (1.0, 0.0) if confirmed else (0.6, 1.0)
    marker.color.a = 0.8
    return marker


def _point(position_m: Array) -> Point:
    x, y, z = map(float, position_m)
    return Point(x=x, y=y, z=z)
