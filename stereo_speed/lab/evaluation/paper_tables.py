# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reproduce the tables of the 2012 paper, with the paper's figures in each row."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Iterator, Optional, Sequence

import numpy as np

from .comparison import COLUMNS, comparison_row, DIGITS, whole_figures
from .experiments import Experiment, Runs, sequence_experiment
from .labeled_sequence import LineKnowledge
from .metrics import pass_figures, reading_figures
from .paper import COMPARED, FINDINGS, LEAST_SPEEDUP, PaperRow, PaperTable, TABLES
from .paper_sequences import find_sequence
from .tables import Cell, mph, Table
from ...core.units import MPH_MPS

OURS = 'constrained'
# Number of particles from which our errors have to be half of the paper's.
_HALF_FROM = 200
# Number of particles at which the paper's time has to be beaten.
_TIMED = 400


@dataclass(frozen=True, kw_only=True)
class PaperPlan:
    """
    The runs that reproduce the paper.

    :param tables: the tables.
    :param compared: sequences of the comparison.
    :param trackers: trackers of the comparison.
    :param lines: source of the lines of the sites.
    :param table_seeds: runs of each cell of the tables.
    :param compare_seeds: runs of each tracker and sequence.
    """

    tables: tuple[PaperTable, ...] = TABLES
    compared: tuple[str, ...] = COMPARED
    trackers: tuple[str, ...] = (OURS,)
    lines: LineKnowledge = LineKnowledge.REFINED
    table_seeds: range = range(20)
    compare_seeds: range = range(10)

    def quick(self) -> PaperPlan:
        """Return a plan with two rows of each table, one sequence and one seed."""
        tables = tuple(replace(t, rows=(t.rows[0], t.rows[len(t.rows) // 2])) for t in self.tables)
        return replace(self, tables=tables, compared=self.compared[:1], table_seeds=range(1),
                       compare_seeds=range(1))

    def cell(self, table: PaperTable, row: PaperRow) -> Experiment:
        """Return the experiment of a row of a table."""
        varied: dict[str, Any] = {}
        if table.particles is None:
            varied['particles'] = int(row.value)
        if table.parts is None:
            varied['parts'] = int(row.value)
        if table.step_mps is None:
            varied['step_mps'] = row.value
        return sequence_experiment(table.sequence, OURS, lines=self.lines, **{
            'particles': table.particles, 'parts': table.parts, 'step_mps': table.step_mps,
            **varied})

    def contest(self, sequence: str, tracker: str) -> Experiment:
        """Return the experiment of a row of the comparison."""
        return sequence_experiment(sequence, tracker, lines=self.lines)

    def cells(self) -> list[tuple[Experiment, int]]:
        """Return the runs of the tables: experiments with a seed."""
        return [(self.cell(table, row), seed) for table in self.tables for row in table.rows
                for seed in self.table_seeds]

    def contests(self) -> list[tuple[Experiment, int]]:
        """Return the runs of the comparison: experiments with a seed."""
        return [(self.contest(s, t), seed) for s in self.compared for t in self.trackers
                for seed in self.compare_seeds]


def paper_table(plan: PaperPlan, table: PaperTable, runs: Runs) -> Table:
    """Return a table with our figures beside the paper's."""
    rows: list[list[Cell]] = []
    for row in table.rows:
        cell = plan.cell(table, row)
        mine = runs.vehicle(cell, plan.table_seeds, 0)
        f, final = reading_figures(mine), pass_figures(mine)
        rows.append([f'{row.value:g}', row.speed_mph, mph(f.final_mean_mps), row.max_error_mph,
                     mph(f.final_max_error_mps), mph(f.max_error_mps), mph(f.rms_mps),
                     mph(final.max_mps), f'{final.measured}/{len(plan.table_seeds)}',
                     *([row.ms, runs.cpu_ms(cell, plan.table_seeds)] if row.ms else [])])
    columns = [table.varies, 'mean speed, mph: paper', 'ours', 'max error, mph: paper',
               'ours, last reading', 'ours, every reading', 'ours, r.m.s.', 'ours, pass max',
               'measured']
    columns += ['ms per pair: paper', 'ours'] if table.rows[0].ms else []
    fixed = [f'N = {table.particles}' if table.particles else '',
             f'N_p = {table.parts}' if table.parts else '',
             f'{table.step_mps:g} m/s per frame' if table.step_mps else '']
    title = (f'{table.name}: {find_sequence(table.sequence).title}, '
             + ', '.join(part for part in fixed if part))
    return Table(title=title, columns=columns, rows=rows,
                 digits=[0, 2, 2, 3, 3, 3, 3, 3, 0, 1, 1][:len(columns)])


def contest_table(plan: PaperPlan, sequence: str, runs: Runs) -> Table:
    """Return the trackers on a sequence, by vehicle, with the paper's findings."""
    paper = find_sequence(sequence)
    rows: list[list[Cell]] = []
    for vehicle, name in enumerate(paper.vehicles):
        for tracker in plan.trackers:
            label = f'{tracker} ({name})' if name else tracker
            rows.append([*comparison_row(label, plan.contest(sequence, tracker),
                                         plan.compare_seeds, vehicle, runs),
                         None if vehicle else FINDINGS.get((sequence, tracker))])
    title = f'{paper.title}: {paper.particles} particles, {paper.speed_step_mps:g} m/s per frame'
    return Table(title=title, columns=(*COLUMNS, 'the paper'), rows=rows, digits=[*DIGITS, 0])


@dataclass(frozen=True)
class Check:
    """
    A claim and whether it holds.

    :param claim: text of the claim.
    :param holds: whether it holds.
    :param detail: the figures.
    """

    claim: str
    holds: bool
    detail: str


def checks(plan: PaperPlan, runs: Runs) -> list[Check]:
    """Return the checks of our figures against the paper's."""
    found = [check for table in plan.tables for row in table.rows
             for check in _cell_checks(plan, table, row, runs)]
    return found + [check for s in plan.compared for check in _contest_checks(plan, s, runs)]


def _cell_checks(plan: PaperPlan, table: PaperTable, row: PaperRow,
                 runs: Runs) -> Iterator[Check]:
    """Check that errors are at most the paper's, or half of them with enough particles."""
    cell = plan.cell(table, row)
    mine = runs.vehicle(cell, plan.table_seeds, 0)
    f = reading_figures(mine)
    share = 0.5 if cell.changes['particles'] >= _HALF_FROM else 1.0
    most, found = share * row.max_error_mph, (mph(f.final_max_error_mps) or 0.0)
    whole = len(mine) == len(plan.table_seeds) and not f.lost
    yield Check(
        f'{table.name}, {row.value:g}: maximum error at most {share:g} of that of the paper',
        whole and found <= most, f'{found:.3f} of {most:.3f} mph, {len(mine) - f.lost} runs')
    if row.ms and cell.changes['particles'] == _TIMED:
        ms = runs.cpu_ms(cell, plan.table_seeds)
        yield Check(f'{table.name}, {row.value:g}: {LEAST_SPEEDUP:g} times shorter per pair',
                    ms * LEAST_SPEEDUP <= row.ms, f'{ms:.1f} ms of {row.ms / LEAST_SPEEDUP:.1f}')


def _contest_checks(plan: PaperPlan, sequence: str, runs: Runs) -> Iterator[Check]:
    """Check that our tracker has a smaller maximum error than each of the others."""
    if OURS not in plan.trackers:
        return
    for vehicle, name in enumerate(find_sequence(sequence).vehicles):
        worst = {t: _worst_mph(plan, sequence, t, vehicle, runs) for t in plan.trackers}
        for other in (t for t in plan.trackers if t != OURS):
            where = f'{sequence}, {name}' if name else sequence
            yield Check(f'{where}: {OURS} has a smaller maximum error than {other}',
                        worst[OURS] < worst[other],
                        f'{_shown(worst[OURS])} against {_shown(worst[other])}')


def _worst_mph(plan: PaperPlan, sequence: str, tracker: str, vehicle: int, runs: Runs) -> float:
    """Return the maximum error, mph; infinite when a run lost the vehicle."""
    f = whole_figures(plan.contest(sequence, tracker), plan.compare_seeds, vehicle, runs)
    return float('inf') if f.lost or not np.isfinite(f.max_error_mps) \
        else f.max_error_mps / MPH_MPS


def _shown(worst_mph: Optional[float]) -> str:
    return 'lost' if worst_mph is None or not np.isfinite(worst_mph) else f'{worst_mph:.3f} mph'


def checks_text(found: Sequence[Check]) -> str:
    """Return the checks as Markdown."""
    lines = [f'- {"yes" if c.holds else "**NO**"}: {c.claim} ({c.detail})' for c in found]
    return '\n'.join(lines) + '\n'
