# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes of a test are ended, whatever happens in between."""
from __future__ import annotations

import pytest

rclpy = pytest.importorskip('rclpy')


class Failing:
    """A node that cannot be closed."""

    ended = False

    def close(self):
        raise RuntimeError('still busy')

    def destroy_node(self):
        self.ended = True


def test_node_that_fails_to_close_leaves_nothing_behind(in_process):
    with pytest.raises(RuntimeError, match='still busy'), in_process(Failing) as node:
        assert rclpy.ok()
    assert node.ended and not rclpy.ok()
