# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``--help`` of a node lists every parameter, without any being set."""
from __future__ import annotations

from pathlib import Path
import re
import subprocess
import sys

import pytest

pytest.importorskip('rclpy')

NODES = Path(__file__).resolve().parents[2] / 'stereo_speed' / 'nodes'
LONGEST_S = 120.0
_MEASURING = ('lifecycle', 'measuring_settings', 'self_test', 'rig_watch', 'frames', 'overlay')


def declared(modules):
    """Return the names of the parameters that modules declare."""
    return {name for module in modules for name in re.findall(
        r"p\.get\(\s*'(\w+)'", (NODES / f'{module}.py').read_text())}


@pytest.mark.parametrize(('node', 'modules'), [
    ('tracker_node', _MEASURING),
    ('speed_camera_node', _MEASURING),
    ('stereo_sync_node', ('pairing', 'subscriptions', 'diagnostics')),
    ('speed_node', ('diagnostics',)),
    ('replay_node', ('replay_node',)),
    ('log_node', ('log_node', 'diagnostics')),
    ('evidence_node', ('evidence_node',)),
    ('environment_node', ('environment_node',)),
    ('studio_node', ('studio_node',)),
])
def test_help_lists_every_parameter(node, modules, private_graph):
    asked = subprocess.run([sys.executable, '-m', f'stereo_speed.nodes.{node}', '--help'],
                           capture_output=True, text=True, timeout=LONGEST_S)
    told = {line.split()[0] for line in asked.stdout.splitlines() if line.startswith('  ')}
    assert asked.returncode == 0
    assert declared(modules) and declared(modules) <= told
