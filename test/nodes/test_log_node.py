# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A disk fault is reported until a write succeeds again."""
from __future__ import annotations

import sqlite3

import pytest

pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry  # noqa: E402, I100

from stereo_speed.nodes.health import ERROR, OK  # noqa: E402
from stereo_speed.nodes.log_node import LogNode  # noqa: E402


def test_fault_ends_when_readings_are_written_again(in_process, tmp_path):
    with in_process(LogNode, f'file:={tmp_path / "passes.sqlite"}') as node:
        node.failed(sqlite3.OperationalError('database or disk is full'))
        node.sync()  # without anything to write, so the disk's state is unknown
        assert node.state().level == ERROR
        node.on_track(Odometry(child_frame_id='vehicle_0'))
        assert node.state().level == ERROR
        node.sync()
        assert node.state().level == OK
