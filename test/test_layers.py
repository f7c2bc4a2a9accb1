# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The layering: imports point down only, and outside libraries stay in their rooms."""
from __future__ import annotations

import ast
from pathlib import Path
from typing import Iterator

import pytest

ROOT = Path(__file__).resolve().parents[1] / 'stereo_speed'
MODULES = sorted(ROOT.rglob('*.py'))

# Rooms from the bottom up; a room imports itself and those below. Rooms on one line are
# strangers to each other.
LAYERS = (
    ('errors', 'records', 'threads', 'units', '__init__'),
    ('config', 'fields', 'sync'),
    ('geometry', 'features', 'filtering'),
    ('paths',),
    ('site',),
    ('calibration',),
    ('tracking', 'detection', 'environment'),
    ('baselines',),
    ('pipeline',),
    ('io',),
    ('sim', 'report'),
    ('evaluation',),
    ('nodes',),
    ('cli',),
    ('__main__',),
)
RANK = {room: rank for rank, rooms in enumerate(LAYERS) for room in rooms}
# Library to the rooms that may import it; everybody may import those not named here.
ROOMS_OF = {
    'rclpy': {'nodes'},
    'rosbags': {'io', 'sim'},
    'mcap': {'io', 'sim'},
    'matplotlib': {'report'},
    'tqdm': {'cli', 'evaluation'},
    'argparse': {'cli', 'nodes'},
}
ROS_MESSAGES = ('sensor_msgs', 'nav_msgs', 'geometry_msgs', 'visualization_msgs',
                'diagnostic_msgs', 'rosgraph_msgs', 'std_msgs', 'builtin_interfaces',
                'rcl_interfaces')
ROOMS_OF.update({name: {'nodes'} for name in ROS_MESSAGES})


def room_of(module: str) -> str:
    """
    Give the room of a module of the package.

    :param module: dotted name below the package, '' for the package itself.
    """
    return module.partition('.')[0] or '__init__'


def imports_of(source: str, module: str, is_package: bool) -> Iterator[tuple[str, bool]]:
    """
    Find what a module imports, wherever in the module it does.

    :param source: its text.
    :param module: its dotted name below the package.
    :param is_package: whether it is an ``__init__``.
    :return: pairs of dotted name and whether it is ours, then below the package.
    """
    here = module.split('.') if module else []
    package = here if is_package else here[:-1]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                own = alias.name.partition('.')
                yield (own[2], True) if own[0] == 'stereo_speed' else (alias.name, False)
        elif isinstance(node, ast.ImportFrom):
            base = node.module.split('.') if node.module else []
            if node.level:
                base = package[:len(package) - node.level + 1] + base
            elif base[0] == 'stereo_speed':
                base = base[1:]
            else:
                yield node.module, False
                continue
            # 'from .. import x': x may be a module; a name of __init__ is at the bottom anyway
            for alias in node.names if not base else [None]:
                name = alias.name if alias and alias.name in RANK else '.'.join(base)
                yield name, True


def faults(source: str, module: str, is_package: bool = False) -> list[str]:
    """List the imports of a module that the layering forbids."""
    room = room_of(module)
    found = []
    for name, ours in imports_of(source, module, is_package):
        target = room_of(name)
        if ours and target != room and RANK[target] >= RANK[room]:
            found.append(f'{module} imports {name}, which is not below it')
        if not ours and room not in ROOMS_OF.get(target, {room}):
            found.append(f'{module} imports {name}, which only {ROOMS_OF[target]} may')
    return found


def dotted(path: Path) -> str:
    """Give the dotted name, below the package, of a source file."""
    parts = path.relative_to(ROOT).with_suffix('').parts
    return '.'.join(parts[:-1] if len(parts) > 1 and parts[-1] == '__init__' else parts)


@pytest.mark.parametrize('path', MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_point_down(path):
    room = room_of(dotted(path))
    assert room in RANK, f'{room} has no place in LAYERS'
    assert faults(path.read_text(), dotted(path), path.name == '__init__.py') == []


@pytest.mark.parametrize(('module', 'source', 'wanted'), [
    ('tracking.base', 'from ..pipeline import SpeedPipeline', 'pipeline'),
    ('tracking.base', 'import rclpy', 'rclpy'),
    ('tracking.base', 'from rosbags.rosbag2 import Reader', 'rosbags'),
    ('geometry.rig', 'def f():\n    import matplotlib.pyplot', 'matplotlib'),
    ('geometry.rig', 'from stereo_speed.paths.base import Path', 'paths'),
    ('geometry.rig', 'from .. import cli', 'cli'),
    ('config', 'from .sync import PairMatcher', 'sync'),
    ('sim.scene', 'from sensor_msgs.msg import Image', 'sensor_msgs'),
], ids=lambda value: value[:30])
def test_faults_are_seen(module, source, wanted):
    assert len(faults(source, module)) == 1
    assert wanted in faults(source, module)[0]


def test_downward_imports_are_no_faults():
    source = 'import numpy\nfrom .. import __version__\nfrom ..geometry.rig import StereoRig\n' \
             'from .base import Tracker\n'
    assert faults(source, 'tracking.constrained') == []
