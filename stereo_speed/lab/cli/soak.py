# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``endurance soak``: simulated traffic through the live nodes, in real time, for as long as wanted.

A stretch of traffic is simulated once and goes round, with stamps that go on rising. The nodes run
as processes of their own over DDS. Every pair must come through, every vehicle that is well seen
must be measured once in every round, and memory and handles of the nodes must not grow.
"""
from __future__ import annotations

import argparse
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
import shutil
import sqlite3
import sys
import time
from typing import Any, Mapping, Sequence

from tqdm import tqdm

from ..evaluation.soak import (
    counted_vehicles, Held, held_table, lost_pairs, Rounds, Sample, sample_of, Soaked, SoakRules)
from ..evaluation.traffic_run import stream_of, TRUTH
from ..sim.config import RigConfig, RIGS
from ..sim.traffic_config import traffic_config
from ..sim.write import write_traffic_bag
from ...cli.demo import (
    EVERY_PAIR, private_graph, Process, RELIABLE_IMAGES, RELIABLE_INFOS)
from ...cli.options import number_in
from ...core.errors import StereoSpeedError
from ...io.atomic import prepare_folder
from ...io.bags import StereoBag
from ...io.truth import read_truth

_START_S = 180.0  # the first start compiles the kernels
_END_S, _STEP_S = 90.0, 2.0
_SAMPLES = 240  # of what the nodes hold, over the run


class SoakError(StereoSpeedError):
    """The nodes did not stay up."""


def add_soak(actions: Any) -> None:
    """Add the action."""
    parser = actions.add_parser('soak', help='traffic through the live nodes, for long',
                                description=__doc__)
    add = parser.add_argument
    rules = SoakRules()
    add('--minutes', type=number_in(float, 0.5, 10_000), default=60.0,
        help='how long, at least; whole rounds are played (default: 60)')
    add('--round-minutes', type=number_in(float, 0.1, 60), default=2.0, metavar='M',
        help='length of the traffic that goes round (default: 2)')
    add('--vehicles', type=number_in(int, 1, 1000), default=14, metavar='N',
        help='of a round (default: 14)')
    add('--fps', type=number_in(float, 1, 60), default=5.0, help='pairs per second (default: 5)')
    add('--lanes', type=int, choices=(1, 2, 3), default=2)
    add('--seed', type=number_in(int, 0, 2 ** 63), default=11)
    add('--width', type=number_in(int, 640, 4096), default=1024, metavar='PX',
        help='of the images, which are three quarters as high (default: 1024)')
    add('--one-node', action='store_true',
        help='measure with speed_camera_node as it is installed, which hurries pairs where it '
             'does not keep up, in place of three nodes that hurry none')
    add('--growth-mb', type=number_in(float, 0, 1e6), default=rules.growth_mb, metavar='MB',
        help=f'most growth of a node after its warm-up (default: {rules.growth_mb:g})')
    add('--out', type=Path, required=True, metavar='DIR')
    parser.set_defaults(run=run_soak)


def run_soak(args: argparse.Namespace) -> int:
    """Simulate a round, play it through the nodes for so long, print what came of it."""
    rules = SoakRules(growth_mb=args.growth_mb)
    folder = prepare_folder(args.out)
    traffic = folder / 'traffic'
    shutil.rmtree(traffic, ignore_errors=True)
    write_traffic_bag(stream_of(traffic_config(
        lanes=args.lanes, fps=args.fps, minutes=args.round_minutes, vehicles=args.vehicles,
        rig=_rig(args.width)), args.seed), traffic, compressed=True)
    soaked = _soak(folder, args)
    print(soaked.table().markdown())
    print(soaked.delays_table().markdown())
    print(held_table(soaked.held, soaked.minutes).markdown())
    faults = [*soaked.faults(rules), *_log_faults(folder / 'log.sqlite', soaked)]
    for line in soaked.notes(rules):
        print(line)
    for line in faults:
        print(f'error: {line}', file=sys.stderr)
    return 1 if faults else 0


def _soak(folder: Path, args: argparse.Namespace) -> Soaked:
    """Play the traffic of a folder round after round."""
    traffic = folder / 'traffic'
    with StereoBag(traffic / 'bag') as bag:
        stamps_ns = [pair.stamp_ns for pair in bag.pairs()]
    # one more interval, so that the rounds follow on each other as pairs do
    round_ns = stamps_ns[-1] - stamps_ns[0] + round(1e9 / args.fps)
    played = -(-round(args.minutes * 60e9) // round_ns)
    truth = read_truth(traffic / TRUTH)
    rounds = Rounds(truth, counted_vehicles(traffic / TRUTH, truth), round_ns, stamps_ns[0])
    (folder / 'log.sqlite').unlink(missing_ok=True)
    private_graph()
    from ...nodes.soak_listener import SoakListener
    samples: dict[str, list[Sample]] = {}
    with ExitStack() as stack:
        nodes = {command[0]: stack.enter_context(Process(*command))
                 for command in _nodes(folder, one=args.one_node)}
        listener = SoakListener(rounds.add)
        stack.callback(listener.close)
        if not listener.spin(_START_S, lambda: _alive(nodes) and listener.connected(
                '/vehicle_speed', '/tracks', '/track_states', '/passes')):
            raise SoakError(f'soak: graph: found nodes that are not connected after '
                            f'{_START_S:.0f} s, wanted all of them')
        replay = stack.enter_context(Process(
            'repeating_replay_node', f'bag:={traffic / "bag"}', f'rounds:={played}',
            f'round_s:={round_ns * 1e-9}',
            'wait_for_topics:=' + ('tracks' if args.one_node else 'stereo/image_pair tracks')))
        listener.spin(_START_S, lambda: _alive(nodes) and bool(listener.delays_s))
        begun_s, total = time.monotonic(), played * len(stamps_ns)
        step_s = max(played * round_ns * 1e-9 / _SAMPLES, _STEP_S)
        with tqdm(total=total, desc='soak', unit='pair', disable=None) as bar:
            while not replay.ended() and _alive(nodes):
                for name, node in nodes.items():
                    samples.setdefault(name, []).append(
                        sample_of(node.process.pid, time.monotonic()))
                listener.spin(step_s, replay.ended)
                bar.update(len(listener.pairs_ns) - bar.n)
            minutes = (time.monotonic() - begun_s) / 60
            # what is on its way, and passes that wait for their ends
            listener.spin(_END_S, lambda: _alive(nodes) and len(listener.pairs_ns) >= total)
            listener.spin(_STEP_S, lambda: False)
    return Soaked(
        minutes=minutes, pairs=lost_pairs(listener.pairs_ns, stamps_ns, round_ns, played),
        delays_s=listener.delays_s, reading_delays_s=listener.reading_delays_s,
        readings=listener.readings, rounds=rounds, played=played,
        held=[Held.of(name, samples.get(name, ()), SoakRules()) for name in nodes])


def _rig(width_px: int) -> RigConfig:
    """Return a rig of the usual field of view with images of another size."""
    usual = RIGS['parallel']
    return replace(usual, width_px=width_px, height_px=width_px * 3 // 4,
                   f_px=usual.f_px * width_px / usual.width_px)


def _nodes(folder: Path, *, one: bool) -> list[tuple[str, ...]]:
    """Return the commands of the nodes; those that measure are one, or three."""
    site, images = f'site:={folder / "traffic" / "site.yaml"}', (*RELIABLE_IMAGES, *RELIABLE_INFOS)
    measuring = [('speed_camera_node', *images, site)] if one else [
        ('stereo_sync_node', *images), ('speed_node',),
        ('tracker_node', *RELIABLE_INFOS, site, *EVERY_PAIR)]
    return [*measuring, ('log_node', f'file:={folder / "log.sqlite"}')]


def _alive(nodes: Mapping[str, Process]) -> bool:
    """
    Return True.

    :raises SoakError: one of the nodes has ended.
    """
    for node in nodes.values():
        if node.ended():
            raise SoakError(f'soak: {node.name}: found it ended with status '
                            f'{node.process.returncode}, wanted it running')
    return True


def _log_faults(path: Path, soaked: Soaked) -> Sequence[str]:
    """Return what is wrong with the log that ``log_node`` has written."""
    with sqlite3.connect(path) as log:
        (logged,), = log.execute("SELECT count(*) FROM passes WHERE verdict = 'measured'")
    told = len(soaked.rounds.errors_mps) + soaked.rounds.astray
    return [] if logged == told else [f'{path}: {logged} passes logged, {told} were told']
