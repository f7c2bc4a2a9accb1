# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What tests share: a pass on a bend; of nodes, a graph of their own and a stand-in."""
from __future__ import annotations

import os
from pathlib import Path
import time

import numpy as np
import pytest
from stereo_speed.sim.config import circle_config
from stereo_speed.sim.sequence import simulate

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope='session')
def circle():
    """36 mph on a circle of 41 m radius."""
    return simulate(circle_config('36 mph', 41.0), np.random.default_rng(2))


@pytest.fixture(scope='session')
def private_graph():
    """Keep to a domain of our own on this machine; node processes inherit it."""
    os.environ['ROS_DOMAIN_ID'] = str(20 + os.getpid() % 80)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(ROOT / 'config' / 'fastdds.xml')


@pytest.fixture()
def stand_in(private_graph):
    """Give a node whose ``wait(condition, seconds)`` spins it until the condition holds."""
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    context = Context()
    rclpy.init(context=context, args=[])
    node = rclpy.create_node('stand_in', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def wait(condition, seconds):
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
        assert condition(), 'the awaited event has not come'
    node.wait = wait
    yield node
    executor.shutdown(timeout_sec=1.0)
    node.destroy_node()
    rclpy.shutdown(context=context)
