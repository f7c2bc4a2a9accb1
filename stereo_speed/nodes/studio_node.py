# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``studio_node``: a web page of live overlays, speeds and passes, and of the health of all nodes.

It only subscribes. It prints the address to open, which is secret.
"""
from __future__ import annotations

from contextlib import ExitStack
from functools import partial
import json
import time
from typing import Any

import cv2
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped
import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import String

from .common import LATCHED, Parameters, qos_options, RELIABLE, run, stamp_ns
from ..core.errors import StereoSpeedError
from ..io.images import grey_from_message
from ..studio.guard import Guard, LOCALHOST
from ..studio.live import LiveHealth, LiveReading, LiveState
from ..studio.serve import served
from ..studio.server import Studio
from ..vision.grey import to_eight_bits

PORT = 8766  # differs from that of the command, so that both may run
_JPEG_QUALITY = 75
_WAKE_S = 0.5
_PASS_FIELDS = ('track', 'lane', 'speed_mps', 'speed_std_mps', 'verdict', 'reason')


class StudioNode(Node):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__('studio_node')
        p = Parameters(self)
        port = p.get('port', PORT, 'port of the page; 0 for any free one', 0, 65535)
        address = p.get('address', LOCALHOST, 'address to listen on; the connection is '
                        'not encrypted')
        rate_hz = p.get('images_per_second', 4.0, 'rate of the overlays shown [Hz]', 0.1, 30.0)
        self.period_s, self.next_s = 1.0 / rate_hz, {'left': 0.0, 'right': 0.0}
        self.live = LiveState()
        options = {'qos_overriding_options': qos_options()}
        for kind, topic, callback, qos in (
                (TwistWithCovarianceStamped, 'vehicle_speed', self.on_speed, RELIABLE),
                (Image, 'overlay/image_raw', partial(self.on_overlay, 'left'), RELIABLE),
                (Image, 'overlay/right/image_raw', partial(self.on_overlay, 'right'), RELIABLE),
                (DiagnosticArray, '/diagnostics', self.on_health, RELIABLE),
                (String, 'passes', self.on_pass, LATCHED)):
            self.create_subscription(kind, topic, callback, qos, **options)
        guard = Guard(address)
        self.stack = ExitStack()
        sock = self.stack.enter_context(guard.bind(port))
        self.stack.enter_context(served(Studio(guard, live=self.live), sock))
        # Python handles signals only when spinning returns to it; this timer makes it return even
        # without messages.
        self.create_timer(_WAKE_S, lambda: None,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))
        print(f'open {guard.url}', flush=True)

    def on_speed(self, msg: TwistWithCovarianceStamped) -> None:
        """Show the speed of a vehicle."""
        self.live.add_reading(LiveReading(
            msg.header.frame_id, stamp_ns(msg.header.stamp), float(msg.twist.twist.linear.x),
            float(np.sqrt(max(msg.twist.covariance[0], 0.0)))))

    def on_pass(self, msg: String) -> None:
        """Show a finished pass; invalid messages are ignored."""
        try:
            data = json.loads(msg.data)
        except ValueError:
            data = None
        if not isinstance(data, dict) or not isinstance(data.get('verdict'), str):
            self.get_logger().warning('passes: message ignored, as it is no pass', once=True)
            return
        self.live.add_pass({key: data.get(key) for key in _PASS_FIELDS})

    def on_health(self, msg: DiagnosticArray) -> None:
        """Show the diagnostics of nodes."""
        for status in msg.status:
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            self.live.add_health(LiveHealth(
                status.name, level, status.message, {v.key: v.value for v in status.values}))

    def on_overlay(self, view: str, msg: Image) -> None:
        """Show an annotated image, unless one of its view was just shown or it is no image."""
        now_s = time.monotonic()
        if now_s < self.next_s[view]:
            return
        try:
            jpeg = cv2.imencode('.jpg', _pixels(msg), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
        except (StereoSpeedError, ValueError, cv2.error) as error:
            self.get_logger().warning(f'overlay: image ignored: {error}', once=True)
            return
        self.next_s[view] = now_s + self.period_s
        self.live.add_image(view, jpeg.tobytes())

    def close(self) -> None:
        """End the server."""
        if hasattr(self, 'stack'):
            self.stack.close()


def _pixels(msg: Any) -> NDArray[np.uint8]:
    """Return an image for OpenCV: BGR as it is, anything else as grey."""
    if msg.encoding == 'bgr8' and msg.step == 3 * msg.width:
        return np.frombuffer(bytes(msg.data), np.uint8).reshape(msg.height, msg.width, 3)
    return to_eight_bits(grey_from_message(msg, 'overlay'))


main = partial(run, StudioNode)

if __name__ == '__main__':
    raise SystemExit(main())
