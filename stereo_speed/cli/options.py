# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Options that several commands share."""
from __future__ import annotations

import argparse
import os
from pathlib import Path
import sys
from typing import Callable, Sequence, TypeVar

from ..core.units import SPEED_UNITS

Number = TypeVar('Number', int, float)


def number_in(kind: type[Number], low: float, high: float) -> Callable[[str], Number]:
    """Return a function that parses a number and checks its bounds."""
    def parse(text: str) -> Number:
        value = kind(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f'{text} is not in [{low:g}, {high:g}]')
        return value
    parse.__name__ = kind.__name__
    return parse


def add_job_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of commands that run many jobs."""
    parser.add_argument('--jobs', type=number_in(int, 0, 512), default=os.cpu_count() or 1,
                        help='number of processes (default: one per core; 0: only this one)')
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='folder for the results; an interrupted run is resumed there')


def add_units_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for the unit that speeds are shown in."""
    parser.add_argument('--units', choices=SPEED_UNITS, default='mph',
                        help='unit of displayed speeds (default: mph); data files are in '
                             'm/s')


def report_failures(failed: Sequence[str]) -> int:
    """
    Print the jobs that failed, and return the exit status.

    :param failed: one line per failed job.
    """
    for line in failed:
        print(f'failed: {line}', file=sys.stderr)
    return 1 if failed else 0
