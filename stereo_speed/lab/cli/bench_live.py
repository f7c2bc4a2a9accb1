# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Latency and throughput of live speeds: real processes over DDS, in comparison with peers.

Simulated traffic is played in real time to the measuring node; then to a node that only pairs the
images and answers, which takes the round-trip time; and to one that computes dense stereo for each
pair. All are timed by the same listener, from the clock message that is sent before a pair.
"""
from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Callable, Sequence, TYPE_CHECKING, TypeVar

import numpy as np

from .live_graph import (
    alive, GraphError, ON_ITS_WAY_S, ONE_NODE, play, processor_s, started, TOLD, Traffic)
from ..evaluation.tables import Cell, Table
from ...cli.demo import private_graph, Process
from ...core.errors import StereoSpeedError

if TYPE_CHECKING:
    from ...nodes.delay_listener import AnswerListener
    from ...nodes.soak_listener import SoakListener

Listener = TypeVar('Listener', 'SoakListener', 'AnswerListener')
_LANES, _VEHICLES_PER_S, _SEED = 3, 0.8, 11  # up to four in view, as in a ten-minute soak
_FPS, _WIDTH_PX = 30.0, 1280
_PEER = 'pairing_peer_node'
_SLACK_S = 60.0


def live_lines(seconds: float) -> str:
    """Return the table for some seconds of traffic as Markdown, or one line why there is none."""
    try:
        with TemporaryDirectory(prefix='stereo_speed_bench_') as folder:
            return live_table(Traffic.drawn(
                Path(folder) / 'traffic', _SEED, lanes=_LANES, fps=_FPS, minutes=seconds / 60,
                width_px=_WIDTH_PX, vehicles=max(round(seconds * _VEHICLES_PER_S), 1))).markdown()
    except ImportError as error:
        return f'live over DDS: not measured, {error.name} is not installed\n'
    except (StereoSpeedError, RuntimeError) as error:  # rclpy raises RuntimeError
        return f'live over DDS: not measured, {" ".join(str(error).split())}\n'


def live_table(traffic: Traffic) -> Table:
    """
    Play traffic to each candidate in turn, and tabulate the times.

    :raises ImportError: rclpy is not installed.
    :raises StereoSpeedError: a node ended, or the nodes do not discover each other.
    :raises RuntimeError: rclpy cannot be started.
    """
    private_graph()
    from ...nodes.delay_listener import AnswerListener
    from ...nodes.soak_listener import SoakListener
    passes: list[object] = []

    def ours() -> SoakListener:
        return SoakListener(lambda told, *_: passes.append(told))
    one, one_ms = _timed(traffic, (*ONE_NODE, traffic.site), TOLD, ours, wait_for='tracks')
    matched, matched_ms = _timed(traffic, (_PEER, 'matching:=sgbm'), ('/answers',),
                                 AnswerListener)
    paired, paired_ms = _timed(traffic, (_PEER,), ('/answers',), AnswerListener)
    count = len(traffic.stamps_ns)

    def row(node: str, tells: str, told: int, delays_s: Sequence[float], cpu_ms: float
            ) -> list[Cell]:
        median_ms, late_ms = 1e3 * np.percentile(delays_s or [np.nan], [50, 95])
        return [node, tells, told * traffic.fps / count, float(median_ms), float(late_ms), cpu_ms]
    return Table(
        title=f'Live over DDS: {count} pairs, {traffic.fps:g} a second',
        columns=('node', 'output', 'pairs a second', 'p50, ms', 'p95, ms',
                 'CPU per pair, ms'),
        rows=[row('speed_camera_node', f'{len(one.reading_delays_s)} readings, {len(passes)} '
                  'passes', len(one.pairs_ns), one.reading_delays_s, one_ms),
              row('the same', 'all tracks of a pair', len(one.pairs_ns), one.delays_s, one_ms),
              row('a pairing node with StereoSGBM, 3 ways', 'an answer per matched pair',
                  len(matched.pairs_ns), matched.delays_s, matched_ms),
              row('a pairing node', 'an answer per pair', len(paired.pairs_ns), paired.delays_s,
                  paired_ms)],
        digits=(0, 0, 1, 1, 1, 1))


def _timed(traffic: Traffic, command: Sequence[str], told: Sequence[str],
           listen: Callable[[], Listener], wait_for: str = '') -> tuple[Listener, float]:
    """
    Play the traffic to one node.

    :param told: topics that it publishes.
    :param wait_for: topics that have to be connected.
    :return: the listener, and the processor time of the node and its helpers per accepted pair,
        ms.
    """
    with ExitStack() as stack:
        nodes = started(stack, [command])
        listener = listen()
        stack.callback(listener.close)
        replay = play(stack, traffic, nodes, listener, told, wait_for=wait_for)
        node, before = nodes[command[0]], len(listener.pairs_ns)
        begun_s = _taken_s(node)
        listener.spin(traffic.round_ns * 1e-9 + _SLACK_S,
                      lambda: alive(nodes) and replay.ended())
        listener.spin(ON_ITS_WAY_S, lambda: alive(nodes) and False)
        took_s, pairs = _taken_s(node) - begun_s, len(listener.pairs_ns) - before
    return listener, 1e3 * took_s / max(pairs, 1)


def _taken_s(node: Process) -> float:
    """
    Return the processor time used by a node and its helpers, s.

    :raises GraphError: it has ended.
    """
    try:
        return processor_s(node.process.pid)
    except ProcessLookupError:
        raise GraphError(f'live: {node.name}: found its process gone, wanted it running'
                         ) from None
