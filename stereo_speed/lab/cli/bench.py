# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Time the tracker per pair beside ``cv2.StereoSGBM`` on the same pairs, on one core."""
from __future__ import annotations

import argparse
from pathlib import Path
import statistics
import time
from typing import Callable

import cv2

from .bench_monocular import HEIGHT, rows, WIDTH
from ...cli.options import Subparsers
from ...core.config import TrackerConfig
from ...io.bags import StereoBag
from ...pipeline.assembly import MeasuringSite
from ...pipeline.config import PipelineConfig
from ...site.file import load_site
from ...site.init_file import load_init

_SAMPLE = Path(__file__).resolve().parents[3] / 'sample' / 'straight55'


def add_parser(subparsers: Subparsers) -> None:
    """Add the ``bench`` command."""
    parser = subparsers.add_parser('bench', help='time the tracker beside cv2.StereoSGBM')
    parser.add_argument('sample', nargs='?', type=Path, default=_SAMPLE,
                        help='folder with bag/, site.yaml and init.yaml (default: the sample)')
    parser.add_argument('--particles', type=int, nargs='+', default=[200, 400])
    parser.add_argument('--rounds', type=int, default=5, help='times each is run, interleaved')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Interleave the candidates, so that a busy machine disturbs all alike; print medians."""
    cv2.setNumThreads(1)
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

    matcher = cv2.StereoSGBM.create(minDisparity=0, numDisparities=64, blockSize=5)

    def sgbm() -> list[float]:
        return [_milliseconds(matcher.compute, pair.left, pair.right) for pair in pairs[:4]]

    candidates = {f'constrained, {n} particles': tracker(n) for n in args.particles}
    candidates['cv2.StereoSGBM, 64 disparities'] = sgbm
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(args.rounds):
        for name, once in candidates.items():
            times[name] += once()
    height, width = pairs[0].left.shape
    print(f'ms per pair of {width}x{height}, one core, {args.rounds} interleaved rounds')
    _print(times)
    print(f'ms of CPU per target and frame of {WIDTH}x{HEIGHT}, the same way')
    _print(rows(args.rounds))
    return 0


def _print(times: dict[str, list[float]]) -> None:
    print(f'{"":36}{"median":>8}{"least":>8}{"most":>8}')
    for name, values in times.items():
        print(f'{name:36}{statistics.median(values):8.2f}{min(values):8.2f}{max(values):8.2f}')


def _milliseconds(function: Callable[..., object], *args: object) -> float:
    start = time.perf_counter()
    function(*args)
    return (time.perf_counter() - start) * 1e3
