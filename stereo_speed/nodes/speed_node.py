# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``speed_node``: tracks in, ``/vehicle_speed`` out, for confirmed tracks only."""
from __future__ import annotations

from functools import partial

from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from .common import qos_options, RELIABLE, run
from .diagnostics import Diagnostics
from .health import ERROR, Neighbours, State, Tally
from .speeds import speed_of


class SpeedNode(Node):
    """
    Publishes the speed of each confirmed track, one message per vehicle and pair.

    ``header.stamp`` is that of the pair, ``header.frame_id`` is ``vehicle_<track>``,
    ``twist.linear.x`` is in m/s and ``covariance[0]`` is its variance.  Tracks that are not
    confirmed have no measurement, which their variance shows, and are left out.
    """

    def __init__(self) -> None:
        super().__init__('speed_node')
        self.published, self.withheld = Tally(), 0
        self.publisher = self.create_publisher(
            TwistWithCovarianceStamped, 'vehicle_speed', RELIABLE,
            qos_overriding_options=qos_options())
        tracks = self.create_subscription(Odometry, 'tracks', self.on_track, RELIABLE,
                                          qos_overriding_options=qos_options())
        self.trackers = Neighbours(tracks.get_publisher_count)
        self.diagnostics = Diagnostics(self, {'readings': self.state})

    def on_track(self, track: Odometry) -> None:
        """Pass on the speed of a confirmed track."""
        speed = speed_of(track)
        if speed is None:
            self.withheld += 1
            return
        self.publisher.publish(speed)
        self.published.add()

    def state(self) -> State:
        """Return counts for ``/diagnostics``; an empty road is no fault, a missing tracker is."""
        state = State('publishing', values={
            'published': self.published.total, 'withheld': self.withheld,
            'published_hz': round(self.published.rate_hz, 2)})
        self.trackers.tell(state, ERROR, 'nobody publishes tracks', 'publishers')
        return state


main = partial(run, SpeedNode)

if __name__ == '__main__':
    raise SystemExit(main())
