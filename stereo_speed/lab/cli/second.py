# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``second``: estimate simulated passes twice, and tabulate the agreement of the estimates."""
from __future__ import annotations

import argparse

from .accuracy import held_kinds
from ..evaluation.accuracy import accuracy_jobs
from ..evaluation.labeled_sequence import LineKnowledge
from ..evaluation.second import (
    gather_second, second_job, second_rows, second_table, wrong_firsts)
from ...batch.job import failures, Job
from ...batch.runner import run_jobs
from ...cli.options import add_job_options, number_in, report_failures
from ...io.atomic import write_whole


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``second``."""
    add = parser.add_argument
    add('--passes', type=number_in(int, 1, 100000), default=200,
        help='number of passes, drawn as by accuracy (default: 200)')
    add('--seed', type=number_in(int, 0, 2 ** 31), default=0,
        help='seed of the set of passes (default: 0)')
    add('--lines', choices=[k.value for k in LineKnowledge], default='refined',
        help='how the lines of the site are known (default: refined)')
    add('--outdoors', nargs='*', metavar='HEADING=KIND',
        help='as for accuracy: bodies with depth, lamps that clip, sun, wet nights and faults of '
             'cameras, instead of painted fronts')
    add('--wrong-percent', type=number_in(float, 0.1, 50), default=5.0, metavar='PERCENT',
        help='error given to first estimates, in either direction (default: 5)')
    add_job_options(parser)


def run(args: argparse.Namespace) -> int:
    """Estimate the remaining passes, print the table, write the files."""
    share = args.wrong_percent / 100
    jobs = [Job(key=job.key, parameters={**job.parameters, 'wrong_shares': [-share, share]})
            for job in accuracy_jobs(
                args.passes, seed=args.seed, lines=LineKnowledge(args.lines), pan_deg=0.0,
                tolerances=False, changes={}, outdoors=held_kinds(args.outdoors))]
    results = run_jobs(jobs, second_job, out_dir=args.out, workers=args.jobs,
                       description='second')
    passes = gather_second(jobs, results)
    table = second_table(passes)
    if args.out is not None:
        write_whole(args.out, {'second.md': table.markdown(), 'second.csv': table.csv(),
                               'passes.csv': second_rows(passes).csv()})
    print(table.markdown())
    wrong, rejected = wrong_firsts(passes)
    print(f'lines {args.lines}; first estimates made wrong by {args.wrong_percent:g} % in either '
          f'direction; first estimates wrong without that: {wrong}, {rejected} of them rejected')
    return report_failures(failures(results))
