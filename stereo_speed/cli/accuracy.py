# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``accuracy``: measure simulated passes with exact truth, from picked sites, and tabulate."""
from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
import tempfile
from typing import Any, Callable, Optional

import cv2
import numpy as np
from tqdm import tqdm
import yaml

from ..config import TrackerConfig
from ..errors import InputError
from ..pipeline import SpeedPipeline
from ..records import TrackState, Verdict
from ..sim.config import circle_config, DISTORTED, SimConfig, straight_config
from ..sim.sequence import simulate
from ..site import lane_paths, load_init, load_site
from ..units import MPH_MPS

SCENES: dict[str, Callable[[], SimConfig]] = {
    'straight 55 mph': lambda: straight_config('55 mph'),
    'straight 55 mph, converging and distorted': lambda: straight_config(
        '55 mph', rig=DISTORTED),
    'circle of 41 m, 36 mph': lambda: circle_config('36 mph', 41.0),
    'circle of 41 m, 36 mph, converging and distorted': lambda: circle_config(
        '36 mph', 41.0, rig=DISTORTED),
}


@dataclass(frozen=True)
class PassError:
    """
    Errors of one simulated pass.

    :param kept: whether the vehicle was followed to its last pair.
    :param mean_mps: mean error of the confirmed readings, m/s.
    :param late_mps: greatest error of a reading of the second half, m/s.
    :param pass_mps: error of the pass, m/s; None when it was rejected.
    :param sigmas: the same in 1-sigmas of its own.
    """

    kept: bool
    mean_mps: float
    late_mps: float
    pass_mps: Optional[float]
    sigmas: float


def add_parser(subparsers: Any) -> None:
    """Add the ``accuracy`` command."""
    parser = subparsers.add_parser('accuracy', help='tabulate errors on simulated passes')
    parser.add_argument('--seeds', type=int, default=20, help='passes of each kind')
    parser.add_argument('--particles', type=int, default=TrackerConfig().particles)
    parser.add_argument('--jobs', type=int, default=2, help='processes')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all scenes and seeds and print a Markdown table."""
    for name in ('seeds', 'jobs'):
        if getattr(args, name) < 1:
            raise InputError('accuracy', f'--{name}', getattr(args, name), '1 or more')
    TrackerConfig(particles=args.particles)  # refuse before the work begins
    tasks = [(scene, seed, args.particles) for scene in SCENES for seed in range(args.seeds)]
    with ProcessPoolExecutor(args.jobs, mp_context=get_context('spawn')) as pool:
        errors = list(tqdm(pool.map(_measure, tasks), total=len(tasks), unit='pass',
                           desc='accuracy', disable=None))
    print(f'| {args.seeds} passes each, {args.particles} particles | followed to the end '
          '| readings: mean, mph | worst of second half, mph | pass: mean ± sd, mph '
          '| worst, mph | r.m.s. of error/σ |')
    print('|---|---|---|---|---|---|---|')
    for scene in SCENES:
        print(_row(scene, [e for e, task in zip(errors, tasks) if task[0] == scene]))
    return 0


def measure_pass(config: SimConfig, seed: int, particles: int) -> PassError:
    """
    Simulate one pass, write its site and marks as files, and measure it.

    :param config: the scene.
    :param seed: of the simulation and of the tracker.
    """
    sequence = simulate(config, np.random.default_rng(seed))
    with tempfile.TemporaryDirectory() as folder:
        site, init = Path(folder) / 'site.yaml', Path(folder) / 'init.yaml'
        site.write_text(yaml.safe_dump(dict(sequence.site)))
        init.write_text(yaml.safe_dump(dict(sequence.init)))
        lanes, marks = lane_paths(load_site(site), sequence.rig), load_init(init)
    pipeline = SpeedPipeline(sequence.rig, lanes, TrackerConfig(particles=particles), marks,
                             seed=seed)
    updates = [u for pair in sequence.pairs for u in pipeline.process(pair)]
    result, = pipeline.ended() + pipeline.finish()
    truth = np.array([float(row['speed']) for row in sequence.truth])[:len(updates)]
    error = np.array([u.speed_mps for u in updates]) - truth
    confirmed = np.array([u.state is TrackState.CONFIRMED for u in updates])
    measured = result.verdict is Verdict.MEASURED and result.speed_mps is not None
    off = result.speed_mps - truth[:result.pairs].mean() if measured else None
    return PassError(
        kept=result.pairs == len(sequence.pairs),
        mean_mps=float(error[confirmed].mean()) if confirmed.any() else np.nan,
        late_mps=float(np.abs(error[len(error) // 2:]).max()), pass_mps=off,
        sigmas=np.nan if off is None else off / result.speed_std_mps)


def _measure(task: tuple[str, int, int]) -> PassError:
    """Measure one pass in a worker: one thread each, the passes fill the cores."""
    cv2.setNumThreads(1)
    scene, seed, particles = task
    return measure_pass(SCENES[scene](), seed, particles)


def _row(scene: str, errors: list[PassError]) -> str:
    """One line of the table."""
    passes = np.array([e.pass_mps for e in errors if e.pass_mps is not None]) / MPH_MPS
    readings = np.mean([e.mean_mps for e in errors]) / MPH_MPS
    late = np.max([e.late_mps for e in errors]) / MPH_MPS
    kept = sum(e.kept for e in errors)
    line = f'| {scene} | {kept} of {len(errors)} | {readings:+.3f} | {late:.2f} '
    if not len(passes):
        return line + '| - | - | - |'
    z = np.sqrt(np.nanmean(np.square([e.sigmas for e in errors])))
    return line + (f'| {passes.mean():+.3f} ± {passes.std():.3f} | {np.abs(passes).max():.3f} '
                   f'| {z:.2f} |')
