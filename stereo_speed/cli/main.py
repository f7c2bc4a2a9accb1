# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The command line: ``python -m stereo_speed COMMAND``, and one executable per command.

Each command is a module with ``add_arguments(parser)`` and ``run(args) -> int``, or with
subparsers for its actions that set ``run``; its docstring is the description in ``--help``. Only
the module of the requested command is imported, so that a missing dependency of one command does
not break the others.
"""
from __future__ import annotations

import argparse
import importlib
import logging
from pathlib import Path
import sys
from typing import NoReturn, Optional, Sequence

from .. import __version__
from ..core.errors import StereoSpeedError

COMMANDS = {
    'replay': ('stereo_speed.cli.replay', 'measure the vehicles of a stereo bag, offline'),
    'evidence': ('stereo_speed.cli.evidence',
                 'verify, recompute or disclose records of violations'),
    'self-test': ('stereo_speed.cli.self_test', 'measure a stored pass of known speed'),
    'stats': ('stereo_speed.cli.stats', 'print traffic statistics of many runs'),
    'verify-against': ('stereo_speed.cli.verify_against',
                       'compare measured passes with a reference of known speeds'),
    'replay-many': ('stereo_speed.cli.replay_many',
                    'measure the vehicles of many bags, on several cores or a cluster'),
    'site': ('stereo_speed.cli.site', 'refine or check a site from the images of a bag'),
    'studio': ('stereo_speed.cli.studio', 'serve a web page to set up a site and review runs'),
    'track-environment': ('stereo_speed.cli.track_environment',
                          'follow marked targets through the video of one camera'),
    'map': ('stereo_speed.cli.environment_map', 'draw the map of a scene from polygons'),
    'demo': ('stereo_speed.cli.demo',
             'play the sample bag through the live nodes and print the readings'),
    'simulate': ('stereo_speed.lab.cli.simulate',
                 'write a simulated pass: bag, site, init and truth'),
    'disturb': ('stereo_speed.lab.cli.disturb',
                'copy a bag as if the rig had swayed, turned or been out of focus'),
    'accuracy': ('stereo_speed.lab.cli.accuracy',
                 'tabulate errors on simulated passes with exact truth'),
    'second': ('stereo_speed.lab.cli.second',
               'tabulate how well the two estimates of simulated passes agree'),
    'violations': ('stereo_speed.lab.cli.violations',
                   'compare records of violations in faulty traffic with the truth'),
    'evaluate': ('stereo_speed.lab.cli.evaluate',
                 'compare trackers on sequences with truth; rerun tables of the papers'),
    'traffic': ('stereo_speed.lab.cli.traffic',
                'measure simulated traffic with exact truth, and tabulate errors'),
    'roads': ('stereo_speed.lab.cli.roads',
              'click and refine simulated roads, and tabulate errors'),
    'tamper': ('stereo_speed.lab.cli.tamper',
               'damage copies of records, and tabulate what is detected'),
    'faults': ('stereo_speed.lab.cli.faults',
               'feed faulty streams to the live nodes, and tabulate the effects'),
    'endurance': ('stereo_speed.lab.cli.endurance',
                  'measure time and memory of many bags, long bags and long live runs'),
    'fuzz': ('stereo_speed.lab.cli.fuzz', 'feed damaged input to everything that reads files'),
    'bench': ('stereo_speed.lab.cli.bench', 'time the tracker'),
}
INPUT_ERROR = 2
INTERRUPTED = 130


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Print one line, without the usage, and exit with 2."""
        self.exit(INPUT_ERROR, f'error: {self.prog}: {" ".join(message.split())}\n')


def build_parser(command: Optional[str]) -> argparse.ArgumentParser:
    """
    Make the parser; only the requested command gets its options.

    :param command: name of the requested command; the others are only listed.
    """
    parser = Parser(prog='stereo_speed',
                    description='Ground speed of vehicles from a stereo pair.')
    parser.add_argument('--version', action='version', version=f'stereo_speed {__version__}')
    subparsers = parser.add_subparsers(metavar='COMMAND', required=True)
    for name, (module, text) in COMMANDS.items():
        of_command = subparsers.add_parser(name, help=text)
        if name == command:
            found = importlib.import_module(module)
            of_command.description = found.__doc__
            of_command.set_defaults(run=getattr(found, 'run', None))
            found.add_arguments(of_command)
    return parser


def main(argv: Optional[Sequence[str]] = None) -> int:
    """
    Run one command.

    :param argv: arguments without the program's name; those of the process by default.
    :return: exit status: 0 done, 2 bad input, 130 interrupted.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    # Commands print what users need; log records would break the rule of one line per error.
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


def run_executable() -> int:
    """Run the command that the executable is named after, as ``ros2 run`` starts it."""
    return main([Path(sys.argv[0]).stem, *sys.argv[1:]])
