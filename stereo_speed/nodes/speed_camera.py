# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``speed_camera_node``: two image streams in, speeds out; the three live nodes in one process.

It has the topics and parameters of ``stereo_sync_node``, ``tracker_node`` and ``speed_node``, but
publishes no pairs: images are not copied between processes.
"""
from __future__ import annotations

from typing import Optional

from .helpers import Helpers
from .lifecycle import MeasuringNode
from .pairing import ImagePair, Pairing
from ..core.records import StereoPair


class SpeedCameraNode(MeasuringNode):
    """See the module's docstring."""

    def __init__(self, helpers: Optional[Helpers] = None) -> None:
        super().__init__('speed_camera_node', speeds=True, helpers=helpers)
        # Calibrations are subscribed to only once, to save the cost of a second callback.
        self.pairing = Pairing(self, self.p, self.on_pair, infos=False)
        self.measuring.info_heard.append(self.pairing.on_info)
        self.diagnostics.tasks.update(self.pairing.tasks)

    def subscribe(self) -> None:
        """Subscribe to the cameras."""
        self.pairing.subscribe()

    def unsubscribe(self) -> None:
        """Unsubscribe from the cameras."""
        self.pairing.close()

    def on_pair(self, pair: ImagePair) -> None:
        """Queue a pair for measuring."""
        self.measuring.offer(pair.left_ns, lambda index: StereoPair(
            index, pair.left_ns, pair.right_ns, pair.left, pair.right))
