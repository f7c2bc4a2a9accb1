# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``evaluate --video``: the monocular tracker against truth, with and without the map."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Sequence

from ..evaluation.monocular import (
    plan_jobs, run_scene, scores_of, Setting, summary_table, survival_rate, target_table,
    VideoScene)
from ...batch.job import failures, Result
from ...batch.runner import run_jobs
from ...cli.options import number_in, report_failures
from ...core.errors import InputError
from ...io.atomic import prepare_folder, write_whole
from ...monocular.config import MonocularConfig
from ...monocular.tracker import TRACKERS

_PARTICLES = {'environment': (150,), 'plain': (150, 300)}  # as in the paper
_STRIDES = (1, 2, 3)
_SEEDS = 25  # gives standard errors of a few per cent


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for videos to those of ``evaluate``."""
    group = parser.add_argument_group(
        'videos of one camera', '--init gives the targets and --truth their boxes in the '
        'MOTChallenge format; --seeds and --particles as above')
    group.add_argument('--video', type=Path, help='video file, folder of images, or bag')
    group.add_argument('--map', type=Path, metavar='PNG', help='map of the scene')
    group.add_argument('--strides', type=number_in(int, 1, 1000), nargs='+', metavar='K',
                       default=list(_STRIDES), help='strides (default: 1 2 3)')
    group.add_argument('--likelihood', choices=('default', 'paper'), default='default',
                       help='paper: one histogram of the marked box')


def run(args: argparse.Namespace) -> int:
    """Compare the trackers on one video; write and print the tables, and draw the plot."""
    for option in ('map', 'init', 'truth', 'out'):
        if getattr(args, option) is None:
            raise InputError('evaluate --video', f'--{option}', 'nothing', {
                'map': 'the map of the scene', 'init': 'the targets file',
                'truth': 'boxes in the MOTChallenge format',
                'out': 'a folder for the results'}[option])
    if getattr(args, 'trackers', None) or getattr(args, 'bags', None):
        raise InputError('evaluate --video', '--trackers or BAG', 'given',
                         'neither: environment and plain are compared on the video')
    scene = VideoScene(video=str(args.video), map=str(args.map), init=str(args.init),
                       truth=str(args.truth))
    settings = make_settings(args)
    config = MonocularConfig()
    if args.likelihood == 'paper':
        config = config.with_paper_likelihood()
    folder = prepare_folder(args.out)
    jobs = plan_jobs(scene, settings, args.seeds or _SEEDS, config)
    results = run_jobs(jobs, run_scene, out_dir=folder, workers=args.jobs,
                       description='evaluate --video')
    _write(folder, args.video.stem, settings, results)
    return report_failures(failures(results))


def make_settings(args: argparse.Namespace) -> list[Setting]:
    """Return every tracker with its numbers of particles and every stride."""
    settings = []
    for tracker in TRACKERS:
        for particles in args.particles or _PARTICLES[tracker]:
            MonocularConfig(particles=particles)  # checks the number before the work begins
            settings += [Setting(tracker=tracker, particles=particles, stride=stride)
                         for stride in dict.fromkeys(args.strides)]
    return settings


def _write(folder: Path, name: str, settings: Sequence[Setting],
           results: Sequence[Result]) -> None:
    """Write and print the tables, and draw the plot."""
    tables = {'settings': summary_table(f'{name}: targets kept', settings, results),
              'targets': target_table(f'{name}: each target', settings, results)}
    text = '\n'.join(table.markdown() for table in tables.values())
    write_whole(folder, {'evaluation.md': text,
                         **{f'{kind}.csv': table.csv() for kind, table in tables.items()}})
    _draw(folder / 'kept.png', name, settings, results)
    print(tables['settings'].markdown())
    print(f'results in {folder}')


def _draw(path: Path, name: str, settings: Sequence[Setting],
          results: Sequence[Result]) -> None:
    # imported here, so that matplotlib is loaded only if needed
    from ...report.comparison import draw_survival, SurvivalCurve

    curves = []
    for label in dict.fromkeys(s.label for s in settings):
        mine = [i for i, s in enumerate(settings) if s.label == label]
        rates = [survival_rate(scores_of(results, i)) for i in mine]
        curves.append(SurvivalCurve(name=label, strides=[settings[i].stride for i in mine],
                                    shares=[share for share, _ in rates],
                                    errors=[error for _, error in rates]))
    draw_survival(path, name, curves)
