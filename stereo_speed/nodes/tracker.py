# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``tracker_node``: synchronized pairs in, tracks, passes, markers and an overlay out.

The measuring is in ``measuring_thread``, the publishers in ``outputs``, the lifecycle in
``lifecycle``.
"""
from __future__ import annotations

from functools import partial
from typing import Optional

from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

from .common import PAIR_TOPIC, qos_options, RELIABLE, stamp_ns
from .helpers import Helpers
from .lifecycle import MeasuringNode
from .pair import pair_from_message


class TrackerNode(MeasuringNode):
    """See the module's docstring."""

    def __init__(self, helpers: Optional[Helpers] = None) -> None:
        super().__init__('tracker_node', helpers=helpers)
        self.pairs: Optional[Subscription] = None

    def subscribe(self) -> None:
        """Subscribe to pairs."""
        self.pairs = self.create_subscription(Image, PAIR_TOPIC, self.on_pair, RELIABLE,
                                              qos_overriding_options=qos_options())

    def unsubscribe(self) -> None:
        """Unsubscribe from pairs."""
        if self.pairs is not None:
            self.destroy_subscription(self.pairs)
            self.pairs = None

    def on_pair(self, msg: Image) -> None:
        """Queue a pair for measuring."""
        self.measuring.offer(stamp_ns(msg.header.stamp), partial(pair_from_message, msg))
