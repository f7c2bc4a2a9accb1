# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The command line: ``python -m stereo_speed COMMAND``, and one executable per command.

Each command is a module beside this one with ``add_parser(subparsers)``, whose parser carries
``run(args) -> int``. Only the module of the command in hand is imported, so that what one of
them lacks does not break the others.
"""
from __future__ import annotations

import argparse
import importlib
import logging
import sys
from typing import NoReturn, Optional, Sequence

from .. import __version__
from ..errors import StereoSpeedError

COMMANDS = {
    'replay': 'measure the vehicles of a stereo bag, offline',
    'site': 'refine or check a site from the images of a bag',
    'simulate': 'write a simulated pass: bag, site, init and truth',
    'accuracy': 'tabulate errors on simulated passes with exact truth',
    'evaluate': 'compare trackers on sequences with truth; the tables of the papers',
    'traffic': 'measure simulated traffic with exact truth, and tabulate',
    'track-environment': 'follow marked targets through the video of one camera',
    'map': 'draw the map of a scene from polygons',
    'bench': 'time the tracker',
    'demo': 'play the sample bag through the live nodes and print the readings',
}
# Modules and functions of another name than their command
MODULES = {'track-environment': 'track_environment', 'map': 'environment_map'}
INPUT_ERROR = 2
INTERRUPTED = 130


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Print one line, without the usage, and exit with 2."""
        self.exit(INPUT_ERROR, f'error: {self.prog}: {" ".join(message.split())}\n')


def build_parser(command: Optional[str]) -> argparse.ArgumentParser:
    """
    Make the parser; of the commands, only the one in hand gets its options.

    :param command: name of the command in hand; others are only listed.
    """
    parser = Parser(prog='stereo_speed',
                    description='Ground speed of vehicles from a stereo pair.')
    parser.add_argument('--version', action='version', version=f'stereo_speed {__version__}')
    subparsers = parser.add_subparsers(metavar='COMMAND', required=True)
    for name, text in COMMANDS.items():
        if name == command:
            module = MODULES.get(name, name)
            importlib.import_module(f'.{module}', __package__).add_parser(subparsers)
        else:
            subparsers.add_parser(name, help=text)
    return parser


def main(argv: Optional[Sequence[str]] = None) -> int:
    """
    Run one command.

    :param argv: arguments without the program's name; those of the process by default.
    :return: exit status: 0 done, 2 bad input, 130 interrupted.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    # Commands say what matters themselves; errors stay one line.
    logging.getLogger('stereo_speed').addHandler(logging.NullHandler())
    command = next((word for word in argv if not word.startswith('-')), None)
    try:
        args = build_parser(command).parse_args(argv)
        return int(args.run(args) or 0)
    except SystemExit as stop:  # argparse ends this way, after --help as well as after errors
        return int(stop.code or 0)
    except StereoSpeedError as error:
        return _refuse(str(error))
    except OSError as error:
        return _refuse(f'{error.filename or command}: {error.strerror or error}')
    except ModuleNotFoundError as error:
        if (error.name or 'stereo_speed').partition('.')[0] == 'stereo_speed':
            raise
        return _refuse(f'{command}: needs the Python module {error.name}, which is not installed')
    except KeyboardInterrupt:
        return INTERRUPTED


def _refuse(line: str) -> int:
    print('error:', ' '.join(line.split()), file=sys.stderr)
    return INPUT_ERROR


def replay() -> int:
    """Run ``replay`` as an executable of its own."""
    return main(['replay', *sys.argv[1:]])


def site() -> int:
    """Run ``site`` as an executable of its own."""
    return main(['site', *sys.argv[1:]])


def simulate() -> int:
    """Run ``simulate`` as an executable of its own."""
    return main(['simulate', *sys.argv[1:]])


def accuracy() -> int:
    """Run ``accuracy`` as an executable of its own."""
    return main(['accuracy', *sys.argv[1:]])


def evaluate() -> int:
    """Run ``evaluate`` as an executable of its own."""
    return main(['evaluate', *sys.argv[1:]])


def traffic() -> int:
    """Run ``traffic`` as an executable of its own."""
    return main(['traffic', *sys.argv[1:]])


def track_environment() -> int:
    """Run ``track-environment`` as an executable of its own."""
    return main(['track-environment', *sys.argv[1:]])


def environment_map() -> int:
    """Run ``map`` as an executable of its own."""
    return main(['map', *sys.argv[1:]])


def bench() -> int:
    """Run ``bench`` as an executable of its own."""
    return main(['bench', *sys.argv[1:]])


def demo() -> int:
    """Run ``demo`` as an executable of its own."""
    return main(['demo', *sys.argv[1:]])
