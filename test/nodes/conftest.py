# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes in the process of a test."""
from __future__ import annotations

from contextlib import contextmanager, ExitStack

import pytest


@pytest.fixture(scope='session')
def in_process(private_graph):
    """Return a context manager that makes a node without peers, and ends it on exit."""
    import rclpy

    @contextmanager
    def running(make, *parameters):
        with pytest.MonkeyPatch.context() as patch, ExitStack() as ends:
            patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF')
            rclpy.init(args=['--ros-args', *(w for p in parameters for w in ('-p', p))])
            ends.callback(rclpy.try_shutdown)
            node = make()
            ends.callback(node.destroy_node)
            ends.callback(getattr(node, 'close', lambda: None))
            yield node
    return running
