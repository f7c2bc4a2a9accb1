# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A node as a user may write it: subscribes to ``/vehicle_speed`` and the overlay."""
from __future__ import annotations

from typing import Any, Callable

from geometry_msgs.msg import TwistWithCovarianceStamped
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image

from .common import RELIABLE, stamp_ns
from .graph_listener import GraphListener

# Numbers of publishers and subscribers that must be connected before the first image is sent.
_WIRES = {'/stereo/image_pair': (1, 1), '/tracks': (1, 1), '/vehicle_speed': (1, 1),
          '/overlay/image_raw': (1, 1), '/left/image_raw': (0, 1), '/right/image_raw': (0, 1),
          '/left/camera_info': (0, 2), '/right/camera_info': (0, 2)}


class Listener(GraphListener):
    """
    Subscribes as any other node would.

    :param on_reading: called with stamp in ns, vehicle, speed and 1-sigma in m/s.
    :param on_frame: called with stamp in ns and the overlay, (H, W, 3) BGR.
    """

    def __init__(self, on_reading: Callable[[int, str, float, float], None],
                 on_frame: Callable[[int, Any], None]) -> None:
        super().__init__('demo_listener')
        self.on_reading, self.on_frame = on_reading, on_frame
        self.node.create_subscription(TwistWithCovarianceStamped, '/vehicle_speed',
                                      self._reading, RELIABLE)
        self.node.create_subscription(Image, '/overlay/image_raw', self._frame, RELIABLE)

    def _reading(self, msg: TwistWithCovarianceStamped) -> None:
        self.on_reading(stamp_ns(msg.header.stamp), msg.header.frame_id,
                        msg.twist.twist.linear.x, msg.twist.covariance[0] ** 0.5)

    def _frame(self, msg: Image) -> None:
        self.on_frame(stamp_ns(msg.header.stamp), _bgr(msg))

    def missing_wires(self) -> list[str]:
        """Return the topics whose publishers and subscribers have not all been discovered."""
        return [topic for topic, (publishers, subscribers) in _WIRES.items()
                if self.node.count_publishers(topic) < publishers
                or self.node.count_subscribers(topic) < subscribers]


def _bgr(msg: Image) -> NDArray[np.uint8]:
    """Return the pixels of the overlay, which is always bgr8 without padding."""
    return np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.width, 3)
