# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``pairing_peer_node``: the node that ``bench`` compares the live nodes with; it shares no code.

It pairs the images of both cameras by their stamps and answers each pair with its header. It does
so at once, which gives the cost of DDS and Python alone, or after it has matched the views
densely, as is usual. Matching takes the newest pair each time it is done with the previous one.
"""
from __future__ import annotations

from functools import partial
import threading
from typing import Optional

import cv2
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from .common import Parameters, RELIABLE, run, stamp_ns
from ..core.errors import InputError, StereoSpeedError
from ..io.topics import SIDES

_WAITING = 10  # number of unpaired images kept per side
_DISPARITIES, _BLOCK_PX = 64, 5


class MatchingError(StereoSpeedError):
    """The matching thread has ended."""


class PairingPeerNode(Node):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__('pairing_peer_node')
        matching = Parameters(self).get('matching', 'none', 'stereo matching: none or sgbm')
        if matching not in ('none', 'sgbm'):
            raise InputError('pairing_peer_node: parameter', 'matching', matching, 'none or sgbm')
        self._waiting: dict[str, dict[int, Image]] = {side: {} for side in SIDES}
        self._newest: Optional[tuple[Image, Image]] = None
        self._came, self._closed = threading.Condition(), False
        self._failed: Optional[Exception] = None  # error of the matching thread
        self._answers = self.create_publisher(Header, 'answers', RELIABLE)
        for side in SIDES:
            self.create_subscription(Image, f'{side}/image_raw', partial(self._image, side),
                                     RELIABLE)
            self.create_subscription(CameraInfo, f'{side}/camera_info', self._info, RELIABLE)
        self._matching = threading.Thread(target=self._try_match) if matching == 'sgbm' else None
        if self._matching is not None:
            self._matching.start()

    def _info(self, msg: CameraInfo) -> None:
        """Receive a calibration, as any stereo node must; images are not rectified here."""

    def _image(self, side: str, msg: Image) -> None:
        if self._failed is not None:  # otherwise answers would stop without an error
            raise MatchingError(f'pairing_peer_node: matching: found its thread ended by '
                                f'{self._failed!r}, wanted each pair matched')
        ns = stamp_ns(msg.header.stamp)
        self._waiting[side][ns] = msg
        if not all(ns in waiting for waiting in self._waiting.values()):
            if len(self._waiting[side]) > _WAITING:
                del self._waiting[side][min(self._waiting[side])]
            return
        left, right = (self._waiting[s].pop(ns) for s in SIDES)
        if self._matching is None:
            self._answers.publish(left.header)
            return
        with self._came:
            self._newest = left, right
            self._came.notify()

    def _try_match(self) -> None:
        try:
            self._match()
        except Exception as error:  # OpenCV may raise anything
            self._failed = error

    def _match(self) -> None:
        """Match the newest pair, repeatedly, until closed."""
        matcher = cv2.StereoSGBM.create(minDisparity=0, numDisparities=_DISPARITIES,
                                        blockSize=_BLOCK_PX, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)
        while True:
            with self._came:
                self._came.wait_for(lambda: self._closed or self._newest is not None)
                pair, self._newest = self._newest, None
            if self._closed or pair is None:
                return
            matcher.compute(*(np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.step)
                              for msg in pair))
            self._answers.publish(pair[0].header)

    def close(self) -> None:
        """Stop matching."""
        with self._came:
            self._closed = True
            self._came.notify()
        if self._matching is not None:
            self._matching.join()


main = partial(run, PairingPeerNode)

if __name__ == '__main__':
    raise SystemExit(main())
