# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A node that only subscribes, on a context of its own."""
from __future__ import annotations

import time
from typing import Callable

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor


class GraphListener:
    """
    A node for subscriptions, which the caller spins.

    :param name: name of the node.
    """

    def __init__(self, name: str) -> None:
        self.context = Context()
        rclpy.init(context=self.context, args=[])
        self.node = rclpy.create_node(name, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def connected(self, *topics: str) -> bool:
        """Return whether each topic has a publisher."""
        return all(self.node.count_publishers(topic) for topic in topics)

    def spin(self, seconds: float, until: Callable[[], bool]) -> bool:
        """Spin until a condition holds, for a limited time; return whether it holds."""
        end = time.monotonic() + seconds
        while not until():
            if time.monotonic() > end:
                return False
            self.executor.spin_once(timeout_sec=0.05)
        return True

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
