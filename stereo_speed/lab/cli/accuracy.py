# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``accuracy``: measure simulated passes of many kinds, and tabulate the errors."""
from __future__ import annotations

import argparse
from typing import Optional, Sequence

import numpy as np

from ..evaluation.accuracy import (
    accuracy_jobs, accuracy_table, classes_told, gather, measure_job, passes_table, rejections,
    silently_wrong)
from ..evaluation.labeled_sequence import LineKnowledge
from ..evaluation.outdoors import check_held
from ..sim.ride import ROUGHNESS_M3
from ...batch.job import failures
from ...batch.runner import run_jobs
from ...cli.options import add_job_options, number_in, report_failures
from ...core.errors import InputError
from ...core.tracker_config import TrackerConfig
from ...io.atomic import write_whole


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``accuracy``."""
    add = parser.add_argument
    add('--passes', type=number_in(int, 1, 100000), default=200,
        help='number of passes, over speeds, roads, rigs, heights and noise (default: 200)')
    add('--seed', type=number_in(int, 0, 2 ** 31), default=0,
        help='seed of the set of passes (default: 0)')
    add('--particles', type=int, default=TrackerConfig().particles)
    lines = parser.add_mutually_exclusive_group()
    lines.add_argument('--lines', choices=[k.value for k in LineKnowledge], default='refined',
                       help='source of the lines of the site (default: refined)')
    lines.add_argument('--picked', action='store_const', const='picked', dest='lines',
                       help='same as --lines picked: picks with 0.3 px of scatter')
    lines.add_argument('--refine', action='store_const', const='refined', dest='lines',
                       help='same as --lines refined: picks refined by the images of the pass')
    add('--pan-deg', type=number_in(float, -1, 1), default=0.0, metavar='DEG',
        help='turn of the right camera since its calibration, to either side')
    add('--sway-deg', type=number_in(float, 0, 1), default=0.0, metavar='DEG',
        help='sway of the rig: 1-sigma of each of its angles, independent in each pair')
    add('--tolerances', action='store_true',
        help='vary calibration and stamps within the tolerances that the tracker allows for')
    add('--outdoors', nargs='*', metavar='HEADING=KIND',
        help='bodies with depth, lamps that clip, sun, wet nights and faults of cameras, instead '
             'of painted fronts; HEADING=KIND fixes one, such as vehicle=bus or fault=none')
    add('--braking', action='store_true',
        help='every vehicle brakes at 2 to 8 m/s^2, or accelerates at 1 to 3, from some moment in '
             'view; else speeds are constant')
    add('--ride', choices=sorted(ROUGHNESS_M3),
        help='class of the road (ISO 8608) over which vehicles move on their springs; motorcycles '
             'lean into bends (default: level with the road)')
    add('--detect', action='store_true', help='detect the vehicles instead of annotating them')
    add_job_options(parser)


def run(args: argparse.Namespace) -> int:
    """Measure the remaining passes, print the table, write the files."""
    TrackerConfig(particles=args.particles)  # checks the number before the work begins
    jobs = accuracy_jobs(args.passes, seed=args.seed, lines=LineKnowledge(args.lines),
                         pan_deg=args.pan_deg, tolerances=args.tolerances, sway_deg=args.sway_deg,
                         changes={'particles': args.particles}, outdoors=held_kinds(args.outdoors),
                         detect=args.detect, braking=args.braking, ride=args.ride)
    results = run_jobs(jobs, measure_job, out_dir=args.out, workers=args.jobs,
                       description='accuracy')
    passes = gather(jobs, results)
    table = accuracy_table(passes)
    if args.out is not None:
        write_whole(args.out, {'accuracy.md': table.markdown(), 'accuracy.csv': table.csv(),
                               'passes.csv': passes_table(passes).csv()})
    print(table.markdown())
    reasons = ', '.join(f'{n} {reason}' for reason, n in rejections(passes).items())
    print(f'lines {args.lines}, {args.particles} particles; not measured: {reasons or "none"}; '
          f'measured, more than 0.1 mph and 2 σ off: {silently_wrong(passes)}; '
          f'{np.nanmedian([p.cpu_ms for p in passes]):.1f} ms of one core per pair')
    if args.outdoors is not None:
        told = ', '.join(f'{n} {word}' for word, n in classes_told(passes).items())
        print(f'classes of vehicles: {told}')
    return report_failures(failures(results))


def held_kinds(words: Optional[Sequence[str]]) -> Optional[dict[str, str]]:
    """
    Return the fixed kinds of ``--outdoors``, heading to kind; None without the option.

    :raises InputError: a word of another form, or an unknown heading or kind.
    """
    if words is None:
        return None
    held = {}
    for word in words:
        heading, equals, kind = word.partition('=')
        if not equals:
            raise InputError('accuracy', '--outdoors', word, 'HEADING=KIND')
        held[heading] = kind
    check_held(held)
    return held
