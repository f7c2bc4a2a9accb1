# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``bench``: time the measurement on one core, in comparison with peers, and its growth.

In the end traffic is played to live nodes, to measure latency and throughput.
"""
from __future__ import annotations

import argparse
from pathlib import Path
import statistics
import time
from typing import Callable, Optional

import cv2

from .bench_live import live_lines
from .bench_monocular import HEIGHT, rows, WIDTH
from ..evaluation.benchmarks import (
    decode_table, filter_table, follower_table, kernel_table, likelihood_table, SCALES, Scene,
    sgbm, size_table, vehicle_table)
from ..evaluation.tables import Table
from ...cli.options import number_in
from ...core.compiled import kernels, warm_up
from ...core.tracker_config import TrackerConfig
from ...io.bags import StereoBag
from ...pipeline.assembly import MeasuringSite
from ...pipeline.config import PipelineConfig
from ...report.comparison import growth_plot
from ...site.file import load_site
from ...site.init_file import load_init

_SAMPLE = Path(__file__).resolve().parents[3] / 'sample' / 'straight55'
_LIVE_S = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``bench``."""
    parser.add_argument('sample', nargs='?', type=Path, default=_SAMPLE,
                        help='folder with bag/, site.yaml and init.yaml (default: the sample)')
    parser.add_argument('--particles', type=int, nargs='+', default=[200, 400])
    parser.add_argument('--rounds', type=int, default=5,
                        help='number of runs of each, interleaved')
    parser.add_argument('--live', type=number_in(float, 0, 3600), default=_LIVE_S, metavar='S',
                        help='seconds of traffic played to live nodes at the end, which take some '
                             f'20 MB each on disk; 0 for none (default: {_LIVE_S:g})')
    parser.add_argument('--plot', type=Path, metavar='PNG', help='write a plot of the cost')


def run(args: argparse.Namespace) -> int:
    """Time the candidates in turns, so that other load affects all alike; print medians."""
    cv2.setNumThreads(1)
    warm_up()
    with StereoBag(args.sample / 'bag') as bag:
        rig, pairs = bag.rig, list(bag.pairs())
    place = MeasuringSite.of(load_site(args.sample / 'site.yaml'), rig)
    annotations = load_init(args.sample / 'init.yaml')

    def tracker(particles: int) -> Callable[[], list[float]]:
        def once() -> list[float]:
            config = PipelineConfig(TrackerConfig(particles=particles))
            pipeline = place.pipeline(config, annotations)
            return [_milliseconds(pipeline.process, pair) for pair in pairs]
        return once

    matcher = sgbm()

    def matched() -> list[float]:
        return [_milliseconds(matcher.compute, pair.left, pair.right) for pair in pairs[:4]]

    candidates = {f'constrained, {n} particles': tracker(n) for n in args.particles}
    candidates['cv2.StereoSGBM, 64 disparities'] = matched
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(args.rounds):
        for name, once in candidates.items():
            times[name] += once()
    height, width = pairs[0].left.shape
    print(f'ms per pair of {width}x{height}, one core, {args.rounds} interleaved rounds')
    _print(times)
    print(f'ms of CPU per target and frame of {WIDTH}x{HEIGHT}, one core, interleaved rounds')
    _print(rows(args.rounds))
    _tabulate(Scene(rig, place, pairs, annotations), args.rounds, args.plot)
    if args.live:
        print('\nin real time, each node in a process of its own:\n', flush=True)
        print(live_lines(args.live), end='')
    return 0


def _tabulate(scene: Scene, rounds: int, plot: Optional[Path]) -> None:
    """Print the tables, and plot the growth of the cost on request."""
    print(f'ms of CPU on one core, medians of {rounds} rounds; kernels: {warm_up()}')
    particles, vehicles = likelihood_table(rounds), vehicle_table(scene, rounds)
    sizes = size_table(scene, rounds)
    tables = [particles, filter_table(rounds), vehicles, follower_table(scene, rounds), sizes,
              decode_table(scene, rounds)]
    if kernels().compiled:
        tables.insert(0, kernel_table(rounds))
    for table in tables:
        print()
        print(table.markdown(), end='')
    if plot is not None:
        growth_plot(plot, {
            'particles (likelihood)': _curve(particles), 'tracks (per pair)': _curve(vehicles),
            'share of the width (per pair)': list(zip(
                SCALES, (float(str(row[1])) for row in sizes.rows)))},
            'particles, tracks, share of 1024 px')


def _curve(table: Table) -> list[tuple[float, float]]:
    return [(float(str(row[0])), float(str(row[1]))) for row in table.rows]


def _print(times: dict[str, list[float]]) -> None:
    print(f'{"":36}{"median":>8}{"least":>8}{"most":>8}')
    for name, values in times.items():
        print(f'{name:36}{statistics.median(values):8.2f}{min(values):8.2f}{max(values):8.2f}')


def _milliseconds(function: Callable[..., object], *args: object) -> float:
    start = time.perf_counter()
    function(*args)
    return (time.perf_counter() - start) * 1e3
