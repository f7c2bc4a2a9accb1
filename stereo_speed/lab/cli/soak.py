# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``endurance soak``: play simulated traffic through the live nodes in real time, for a long time.

A section of traffic is simulated once and repeated, with stamps that keep rising. The nodes run as
separate processes over DDS. Every pair must be processed, every well-seen vehicle must be measured
once in every round, no live reading and no pass may be wrong, and memory and handles of the nodes
must not grow. Where the nodes are overloaded on purpose (``--burn``), pairs may be skipped and
vehicles missed, but what is measured must be right.
"""
from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path
import shutil
import sqlite3
import sys
import time
from typing import Any, Sequence

from tqdm import tqdm

from .live_graph import (
    alive, Burner, confined, ONE_NODE, play, started, TOLD, Traffic)
from ..evaluation.soak import (
    counted_vehicles, Held, held_table, lost_pairs, Rounds, Sample, sample_of, Soaked, SoakRules)
from ..evaluation.traffic_run import TRUTH
from ...cli.demo import EVERY_PAIR, private_graph, RELIABLE_IMAGES, RELIABLE_INFOS
from ...cli.options import number_in
from ...io.atomic import prepare_folder
from ...io.truth import read_truth

_END_S, _STEP_S = 90.0, 2.0
_SAMPLES = 240  # samples of the nodes' resources over the run


def add_soak(actions: Any) -> None:
    """Add the action ``soak``."""
    parser = actions.add_parser('soak', help='play traffic to the live nodes for a long time',
                                description=__doc__)
    add = parser.add_argument
    rules = SoakRules()
    add('--minutes', type=number_in(float, 0.5, 10_000), default=60.0,
        help='least duration; whole rounds are played (default: 60)')
    add('--round-minutes', type=number_in(float, 0.1, 60), default=2.0, metavar='M',
        help='length of the traffic that is repeated (default: 2)')
    add('--vehicles', type=number_in(int, 1, 1000), default=14, metavar='N',
        help='number of vehicles of a round (default: 14)')
    add('--fps', type=number_in(float, 1, 60), default=5.0, help='pairs per second (default: 5)')
    add('--lanes', type=int, choices=(1, 2, 3), default=2)
    add('--seed', type=number_in(int, 0, 2 ** 63), default=11)
    add('--width', type=number_in(int, 640, 4096), default=1024, metavar='PX',
        help='width of the images, which are three quarters as high (default: 1024)')
    add('--one-node', action='store_true',
        help='measure with speed_camera_node with its default parameters, which hurries pairs if '
             'it does not keep up, instead of three nodes that never do')
    add('--growth-mb', type=number_in(float, 0, 1e6), default=rules.growth_mb, metavar='MB',
        help=f'greatest growth of a node after its warm-up (default: {rules.growth_mb:g})')
    add('--p95-ms', type=number_in(float, 1, 1e6), metavar='MS',
        help='greatest 95th percentile of the time from sending a pair to its live readings; '
             'without it the delay is not judged')
    add('--burn', type=number_in(int, 0, 64), default=0, metavar='N',
        help='overload the nodes: confine them to one core, together with N busy processes; '
             'skipped pairs and missed vehicles are then not judged')
    add('--out', type=Path, required=True, metavar='DIR')
    parser.set_defaults(run=run_soak)


def run_soak(args: argparse.Namespace) -> int:
    """Simulate a round, play it through the nodes repeatedly, and print the result."""
    rules = SoakRules(growth_mb=args.growth_mb, p95_ms=args.p95_ms)
    folder = prepare_folder(args.out)
    shutil.rmtree(folder / 'traffic', ignore_errors=True)
    soaked = _soak(folder, Traffic.drawn(
        folder / 'traffic', args.seed, lanes=args.lanes, fps=args.fps,
        minutes=args.round_minutes, vehicles=args.vehicles, width_px=args.width), args)
    print(soaked.table().markdown())
    print(soaked.delays_table().markdown())
    print(soaked.readings_table(rules).markdown())
    print(held_table(soaked.held, soaked.minutes).markdown())
    faults = [*soaked.faults(rules), *_log_faults(folder / 'log.sqlite', soaked)]
    for line in soaked.notes(rules):
        print(line)
    for line in faults:
        print(f'error: {line}', file=sys.stderr)
    return 1 if faults else 0


def _soak(folder: Path, traffic: Traffic, args: argparse.Namespace) -> Soaked:
    """Play the traffic round after round."""
    stamps_ns, round_ns = traffic.stamps_ns, traffic.round_ns
    played = -(-round(args.minutes * 60e9) // round_ns)
    truth = read_truth(traffic.folder / TRUTH)
    rounds = Rounds(truth, counted_vehicles(traffic.folder / TRUTH, truth), round_ns,
                    stamps_ns[0])
    for left in folder.glob('log.sqlite*'):  # with the files beside it of a killed run
        left.unlink()
    private_graph()
    from ...nodes.soak_listener import SoakListener
    samples: dict[str, list[Sample]] = {}
    with ExitStack() as stack:
        with confined(bool(args.burn)):  # the player of the traffic is not: cameras never wait
            nodes = started(stack, _nodes(folder, traffic, one=args.one_node))
        listener = SoakListener(rounds.add)
        stack.callback(listener.close)
        replay = play(stack, traffic, nodes, listener, TOLD, rounds=played,
                      wait_for='tracks' if args.one_node else 'stereo/image_pair tracks')
        burners = stack.enter_context(ExitStack())
        with confined():
            for _ in range(args.burn):
                burners.enter_context(Burner())
        begun_s, total = time.monotonic(), played * len(stamps_ns)
        step_s = max(played * round_ns * 1e-9 / _SAMPLES, _STEP_S)
        with tqdm(total=total, desc='soak', unit='pair', disable=None) as bar:
            while not replay.ended() and alive(nodes):
                for name, node in nodes.items():
                    samples.setdefault(name, []).append(
                        sample_of(node.process.pid, time.monotonic()))
                listener.spin(step_s, replay.ended)
                bar.update(len(listener.pairs_ns) - bar.n)
            minutes = (time.monotonic() - begun_s) / 60
            burners.close()
            # for messages in transit, for passes that have not ended, and for those under way
            listener.spin(_END_S, lambda: alive(nodes) and (
                len(listener.pairs_ns) + listener.skipped >= total))
            listener.spin(_STEP_S, lambda: False)
            listener.spin(_END_S, lambda: alive(nodes) and not listener.waiting)
            listener.spin(_STEP_S, lambda: False)
    return Soaked(
        minutes=minutes, pairs=lost_pairs(listener.pairs_ns, stamps_ns, round_ns, played),
        delays_s=listener.delays_s, reading_delays_s=listener.reading_delays_s,
        readings=listener.readings, rounds=rounds, played=played, skipped=listener.skipped,
        hurried=listener.hurried, overloaded=bool(args.burn),
        held=[Held.of(name, samples.get(name, ()), SoakRules()) for name in nodes])


def _nodes(folder: Path, traffic: Traffic, *, one: bool) -> list[tuple[str, ...]]:
    """Return the commands of the nodes, with one measuring node or three."""
    measuring = [(*ONE_NODE, traffic.site)] if one else [
        ('stereo_sync_node', *RELIABLE_IMAGES, *RELIABLE_INFOS), ('speed_node',),
        ('tracker_node', *RELIABLE_INFOS, traffic.site, *EVERY_PAIR)]
    return [*measuring, ('log_node', f'file:={folder / "log.sqlite"}')]


def _log_faults(path: Path, soaked: Soaked) -> Sequence[str]:
    """Return the faults of the log that ``log_node`` has written."""
    with sqlite3.connect(path) as log:
        (logged,), = log.execute("SELECT count(*) FROM passes WHERE verdict = 'measured'")
    told = len(soaked.rounds.errors_mps) + soaked.rounds.astray
    return [] if logged == told else [f'{path}: {logged} passes logged, {told} published']
