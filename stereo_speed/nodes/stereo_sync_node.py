# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``stereo_sync_node``: two image streams in, one message per pair out.

The pair is one ``sensor_msgs/Image`` on ``stereo/image_pair``: the left grey image above the
right one; see ``pair``.
"""
from __future__ import annotations

from functools import partial
from typing import Any, Optional, Sequence

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from .common import (
    Diagnostics, JUMP_NS, PAIR_TOPIC, Parameters, qos_options, RELIABLE, run, stamp_ns)
from .pair import pair_message
from ..core.errors import CalibrationError, InputError
from ..core.pair_matcher import PairMatcher
from ..io.images import grey_from_message


class StereoSyncNode(Node):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__('stereo_sync_node')
        p = Parameters(self)
        transport = p.get('image_transport', 'raw', "'raw' or 'compressed' images")
        if transport not in ('raw', 'compressed'):
            raise InputError(f'{self.get_name()}: parameter', 'image_transport', transport,
                             'raw or compressed')
        approximate = p.get('approximate_sync', False,
                            'pair the nearest stamps within a tolerance instead of equal ones')
        tolerance_s = p.get('approximate_sync_tolerance_seconds', 0.0,
                            'largest gap between the stamps of a pair [s]', 0.0, 1.0)
        queue = p.get('queue_size', 10, 'unpaired images kept per side', 1, 1000)
        self.matcher = PairMatcher(round(tolerance_s * 1e9) if approximate else 0, queue)
        self.infos: dict[str, CameraInfo] = {}
        self.last_ns = {'left': -1, 'right': -1}
        self.pairs, self.resets, self.lost = 0, 0, [0, 0]
        self.publisher = self.create_publisher(
            Image, PAIR_TOPIC, RELIABLE, qos_overriding_options=qos_options())
        kind, suffix = (Image, '') if transport == 'raw' else (CompressedImage, '/compressed')
        for side in ('left', 'right'):
            self.create_subscription(
                kind, f'{side}/image_raw{suffix}', partial(self.on_image, side),
                qos_profile_sensor_data, qos_overriding_options=qos_options())
            self.create_subscription(
                CameraInfo, f'{side}/camera_info', partial(self.on_info, side),
                qos_profile_sensor_data, qos_overriding_options=qos_options())
        self.diagnostics = Diagnostics(self, self.state)

    def on_info(self, side: str, msg: CameraInfo) -> None:
        """Keep the calibration, to check the images' size."""
        self.infos[side] = msg

    def on_image(self, side: str, msg: Any) -> None:
        """
        Take an image; publish the pairs that are now certain.

        :raises InputError: an image that cannot be decoded, or not of the calibration's size.
        """
        ns = stamp_ns(msg.header.stamp)
        if ns < self.last_ns[side] - JUMP_NS:
            self.reset(side, ns)
        self.last_ns[side] = max(ns, self.last_ns[side])
        topic = f'{side}/image_raw'
        grey = grey_from_message(msg, topic)
        info = self.infos.get(side)
        if info is not None and grey.shape != (info.height, info.width):
            raise CalibrationError(topic, 'image size', f'{grey.shape[1]}x{grey.shape[0]}',
                                   f'{info.width}x{info.height} as in {side}/camera_info')
        add = self.matcher.add_left if side == 'left' else self.matcher.add_right
        pairs = add(ns, (grey, msg.header.frame_id))
        for left_ns, (left, frame_id), right_ns, (right, _) in pairs:
            self.publisher.publish(pair_message(
                left, right, left_ns=left_ns, right_ns=right_ns, frame_id=frame_id))
            self.pairs += 1

    def reset(self, side: str, ns: int) -> None:
        """Forget unpaired images: time has jumped back."""
        self.get_logger().warning(
            f'{side} stamp jumped back from {self.last_ns[side]} to {ns} ns: starting anew')
        self.lost = [self.lost[0] + self.matcher.unpaired_left,
                     self.lost[1] + self.matcher.unpaired_right]
        self.matcher.reset()
        self.last_ns = {'left': -1, 'right': -1}
        self.resets += 1

    def state(self) -> tuple[bytes, str, dict[str, Any]]:
        """Level, message and counts for ``/diagnostics``."""
        left = self.lost[0] + self.matcher.unpaired_left
        right = self.lost[1] + self.matcher.unpaired_right
        level, message = b'\x00', 'pairing'
        if self.pairs == 0:
            level, message = b'\x01', 'no pair yet'
        elif left + right:
            level, message = b'\x01', 'some images had no partner'
        return level, message, {'pairs': self.pairs, 'unpaired_left': left,
                                'unpaired_right': right, 'resets': self.resets}


def main(args: Optional[Sequence[str]] = None) -> int:
    """Run the node."""
    return run(StereoSyncNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
