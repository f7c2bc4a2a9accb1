# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The benchmark's peer node reports a failing matcher instead of going on silently."""
from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

from sensor_msgs.msg import Image  # noqa: E402, I100
from stereo_speed.nodes.pairing_peer_node import MatchingError, PairingPeerNode  # noqa: E402


def image(sec, size):
    """Return a black image of 64 x 128 pixels with a number of data bytes."""
    msg = Image(height=64, width=128, step=128, encoding='mono8', data=bytes(size))
    msg.header.stamp.sec = sec
    return msg


def test_failed_matching_ends_the_node_with_the_next_image(in_process):
    """Its images are truncated, and therefore invalid."""
    with in_process(PairingPeerNode, 'matching:=sgbm') as node:
        node._image('left', image(1, 7))
        node._image('right', image(1, 7))
        node._matching.join(10.0)
        assert not node._matching.is_alive()
        with pytest.raises(MatchingError, match='ended by ValueError'):
            node._image('left', image(2, 64 * 128))


def test_matching_continues_while_it_does_not_fail(in_process):
    with in_process(PairingPeerNode, 'matching:=sgbm') as node:
        for sec in (1, 2):
            for side in ('left', 'right'):
                node._image(side, image(sec, 64 * 128))
        assert node._matching.is_alive()
