# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of trackers: a row for each tracker, its parameters and the vehicle."""
from __future__ import annotations

from dataclasses import replace
from typing import Sequence

from .experiments import Experiment, Runs
from .metrics import pass_figures, reading_figures, ReadingFigures
from .tables import Cell, mph, Table

COLUMNS = ('tracker', 'truth, mph', 'mean, mph', 'max error, mph', 'sd, mph', 'r.m.s., mph',
           'last reading max, mph', 'pass max, mph', 'passes measured', 'lost', 'ms per pair')
DIGITS = (0, 2, 2, 3, 3, 3, 3, 3, 0, 0, 1)


def whole_figures(experiment: Experiment, seeds: Sequence[int], vehicle: int,
                  runs: Runs) -> ReadingFigures:
    """Return the figures of a vehicle's readings; runs that failed count as lost."""
    found = runs.vehicle(experiment, seeds, vehicle)
    f = reading_figures(found)
    return replace(f, runs=len(seeds), lost=f.lost + len(seeds) - len(found))


def comparison_row(label: str, experiment: Experiment, seeds: Sequence[int], vehicle: int,
                   runs: Runs) -> list[Cell]:
    """
    Return a row under ``COLUMNS``.

    :param label: label of the row.
    :param vehicle: number of the vehicle.
    """
    f = whole_figures(experiment, seeds, vehicle, runs)
    final = pass_figures(runs.vehicle(experiment, seeds, vehicle))
    return [label, mph(f.truth_mps), mph(f.mean_mps), mph(f.max_error_mps), mph(f.std_mps),
            mph(f.rms_mps), mph(f.final_max_error_mps), mph(final.max_mps),
            f'{final.measured}/{f.runs}', f'{f.lost}/{f.runs}', runs.cpu_ms(experiment, seeds)]


def comparison_table(experiments: Sequence[Experiment], seeds: Sequence[int],
                     runs: Runs) -> Table:
    """
    Return a row for each experiment and vehicle.

    :param experiments: experiments on one source.
    """
    several = len({e.changes.get('particles') for e in experiments}) > 1
    rows: list[list[Cell]] = []
    vehicles = sorted({v for e in experiments for v in runs.vehicles(e, seeds)})
    for vehicle in vehicles or [0]:
        for e in experiments:
            label = e.tracker + (f', N = {e.changes["particles"]}' if several else '')
            label += f' (vehicle {vehicle})' if len(vehicles) > 1 else ''
            rows.append(comparison_row(label, e, seeds, vehicle, runs))
    return Table(title=experiments[0].source.name if experiments else '', columns=COLUMNS,
                 rows=rows, digits=DIGITS)
