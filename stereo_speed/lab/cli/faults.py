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
from contextlib import contextmanager, ExitStack
import os
from pathlib import Path
import signal
import sys
import time
from typing import Iterator, Sequence, TYPE_CHECKING

import numpy as np

from .fault_rows import HEADING, is_back, Row, row_of, Times
from .fault_trials import played, SLACK, Trial, TRIALS
from .fault_truth import Truth
from ...cli.demo import private_graph, Process
from ...cli.options import number_in
from ...core.errors import InputError
from ...io.bags import StereoBag
from ...io.truth import read_truth, VehicleTruth

if TYPE_CHECKING:
    from ...nodes.fault_listener import Heard

_START_S, _AFTER_S = 180.0, 4.0  # the first start compiles the kernels
_APART_PERIOD_S = 0.2  # period of cameras that expose at different times
_RESPAWN_S = 0.2  # as in the launch file
_APPROXIMATE = ('approximate_sync:=true', 'approximate_sync_tolerance_seconds:=0.06')
_PROFILE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
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


def run(args: argparse.Namespace) -> int:
    """Run the trials one after the other, and print a row for each."""
    names = args.fault or played(_ONE_NODE if args.single else _THREE_NODES)
    for name in names:
        if name not in TRIALS:
            raise InputError('faults', '--fault', name, 'one of ' + ', '.join(TRIALS))
        if TRIALS[name].kill and (TRIALS[name].kill in _ONE_NODE) != args.single:
            raise InputError('faults', '--fault', name, 'one of the nodes that are started; '
                             '--single starts one node instead of three')
    truth = read_truth(args.traffic / 'truth.csv')
    with StereoBag(args.traffic / 'bag') as bag:
        first_ns = next(iter(bag.messages())).stamp_ns
    private_graph()
    print(HEADING, flush=True)
    good = True
    for name in names:
        row = _play(name, args, truth, first_ns)
        failures = row.failures(TRIALS[name], args.length, args.rate, args.slack)
        print(row.line(failures, row.is_late(TRIALS[name], args.rate)), flush=True)
        for failure in failures:
            print(f'{name}: FAILED: {failure}', file=sys.stderr)
        good &= not failures
    return 0 if good else 1


def _play(name: str, args: argparse.Namespace, truth: Sequence[VehicleTruth], first_ns: int
          ) -> Row:
    """
    Play the bag with one fault.

    :param first_ns: first stamp of the bag.
    """
    from ...nodes.fault_listener import FaultListener
    trial = TRIALS[name]
    pairing = [*trial.pairing, *(_APPROXIMATE if trial.approximate else ())]
    site = f'site:={args.traffic / "site.yaml"}'
    commands = [('speed_camera_node', site, *pairing)] if args.single else [
        ('stereo_sync_node', *pairing), ('tracker_node', site), ('speed_node',)]
    first_s = args.start if trial.first_s is None else trial.first_s
    length_s = args.length if trial.length_s is None else trial.length_s
    with ExitStack() as stack:
        with profile_of('nodes', trial):
            nodes = {command[0]: stack.enter_context(Process(*command)) for command in commands}
        listener = FaultListener()
        stack.callback(listener.close)
        if not listener.spin(_START_S, lambda: listener.connected(
                '/vehicle_speed', '/passes', '/tracks', '/diagnostics')
                and _measures(listener.heard)):
            raise InputError('faults', 'graph', 'nodes that do not connect', 'all of them')
        chain = [] if args.single else ['wait_for_topics:=stereo/image_pair tracks']
        with profile_of('camera', trial):
            replay = stack.enter_context(Process(
                'faulty_replay_node', f'bag:={args.traffic / "bag"}', f'rate:={args.rate}',
                *chain, *trial.sending,
                f'fault:={name if trial.stream is None else trial.stream}',
                f'fault_start:={first_s}', f'fault_length:={length_s}', f'length:={args.play}',
                f'exposures:={_exposures(truth)}'))
        if not listener.spin(_START_S, lambda: bool(listener.heard.begun_s)):
            raise InputError('faults', name, f'no replay within {_START_S:.0f} s', 'one')
        # On a busy machine the first messages of the replay may be missed here.
        begun_s = listener.heard.begun_s - (
            listener.heard.begun_ns - first_ns) * 1e-9 / args.rate
        ended_s = begun_s + (0.0 if trial.always else (first_s + length_s) / args.rate)
        if trial.kill or trial.kill_helper:
            listener.spin(max(begun_s + args.start / args.rate - time.monotonic(), 0.0),
                          replay.ended)
        if trial.kill:
            nodes[trial.kill].process.kill()
            listener.spin(_RESPAWN_S, lambda: False)
            command = next(c for c in commands if c[0] == trial.kill)
            nodes[trial.kill] = stack.enter_context(Process(*command))
            ended_s = time.monotonic()
        elif trial.kill_helper:
            node = nodes['speed_camera_node' if args.single else 'tracker_node']
            os.kill(helper_of(node.process.pid, trial.kill_helper), signal.SIGKILL)
            ended_s = time.monotonic()
        rest_s = max(begun_s + args.play / args.rate - time.monotonic(), 0.0)
        listener.spin(rest_s, replay.ended)
        back = is_back(listener.heard)
        listener.spin(_AFTER_S, lambda: False)
        alive = not any(node.ended() for node in nodes.values())
    return row_of(name, listener.heard, Truth(truth, trial.shifts_s),
                  Times(begun_s, begun_s + first_s / args.rate, ended_s,
                        first_ns + round((ended_s - begun_s) * args.rate * 1e9),
                        args.play / args.rate), alive, back)


@contextmanager
def profile_of(role: str, trial: Trial) -> Iterator[None]:
    """
    Give processes that are started here the DDS profile for large images, or not.

    :param role: their role in the graph: camera, nodes.
    :param trial: the trial that is played.
    """
    profile = os.environ.pop(_PROFILE, None) if role in trial.no_profile else None
    try:
        yield
    finally:
        if profile is not None:
            os.environ[_PROFILE] = profile


def helper_of(pid: int, module: str) -> int:
    """
    Return the id of the helper process that a node has started for a module.

    :raises InputError: there is no such process.
    """
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            parent = int((folder / 'stat').read_text().rpartition(')')[2].split()[1])
            command = (folder / 'cmdline').read_text() + (folder / 'comm').read_text()
        except OSError:  # the process has ended
            continue
        if parent == pid and module in command:
            return int(folder.name)
    raise InputError('faults', f'process {pid}', f'no child process that runs {module}', 'one')


def _exposures(truth: Sequence[VehicleTruth]) -> int:
    """Return the number of exposures of the bag between two images of a camera."""
    stamps_ns = np.unique(np.concatenate([vehicle.stamps_ns for vehicle in truth]))
    return max(round(_APART_PERIOD_S / (float(np.diff(stamps_ns).min()) * 1e-9)), 2)


def _measures(heard: Heard) -> bool:
    """Return whether the measuring node reports that it is ready to measure."""
    said = [message for _, name, _, message in heard.levels if name.endswith(': pipeline')]
    return bool(said) and not said[-1].startswith(('not configured', 'inactive'))
