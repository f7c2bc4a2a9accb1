# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Processor time and memory of the commands for many and for long bags."""
from __future__ import annotations

import csv
from dataclasses import dataclass
import os
from pathlib import Path
import subprocess
import sys
import time
from typing import Sequence

from .tables import Table
from ...core.errors import StereoSpeedError
from ...io.results import PASSES


@dataclass(frozen=True, kw_only=True)
class Cost:
    """
    The cost of a command.

    :param wall_s: elapsed time, s.
    :param cpu_s: processor time, including started processes, s.
    :param peak_mb: greatest resident memory of one process, MB.
    """

    wall_s: float
    cpu_s: float
    peak_mb: float


def cost_of(arguments: Sequence[str], log: Path) -> Cost:
    """
    Run a command of this package in a separate process.

    :param arguments: arguments of ``python -m stereo_speed``.
    :param log: file for its output.
    :raises StereoSpeedError: its exit status is not 0.
    """
    start = time.perf_counter()
    with log.open('wb') as stream:
        process = subprocess.Popen([sys.executable, '-m', 'stereo_speed', *arguments],
                                   stdin=subprocess.DEVNULL, stdout=stream,
                                   stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise StereoSpeedError(f'{arguments[0]} ended with {process.returncode}: {log}')
    return Cost(wall_s=time.perf_counter() - start, cpu_s=usage.ru_utime + usage.ru_stime,
                peak_mb=usage.ru_maxrss / 1024)


def count_passes(folder: Path) -> tuple[int, int]:
    """Return how many passes a run has, and how many of them are measured."""
    with (folder / PASSES).open(newline='', encoding='utf-8') as file:
        verdicts = [row['verdict'] for row in csv.DictReader(file)]
    return len(verdicts), verdicts.count('measured')


def long_table(rows: Sequence[tuple[int, float, int, int, Cost]]) -> Table:
    """
    Tabulate bags of growing length.

    :param rows: rounds of the sample, length in h, passes found, passes measured, and the cost.
    """
    return Table(
        title='Bags of increasing length',
        columns=['rounds', 'length, h', 'passes', 'measured', 'processor, s', 's per round',
                 'times faster than real time', 'peak memory, MB'],
        rows=[[n, hours, found, measured, cost.cpu_s, cost.cpu_s / n, 3600 * hours / cost.cpu_s,
               cost.peak_mb] for n, hours, found, measured, cost in rows],
        digits=[0, 2, 0, 0, 1, 2, 1, 0])


def many_table(rows: Sequence[tuple[int, int, Cost, Cost]]) -> Table:
    """
    Tabulate growing numbers of bags.

    :param rows: bags, passes, the cost, and that of the same command run again.
    """
    return Table(
        title='Increasing numbers of bags',
        columns=['bags', 'passes', 'processor, s', 's per bag', 'peak memory of a process, MB',
                 'processor if all is done already, s'],
        rows=[[n, passes, cost.cpu_s, cost.cpu_s / n, cost.peak_mb, again.cpu_s]
              for n, passes, cost, again in rows],
        digits=[0, 0, 1, 2, 0, 1])
