# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``faults``: break a stream in many ways while the live nodes measure it.

The nodes run as separate processes over DDS, as in ``demo``. A bag of simulated traffic is played
to them with one fault after the other, and all their output is compared with the truth. A reading
or a pass is wrong if its error exceeds 1 mph and 4 sigma. Each row must also be as expected of its
fault: /diagnostics reports it and is OK again after it, readings come, and soon after its end.
"""
from __future__ import annotations

import argparse
from pathlib import Path
import sys

from .fault_play import play, Playing, Recorded
from .fault_rows import HEADING
from .fault_trials import played, SLACK, TRIALS
from ...cli.demo import private_graph
from ...cli.options import number_in
from ...core.errors import InputError
from ...io.bags import StereoBag
from ...io.truth import read_truth

_ONE_NODE = ('speed_camera_node',)
_THREE_NODES = ('stereo_sync_node', 'tracker_node', 'speed_node')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``faults``."""
    parser.add_argument('traffic', type=Path,
                        help='folder written by traffic --bag: bag, site.yaml, truth.csv')
    parser.add_argument('--fault', action='append', metavar='NAME',
                        help='play only this fault; may be given several times')
    parser.add_argument('--single', action='store_true',
                        help='one node, speed_camera_node, instead of three')
    parser.add_argument('--rate', type=float, default=1.0, help='speed of the replay')
    parser.add_argument('--start', type=float, default=5.0, help='start of the fault, s')
    parser.add_argument('--length', type=float, default=3.0, help='length of the fault, s')
    parser.add_argument('--play', type=float, default=18.0,
                        help='seconds of the bag that are played')
    parser.add_argument('--slack', type=number_in(float, 1, 100), default=SLACK,
                        help='a row fails if right readings come later than this many times '
                             'the limit of its fault (default: %(default)g); later than the '
                             'limit, it is only marked as late')
    parser.add_argument('--again', type=number_in(int, 0, 9), default=0,
                        help='how often a trial is played again whose row is not as expected, '
                             'as on a busy machine; never one with wrong results or with a node '
                             'that has ended (default: %(default)d)')


def run(args: argparse.Namespace) -> int:
    """Play the trials one after the other, and print a row for each time that one is played."""
    names = args.fault or played(_ONE_NODE if args.single else _THREE_NODES)
    for name in names:
        if name not in TRIALS:
            raise InputError('faults', '--fault', name, 'one of ' + ', '.join(TRIALS))
        if TRIALS[name].kill and (TRIALS[name].kill in _ONE_NODE) != args.single:
            raise InputError('faults', '--fault', name, 'one of the nodes that are started; '
                             '--single starts one node instead of three')
    traffic = recorded(args.traffic)
    private_graph()
    print(HEADING, flush=True)
    failed = [name for name in names if not _play_and_tell(playing(name, args), traffic, args)]
    if failed:
        print(f'FAILED: {", ".join(failed)}', file=sys.stderr)
    return 1 if failed else 0


def recorded(folder: Path) -> Recorded:
    """
    Return the traffic in a folder.

    :raises InputError: a file of it is missing or cannot be used.
    """
    with StereoBag(folder / 'bag') as bag:
        first_ns = next(iter(bag.messages())).stamp_ns
    return Recorded(folder, read_truth(folder / 'truth.csv'), first_ns)


def playing(name: str, args: argparse.Namespace) -> Playing:
    """Return how a trial is played with these arguments."""
    trial = TRIALS[name]
    return Playing(
        name, trial, args.single, args.rate,
        args.start if trial.first_s is None else trial.first_s,
        args.length if trial.length_s is None else trial.length_s, args.play)


def _play_and_tell(how: Playing, traffic: Recorded, args: argparse.Namespace) -> bool:
    """Play a trial, print its row, and return whether it, or its repetition, is as expected."""
    for _ in range(1 + args.again):
        row = play(how, traffic)
        failures = row.failures(how.trial, how.length_s, how.rate, args.slack)
        print(row.line(failures, row.is_late(how.trial, how.rate)), flush=True)
        for failure in failures:
            print(f'{how.name}: FAILED: {failure}', file=sys.stderr)
        if not failures or row.is_wrong or not row.alive:  # no busy machine excuses these
            break
    return not failures
