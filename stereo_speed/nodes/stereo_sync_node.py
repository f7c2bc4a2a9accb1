# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``stereo_sync_node``: two image streams in, one message per pair out.

The pair is one ``sensor_msgs/Image`` on ``stereo/image_pair``: the left grey image above the
right one; see ``pair``.
"""
from __future__ import annotations

from functools import partial

from rclpy.node import Node
from sensor_msgs.msg import Image

from .common import PAIR_TOPIC, Parameters, qos_options, RELIABLE, run
from .diagnostics import Diagnostics
from .health import Neighbours, State, WARN
from .pair import pair_message
from .pairing import ImagePair, Pairing


class StereoSyncNode(Node):
    """See the module's docstring."""

    def __init__(self) -> None:
        super().__init__('stereo_sync_node')
        self.publisher = self.create_publisher(
            Image, PAIR_TOPIC, RELIABLE, qos_overriding_options=qos_options())
        self.pairing = Pairing(self, Parameters(self), self.publish)
        self.pairing.subscribe()
        self.takers = Neighbours(self.publisher.get_subscription_count)
        self.diagnostics = Diagnostics(self, {**self.pairing.tasks, 'pairs': self.state})

    def publish(self, pair: ImagePair) -> None:
        """Publish a pair as one message."""
        self.publisher.publish(pair_message(
            pair.left, pair.right, left_ns=pair.left_ns, right_ns=pair.right_ns,
            frame_id=pair.frame_id))

    def state(self) -> State:
        """Return the state of the pairs for ``/diagnostics``, and whether anybody takes them."""
        state = self.pairing.tasks['pairs']()
        self.takers.tell(state, WARN, f'nobody subscribes to {PAIR_TOPIC}', 'subscribers')
        return state


main = partial(run, StereoSyncNode)

if __name__ == '__main__':
    raise SystemExit(main())
