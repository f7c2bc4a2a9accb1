# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What a node that measures says of itself as its states change, in this process."""
from __future__ import annotations

from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy')

from stereo_speed.nodes.health import WARN  # noqa: E402, I100
from stereo_speed.nodes.tracker_node import TrackerNode  # noqa: E402


@pytest.fixture()
def node(in_process, sample):
    with in_process(TrackerNode, f'site:={sample / "site.yaml"}') as node:
        yield node


def test_each_state_and_a_jump_of_time_are_told(node):
    measuring = node.measuring
    assert (measuring.state().level, measuring.state().message) == (WARN, 'not configured')
    node.trigger_configure()
    assert (measuring.state().level, measuring.state().message) == (WARN, 'inactive')
    node.trigger_activate()
    assert 'inactive' not in measuring.state().message
    measuring._start_anew(SimpleNamespace(reset=lambda: None), 5)
    state = measuring.state()
    assert state.values['resets'] == 1 and 'stamps jumped back' in state.message
    node.trigger_deactivate()
    assert measuring.state().message == 'inactive'
