# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``roads``: click and refine simulated roads of many kinds, and tabulate the errors."""
from __future__ import annotations

import argparse

from ..evaluation.roads import (
    KINDS, kinds_table, measure_road, road_figures, road_jobs, road_table)
from ...batch.job import failures
from ...batch.runner import run_jobs
from ...cli.options import add_job_options, number_in, report_failures
from ...io.atomic import write_whole


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``roads``."""
    parser.add_argument(
        '--roads', type=number_in(int, 1, 10000), default=4 * len(KINDS),
        help=f'number of roads, of {len(KINDS)} kinds in turn (default: {4 * len(KINDS)})')
    parser.add_argument('--seed', type=number_in(int, 0, 2 ** 31), default=0,
                        help='seed of the set of roads (default: 0)')
    parser.add_argument('--pan-deg', type=number_in(float, -1, 1), default=0.0, metavar='DEG',
                        help='turn of the right camera since its calibration, to either '
                             'side')
    parser.add_argument('--run-offs', action='store_true',
                        help='draw only bends whose superelevation is built up in view')
    add_job_options(parser)


def run(args: argparse.Namespace) -> int:
    """Measure the remaining roads, print the table, write the files."""
    results = run_jobs(road_jobs(args.roads, args.seed, args.pan_deg, args.run_offs), measure_road,
                       out_dir=args.out, workers=args.jobs, description='roads')
    table = road_table(results)
    if args.out is not None:
        write_whole(args.out, {'roads.md': table.markdown(), 'roads.csv': table.csv()})
    print(table.markdown())
    print(kinds_table(results).markdown())
    print(road_figures(results))
    return report_failures(failures(results))
