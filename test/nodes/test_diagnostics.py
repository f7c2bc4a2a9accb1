# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A diagnostic task that fails is an ERROR, and the others are still published."""
from __future__ import annotations

import pytest

rclpy = pytest.importorskip('rclpy')

from stereo_speed.nodes.diagnostics import Diagnostics  # noqa: E402, I100
from stereo_speed.nodes.health import ERROR, OK, State  # noqa: E402


def test_failing_task_affects_only_its_own_status(in_process):
    told = []
    with in_process(lambda: rclpy.create_node('rig')) as node:
        diagnostics = Diagnostics(node, {'broken': lambda: 1 // 0, 'sound': lambda: State('well')})
        diagnostics.publisher = type('Heard', (), {'publish': staticmethod(told.append)})
        diagnostics.publish()
    broken, sound = told[0].status
    assert (broken.level, broken.name) == (ERROR, 'rig: broken')
    assert 'ZeroDivisionError' in broken.message
    assert (sound.level, sound.message) == (OK, 'well')
