# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``fuzz``: give damaged files to all readers, which may do nothing but refuse in one line."""
from __future__ import annotations

import argparse
from pathlib import Path

from .fuzz_cases import BATCH, fuzz_table, work
from ...batch.job import failures, Job
from ...batch.runner import run_jobs
from ...cli.options import add_job_options, number_in, report_failures


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``fuzz``."""
    parser.add_argument('--cases', type=number_in(int, 1, 10 ** 8), default=2000, metavar='N',
                        help='number of cases (default: 2000)')
    parser.add_argument('--first', type=number_in(int, 0, 10 ** 9), default=0, metavar='K',
                        help='number of the first case, as in the line of a fault')
    parser.add_argument('--seed', type=number_in(int, 0, 2 ** 32), default=0)
    add_job_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the cases in expendable processes, print the table and every fault."""
    last = args.first + args.cases
    jobs = [Job(key=f'cases {first} to {min(first + BATCH, last) - 1}', parameters={
        'seed': args.seed, 'first': first, 'count': min(BATCH, last - first)})
        for first in range(args.first, last, BATCH)]
    out: Path | None = args.out
    results = run_jobs(jobs, work, out_dir=out, workers=args.jobs, description='fuzz')
    values = [result.value for result in results if result.value is not None]
    print(fuzz_table(values).markdown())
    return report_failures([*failures(results), *(f for v in values for f in v['faults'])])
