# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes in the process of a test."""
from __future__ import annotations

from contextlib import contextmanager

import pytest


@pytest.fixture(scope='session')
def in_process(private_graph):
    """Give what makes a node that hears nobody, and ends it when its block is left."""
    import rclpy

    @contextmanager
    def running(make, *parameters):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF')
            rclpy.init(args=['--ros-args', *(w for p in parameters for w in ('-p', p))])
            node = None
            try:
                node = make()
                yield node
            finally:
                if node is not None:
                    getattr(node, 'close', lambda: None)()
                    node.destroy_node()
                rclpy.try_shutdown()
    return running
