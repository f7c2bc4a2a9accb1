# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Draw the plots of an evaluation from its runs."""
from __future__ import annotations

from pathlib import Path
from typing import Callable, Sequence

import numpy as np

from .experiments import Experiment, Runs
from .metrics import reading_figures, ReadingFigures, readings
from .paper import PaperTable
from .paper_tables import PaperPlan
from .scorer import VehicleRun
from ...core.units import MPH_MPS
from ...report.comparison import ErrorCurve, errors_figure, Readings, speeds_figure
from ...report.plots import png_of


def draw_speeds(path: Path, title: str, experiments: Sequence[Experiment], seed: int,
                runs: Runs) -> None:
    """
    Draw the speed over time of one run of each tracker, and the truth.

    :param path: path of the file to write.
    :param experiments: experiments on one source, one for each tracker.
    """
    found = {e.tracker: [run for done in runs.of(e, [seed]) for run in done.vehicles]
             for e in experiments}
    stamps = [run.stamps_ns[0] for many in found.values() for run in many if run.stamps_ns]
    if not stamps:
        return
    origin_ns = min(stamps)
    longest: dict[int, VehicleRun] = {}
    for run in (run for many in found.values() for run in many):
        if len(run.stamps_ns) > len(longest.get(run.vehicle, VehicleRun(vehicle=-1)).stamps_ns):
            longest[run.vehicle] = run
    path.write_bytes(png_of(speeds_figure(
        title, {name: [_live(run, origin_ns) for run in many] for name, many in found.items()},
        [_true(run, origin_ns) for run in longest.values()])))


def _live(run: VehicleRun, origin_ns: int) -> Readings:
    """Return the confirmed readings of a run."""
    times = [(ns - origin_ns) * 1e-9 for ns, sure, true in zip(
        run.stamps_ns, run.confirmed, run.truth_mps) if sure and true is not None]
    return Readings(times_s=np.array(times), speeds_mps=readings(run)[0])


def _true(run: VehicleRun, origin_ns: int) -> Readings:
    """Return the truth at the stamps of a run."""
    rows = [((ns - origin_ns) * 1e-9, true) for ns, true in zip(run.stamps_ns, run.truth_mps)
            if true is not None]
    values = np.array(rows, dtype=float).reshape(-1, 2)
    return Readings(times_s=values[:, 0], speeds_mps=values[:, 1])


def draw_errors(path: Path, title: str, what: str, curves: Sequence[ErrorCurve]) -> None:
    """Draw errors over the varied quantity."""
    path.write_bytes(png_of(errors_figure(title, what, curves)))


def paper_curves(plan: PaperPlan, table: PaperTable, runs: Runs) -> list[ErrorCurve]:
    """Return the errors of a table, the paper's and ours."""
    values = [row.value for row in table.rows]
    figures = [reading_figures(runs.vehicle(plan.cell(table, row), plan.table_seeds, 0))
               for row in table.rows]
    return [
        ErrorCurve(name=f'{table.name}, the paper: maximum', values=values, dashed=True,
                   errors_mph=[row.max_error_mph for row in table.rows]),
        ErrorCurve(name=f'{table.name}, ours: maximum', values=values,
                   errors_mph=[f.final_max_error_mps / MPH_MPS for f in figures])]


def particle_curves(experiments: Sequence[Experiment], seeds: Sequence[int], runs: Runs,
                    error: Callable[[ReadingFigures], float]) -> list[ErrorCurve]:
    """
    Return the errors of experiments that vary the number of particles.

    :param error: selects an error of the figures, m/s.
    """
    curves = []
    for tracker in dict.fromkeys(e.tracker for e in experiments):
        mine = sorted((e for e in experiments if e.tracker == tracker),
                      key=lambda e: int(e.changes['particles']))
        figures = [reading_figures([run for v in runs.vehicles(e, seeds)
                                    for run in runs.vehicle(e, seeds, v)]) for e in mine]
        curves.append(ErrorCurve(name=tracker, values=[e.changes['particles'] for e in mine],
                                 errors_mph=[error(f) / MPH_MPS for f in figures]))
    return curves
