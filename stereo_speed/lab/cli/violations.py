# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``violations``: apply every fault to dense simulated traffic, and check records against the truth.

The faults are those of cameras, transport and clocks; for each pass it is decided whether there
would be a record. Exit status 1 if one is wrong.
"""
from __future__ import annotations

import argparse

from ..evaluation.violations import (
    gather_violations, violation_job, violation_jobs, violations_table)
from ..sim.stream_faults import FAULTS
from ...batch.job import failures
from ...batch.runner import run_jobs
from ...cli.options import add_job_options, number_in, report_failures
from ...io.atomic import write_whole

WRONG = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``violations``."""
    add = parser.add_argument
    add('--streams', type=number_in(int, 1, 10 ** 6), default=110,
        help='number of streams of half a minute with some 20 passes each, with the faults in '
             'turn (default: 110)')
    add('--seed', type=number_in(int, 0, 2 ** 31), default=0,
        help='seed of the traffic (default: 0)')
    add('--fps', type=number_in(float, 0.5, 60), default=8.0, help='pairs per second (default: 8)')
    add('--fault', action='append', choices=list(FAULTS), metavar='NAME',
        help='run only the streams with this fault; may be given several times: '
        + ', '.join(FAULTS))
    add_job_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the remaining streams, print the table, write the files."""
    jobs = [job for job in violation_jobs(args.streams, args.seed, list(FAULTS), fps=args.fps)
            if not args.fault or job.parameters['fault'] in args.fault]
    results = run_jobs(jobs, violation_job, out_dir=args.out, workers=args.jobs,
                       description='violations')
    runs = gather_violations(results)
    table = violations_table(runs)
    if args.out is not None:
        write_whole(args.out, {'violations.md': table.markdown(), 'violations.csv': table.csv()})
    print(table.markdown())
    wrong = [f'{run.fault}: {line}' for run in runs for line in run.details]
    for line in wrong:
        print(f'wrong: {line}')
    return max(report_failures(failures(results)), WRONG if wrong else 0)
