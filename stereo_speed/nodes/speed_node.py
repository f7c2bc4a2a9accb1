# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``speed_node``: tracks in, ``/vehicle_speed`` out, for confirmed tracks only."""
from __future__ import annotations

from typing import Any, Optional, Sequence

from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from .common import Diagnostics, qos_options, RELIABLE, run


class SpeedNode(Node):
    """
    Publish the speed of each confirmed track, one message per vehicle and pair.

    ``header.stamp`` is the pair's, ``header.frame_id`` is ``vehicle_<id>``, ``twist.linear.x`` is
    in m/s and ``covariance[0]`` its variance.  A track that is not confirmed has
    ``twist.covariance[0] = -1`` on ``tracks`` (no measurement) and is left out.
    """

    def __init__(self) -> None:
        super().__init__('speed_node')
        self.published = self.withheld = 0
        self.publisher = self.create_publisher(
            TwistWithCovarianceStamped, 'vehicle_speed', RELIABLE,
            qos_overriding_options=qos_options())
        self.create_subscription(Odometry, 'tracks', self.on_track, RELIABLE,
                                 qos_overriding_options=qos_options())
        self.diagnostics = Diagnostics(self, self.state)

    def on_track(self, track: Odometry) -> None:
        """Pass on the speed of a confirmed track."""
        if track.twist.covariance[0] < 0:
            self.withheld += 1
            return
        msg = TwistWithCovarianceStamped()
        msg.header.stamp, msg.header.frame_id = track.header.stamp, track.child_frame_id
        msg.twist = track.twist
        self.publisher.publish(msg)
        self.published += 1

    def state(self) -> tuple[bytes, str, dict[str, Any]]:
        """Level, message and counts for ``/diagnostics``."""
        return b'\x00', 'publishing', {'published': self.published, 'withheld': self.withheld}


def main(args: Optional[Sequence[str]] = None) -> int:
    """Run the node."""
    return run(SpeedNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
