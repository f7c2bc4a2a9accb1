# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Publishes annotated images of the pairs, while they have subscribers.

They are drawn in a thread of their own, because the readings of the next pair would wait for a
drawing in the measuring thread.  A pair that comes while another one is drawn is not drawn.
"""
from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
import time
from typing import Callable, Optional, Sequence

import cv2
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, Image

from .common import byte_array, image_message, Parameters, qos_options, RELIABLE, to_stamp
from ..core.records import StereoPair, TrackUpdate
from ..pipeline.pipeline import SpeedPipeline
from ..report import overlay

_JPEG_QUALITY = 80


class Overlay:
    """
    See the module's docstring.

    :param node: the node that publishes.
    :param p: declares the parameters.
    :param right_frame: frame of the right images.
    :param draw: draws over an image of a pair.
    :param clock: steady time, s.
    """

    def __init__(self, node: Node, p: Parameters, right_frame: str, *,
                 draw: Callable[..., overlay.Image] = overlay.draw,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self.log, self.right_frame, self._draw, self._clock = (
            node.get_logger(), right_frame, draw, clock)
        self.period_s = 1.0 / p.get(
            'overlay_hz', 10.0, 'greatest rate of the overlay, which is drawn only while it has '
            'subscribers [Hz]', 0.01, 1000.0)
        self.left, self.right, self.compressed = (
            node.create_publisher(kind, f'overlay/{topic}', RELIABLE,
                                  qos_overriding_options=qos_options())
            for kind, topic in ((Image, 'image_raw'), (Image, 'right/image_raw'),
                                (CompressedImage, 'image_raw/compressed')))
        self._thread = ThreadPoolExecutor(1, 'overlay')
        self._drawing: Optional[Future[None]] = None
        self._begun_s = -float('inf')

    @property
    def wanted(self) -> bool:
        """Return whether there are subscribers."""
        return any(publisher.get_subscription_count()
                   for publisher in (self.left, self.right, self.compressed))

    def show(self, pipeline: SpeedPipeline, pair: StereoPair, updates: Sequence[TrackUpdate]
             ) -> None:
        """Draw a pair, unless another one is being drawn or was drawn too recently."""
        now_s = self._clock()
        if not self.wanted or now_s - self._begun_s < self.period_s \
                or self._drawing is not None and not self._drawing.done():
            return
        self._begun_s = now_s
        self._drawing = self._thread.submit(self._publish, pipeline, pair, tuple(updates))

    def close(self) -> None:
        """Wait until the last image is published, and end the thread."""
        self._thread.shutdown()

    # -- in the thread that draws -----------------------------------------------------------

    def _publish(self, pipeline: SpeedPipeline, pair: StereoPair, updates: Sequence[TrackUpdate]
                 ) -> None:
        try:
            if self.right.get_subscription_count():
                image = self._draw(pair, updates, pipeline.lanes, pipeline.rig, right=True)
                self.right.publish(image_message(
                    image, ns=pair.right_stamp_ns, frame_id=self.right_frame))
            raw, compressed = (bool(publisher.get_subscription_count())
                               for publisher in (self.left, self.compressed))
            if not raw and not compressed:
                return
            image, frame_id = (self._draw(pair, updates, pipeline.lanes, pipeline.rig),
                               pipeline.rig.frame_id)
            if raw:
                self.left.publish(image_message(image, ns=pair.stamp_ns, frame_id=frame_id))
            if compressed:
                self.compressed.publish(_jpeg(image, pair.stamp_ns, frame_id))
        except Exception as error:  # a picture is no reason to stop the instrument
            self.log.error(f'overlay: {error!r}', throttle_duration_sec=10.0)


def _jpeg(image: overlay.Image, ns: int, frame_id: str) -> CompressedImage:
    """Return an image (H, W, 3), BGR, as a JPEG."""
    msg = CompressedImage(format='bgr8; jpeg compressed bgr8')
    msg.header.stamp, msg.header.frame_id = to_stamp(ns), frame_id
    msg.data = byte_array(cv2.imencode('.jpg', image, [cv2.IMWRITE_JPEG_QUALITY,
                                                       _JPEG_QUALITY])[1])
    return msg
