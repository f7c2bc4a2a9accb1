# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Tables as Markdown and as CSV."""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Callable, Mapping, Optional, Protocol, Sequence, TypeVar, Union

from ...core.units import MPH_MPS
from ...io.atomic import csv_text

Cell = Union[str, int, float, None]


@dataclass(frozen=True, kw_only=True)
class Table:
    """
    A table.

    :param title: title of the table.
    :param columns: names, with units.
    :param rows: rows with a cell for each column; None and NaN are shown as a dash.
    :param digits: decimals of each column's floats, in Markdown; CSV has five.
    :param note: a line below it.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    digits: Union[int, Sequence[int]] = 2
    note: str = ''

    def markdown(self) -> str:
        """Return the table as Markdown."""
        digits = [self.digits] * len(self.columns) if isinstance(self.digits, int) \
            else list(self.digits)
        lines = [f'**{self.title}**', ''] if self.title else []
        lines += [_line(self.columns), '|' + '---|' * len(self.columns)]
        lines += [_line([shown(cell, n) for cell, n in zip(row, digits)]) for row in self.rows]
        return '\n'.join(lines + (['', self.note] if self.note else [])) + '\n'

    def csv(self) -> str:
        """Return the table as CSV."""
        return csv_text(self.columns, [
            ['' if _missing(c) else f'{c:.5f}' if isinstance(c, float) else c for c in row]
            for row in self.rows])


class HasKinds(Protocol):
    """An item that belongs to a kind under each of several headings."""

    @property
    def kinds(self) -> Mapping[str, str]:
        """Return heading to kind."""


K = TypeVar('K', bound=HasKinds)


def table_by_kind(passes: Sequence[K], columns: Sequence[str],
                  row: Callable[[str, Sequence[K]], list[Cell]]) -> Table:
    """
    Return a table of a row for all passes, then one for each kind of them.

    :param row: makes the row from a name and some of the passes.
    """
    rows = [row('all', passes)]
    for heading in passes[0].kinds if passes else ():
        for kind in sorted({p.kinds[heading] for p in passes}):
            rows.append(row(f'{heading}: {kind}',
                            [p for p in passes if p.kinds[heading] == kind]))
    return Table(title='', columns=columns, rows=rows)


def shown(cell: Cell, digits: int) -> str:
    """Return the text of a cell in Markdown."""
    if _missing(cell):
        return '-'
    return f'{cell:.{digits}f}' if isinstance(cell, float) else str(cell)


def mph(speed_mps: Optional[float]) -> Optional[float]:
    """Return m/s in mph; None stays None."""
    return None if speed_mps is None else speed_mps / MPH_MPS


def signed(speed_mps: float, digits: int = 3) -> str:
    """Return a speed difference in mph with its sign."""
    return '-' if not math.isfinite(speed_mps) else f'{speed_mps / MPH_MPS:+.{digits}f}'


def _missing(cell: Cell) -> bool:
    return cell is None or isinstance(cell, float) and not math.isfinite(cell)


def _line(cells: Sequence[object]) -> str:
    return '| ' + ' | '.join(str(cell).replace('|', '\\|') for cell in cells) + ' |'
