# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The layers: imports only point down, and reserved libraries stay in their rooms."""
from __future__ import annotations

import ast
from pathlib import Path
from typing import Iterator

import pytest

ROOT = Path(__file__).resolve().parents[1] / 'stereo_speed'
MODULES = sorted(ROOT.rglob('*.py'))

# Rooms from the bottom up; a room imports itself and those below. Rooms on one line are
# unrelated. A subfolder with its own entry is a room as well.
LAYERS = (
    ('core', '__init__'),
    ('geometry', 'vision', 'estimation'),
    ('road',),
    ('site',),
    ('site.refine',),
    ('classification', 'detection', 'monocular', 'second', 'steadying', 'survey', 'tracking'),
    ('pipeline',),
    ('io',),
    ('batch', 'report'),
    ('enforcement',),
    ('studio',),
    ('lab.reference', 'lab.sim'),
    ('lab.baselines',),
    ('lab.evaluation',),
    ('nodes',),
    ('cli',),
    ('lab.cli',),
    ('__main__',),
)
RANK = {room: rank for rank, rooms in enumerate(LAYERS) for room in rooms}
LABORATORY = 'lab'  # the instrument imports nothing of it
# Libraries and the rooms that may import them; others may be imported anywhere.
ROOMS_OF = {
    'rclpy': {'nodes'},
    'rosbags': {'io', 'lab.sim'},
    'mcap': {'io', 'lab.sim'},
    'matplotlib': {'report'},
    'cryptography': {'enforcement'},
    'reportlab': {'enforcement'},
    'jsonschema': {'enforcement'},
    'jinja2': {'report'},
    'aiohttp': {'studio'},
    'tqdm': {'batch', 'cli', 'lab.cli', 'lab.evaluation'},
    'distributed': {'batch'},
    'pyarrow': {'io'},
    'argparse': {'cli', 'lab.cli', 'nodes'},
}
ROS_MESSAGES = ('sensor_msgs', 'nav_msgs', 'geometry_msgs', 'visualization_msgs',
                'diagnostic_msgs', 'rosgraph_msgs', 'std_msgs', 'builtin_interfaces',
                'rcl_interfaces', 'tf2_msgs', 'lifecycle_msgs')
ROOMS_OF.update({name: {'nodes'} for name in ROS_MESSAGES})


def room_of(module: str) -> str:
    """
    Return the room of a module of the package.

    :param module: dotted name below the package, '' for the package itself.
    """
    parts = module.split('.')
    inner = '.'.join(parts[:2])
    return inner if inner in RANK else parts[0] or '__init__'


def imports_of(source: str, module: str, is_package: bool) -> Iterator[tuple[str, bool]]:
    """
    Return the imports of a module, wherever in the module they are.

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
                name = alias.name if alias and is_room(alias.name) else '.'.join(base)
                yield name, True


def is_room(name: str) -> bool:
    """Return whether a name is that of a folder of the package."""
    return any(room.split('.')[0] == name for room in RANK)


def faults(source: str, module: str, is_package: bool = False) -> list[str]:
    """Return the imports of a module that the layering forbids."""
    room = room_of(module)
    found = []
    for name, ours in imports_of(source, module, is_package):
        target = room_of(name)
        if ours and in_laboratory(target) and not in_laboratory(room):
            found.append(f'{module} of the instrument imports {name} of the laboratory')
        elif ours and target != room and RANK.get(target, len(LAYERS)) >= RANK[room]:
            found.append(f'{module} imports {name}, which is not below it')
        library = name.partition('.')[0]
        if not ours and room not in ROOMS_OF.get(library, {room}):
            found.append(f'{module} imports {name}, which only {ROOMS_OF[library]} may')
    return found


def in_laboratory(room: str) -> bool:
    """Return whether a room belongs to the laboratory."""
    return room.partition('.')[0] == LABORATORY


def dotted(path: Path) -> str:
    """Return the dotted name of a source file, below the package."""
    parts = path.relative_to(ROOT).with_suffix('').parts
    return '.'.join(parts[:-1] if len(parts) > 1 and parts[-1] == '__init__' else parts)


@pytest.mark.parametrize('path', MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_point_down(path):
    room = room_of(dotted(path))
    if dotted(path) == LABORATORY:
        return  # the laboratory's own docstring
    assert room in RANK, f'{room} has no place in LAYERS'
    assert faults(path.read_text(), dotted(path), path.name == '__init__.py') == []


@pytest.mark.parametrize(('module', 'source', 'wanted'), [
    ('tracking.protocol', 'from ..pipeline.pipeline import SpeedPipeline', 'pipeline'),
    ('tracking.protocol', 'import rclpy', 'rclpy'),
    ('tracking.protocol', 'from rosbags.rosbag2 import Reader', 'rosbags'),
    ('geometry.rig', 'def f():\n    import matplotlib.pyplot', 'matplotlib'),
    ('geometry.rig', 'from stereo_speed.road.path import Path', 'road'),
    ('geometry.rig', 'from .. import cli', 'cli'),
    ('core.config', 'from ..geometry import rig', 'geometry'),
    ('lab.sim.scene', 'from sensor_msgs.msg import Image', 'sensor_msgs'),
    ('nodes.tracker_node', 'from ..lab.sim.scene import Scene', 'laboratory'),
    ('cli.replay', 'from .. import lab', 'laboratory'),
    ('site.file', 'from .refine.refiner import refine_site', 'site.refine'),
], ids=lambda value: value[:30])
def test_faults_are_found(module, source, wanted):
    assert len(faults(source, module)) == 1
    assert wanted in faults(source, module)[0]


def test_downward_imports_are_no_faults():
    source = 'import numpy\nfrom .. import __version__\nfrom ..geometry.rig import StereoRig\n' \
             'from .protocol import Tracker\n'
    assert faults(source, 'tracking.constrained') == []
