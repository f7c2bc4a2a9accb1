# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The frames of the rig in TF: a road frame with z up, and both cameras in it.

The road frame is at the beginning of the first lane's path: x along travel, y to the left, z up.
It is the parent of the left optical frame, which is the parent of the right one, so that a viewer
with the road as its fixed frame shows everything upright.
"""
from __future__ import annotations

from typing import Mapping, Optional

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
import numpy as np
from rclpy.node import Node
from scipy.spatial.transform import Rotation

from .common import LATEST, Parameters
from ..core.records import Array
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # part of ROS, but not on PyPI; ``publish`` logs this
    TFMessage = None


class StaticFrames:
    """
    Publishes the frames on ``/tf_static``.

    :param node: the node that publishes.
    :param p: declares the parameters.
    """

    def __init__(self, node: Node, p: Parameters) -> None:
        self.node = node
        self.road = p.get('road_frame', 'road', 'name of the frame with z up at the beginning of '
                          'the first lane; must differ between two rigs')
        self.right = p.get('right_frame', 'stereo_right_optical_frame',
                           'name of the right optical frame')
        self.publisher = None if TFMessage is None else node.create_publisher(
            TFMessage, '/tf_static', LATEST)

    def publish(self, rig: StereoRig, lanes: Mapping[str, LanePath]) -> None:
        """Publish the frames of a rig."""
        if self.publisher is None:
            self.node.get_logger().info('no frames on /tf_static: tf2_msgs is not installed')
            return
        self.publisher.publish(TFMessage(transforms=static_transforms(
            rig, next(iter(lanes.values())), road=self.road, right=self.right,
            stamp=self.node.get_clock().now().to_msg())))


def static_transforms(rig: StereoRig, lane: LanePath, *, road: str, right: str,
                      stamp: Optional[Time] = None) -> list[TransformStamped]:
    """
    Return the left optical frame in the road frame, and the right one in the left one.

    :param rig: the cameras; its frame_id is the name of the left optical frame.
    :param lane: the lane at whose beginning the road frame is.
    :param road: name of the road frame.
    :param right: name of the right optical frame.
    :param stamp: stamp of both transforms.
    """
    start = np.array(0.0)
    axes, origin_m = lane.path.frame(start), lane.path.position(start)  # in the left frame
    return [
        _transform(road, rig.frame_id, axes.T, -axes.T @ origin_m, stamp),
        # x_right = R x_left + t, so the right camera is at -R.T t and rotated by R.T
        _transform(rig.frame_id, right, rig.R.T, -rig.R.T @ rig.t, stamp)]


def _transform(parent: str, child: str, rotation: Array, translation_m: Array,
               stamp: Optional[Time]) -> TransformStamped:
    """Return the transform of a child frame: x_parent = rotation x_child + translation."""
    msg = TransformStamped(child_frame_id=child)
    msg.header.frame_id = parent
    if stamp is not None:
        msg.header.stamp = stamp
    t, q = msg.transform.translation, msg.transform.rotation
    t.x, t.y, t.z = map(float, translation_m)
    q.x, q.y, q.z, q.w = map(float, Rotation.from_matrix(rotation).as_quat())
    return msg
