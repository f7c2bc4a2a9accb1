# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``studio``: serve a web page on this machine to set up a site, measure, and review runs.

Draw the lines of a site on the images of a bag, and see at once how accurate the site is. Open
the printed address; it is secret.
"""
from __future__ import annotations

import argparse
from pathlib import Path
import sys
from typing import Optional

from .options import number_in
from ..core.errors import InputError
from ..pipeline.config import load_pipeline_config
from ..studio.guard import Guard, LOCALHOST
from ..studio.opening import open_runs
from ..studio.scene import Scene
from ..studio.serve import serve
from ..studio.server import Studio
from ..studio.workspace import Workspace

PORT = 8765


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``studio``."""
    parser.add_argument('bag', metavar='BAG', type=Path, nargs='?',
                        help='rosbag2 folder, .mcap or .db3 file, or ROS 1 .bag')
    parser.add_argument('--site', type=Path, help='site file (YAML), opened if it exists, and '
                        'saved to (default: BAG_site.yaml in this folder)')
    parser.add_argument('--init', type=Path, help='init file (YAML) of marked fronts, used '
                        'likewise (default: BAG_init.yaml in this folder)')
    parser.add_argument('--run', action='append', default=[], type=Path, metavar='PATH',
                        help='results to review: a folder written by replay, or a folder of such '
                        'folders; a folder of evidence; an SQLite file of log_node, replay or '
                        'replay-many; may be given several times', dest='runs')
    parser.add_argument('--live', action='store_true',
                        help='watch the ROS 2 graph, as studio_node does')
    parser.add_argument('--port', type=number_in(int, 0, 65535), default=PORT, metavar='N',
                        help=f'port (default: {PORT}; 0 for any free one)')
    parser.add_argument('--address', default=LOCALHOST, metavar='IP',
                        help=f'address to listen on (default: {LOCALHOST}, this machine only); '
                        'the connection is not encrypted')
    parser.add_argument('--config', type=Path, metavar='YAML', help='parameters')
    parser.add_argument('--left', metavar='TOPIC', help='topic of the left images')
    parser.add_argument('--right', metavar='TOPIC', help='topic of the right images')


def run(args: argparse.Namespace) -> int:
    """Open bag, site and runs, then serve the page until interrupted."""
    if args.live:
        return _live(args)
    guard = Guard(args.address)
    config = load_pipeline_config(args.config)
    if args.bag is None and (args.site is not None or args.init is not None):
        raise InputError('studio', 'BAG', 'none with a site or init file',
                         'the bag on which it is drawn')
    runs = open_runs(args.runs)
    socket = guard.bind(args.port)
    with socket:
        scene: Optional[Scene] = None
        workspace: Optional[Workspace] = None
        try:
            if args.bag is not None:
                scene = Scene(args.bag, args.left, args.right)
                stem = args.bag.resolve().stem
                workspace = Workspace(scene, _file(args.site, f'{stem}_site.yaml'),
                                      _file(args.init, f'{stem}_init.yaml'), config)
                print(f'the site is saved to {workspace.site_path}')
            print(f'open {guard.url}', flush=True)
            serve(Studio(guard, workspace, runs), socket)
        finally:
            if scene is not None:
                scene.close()
    if workspace is not None and workspace.unsaved:
        print(f'warning: changes of the site were not saved to {workspace.site_path}',
              file=sys.stderr)
    return 0


def _live(args: argparse.Namespace) -> int:
    """Run the node that listens to the graph."""
    if args.bag is not None or args.runs:
        raise InputError('studio', '--live', 'a bag or a run as well', 'only one of them')
    from ..nodes.studio_node import main  # rclpy is needed for this alone
    return main(['--ros-args', '-p', f'port:={args.port}', '-p', f'address:={args.address}'])


def _file(given: Optional[Path], name: str) -> Path:
    """Return the path of a file to open and save to; ``name`` where none is given."""
    path = Path(name) if given is None else given
    if path.is_dir():
        raise InputError(path, 'file', 'a folder', 'the name of a file')
    if not path.resolve().parent.is_dir():
        raise InputError(path, 'folder', 'none', 'an existing folder')
    return path
