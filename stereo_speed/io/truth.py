# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""True speeds and positions of the vehicles of a sequence: from ``truth.csv`` or a simulation."""
from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, Mapping, Sequence, Union

import numpy as np
from numpy.typing import NDArray

from .csv_rows import CsvRow, read_rows
from ..core.errors import InputError
from ..core.records import Array

# Truth is written in whole microseconds, to which stamps may have been truncated or rounded.
SAME_NS = 2000
_LARGEST = 9e9  # s; in ns it still fits in 64 bits
_POSITION = ('x', 'y', 'z')


@dataclass(frozen=True, eq=False)
class VehicleTruth:
    """
    True speeds and positions of a vehicle.

    :param vehicle: its number.
    :param stamps_ns: (n,) ascending.
    :param speed_mps: (n,) ground speed.
    :param position_m: (n, 3) centre of its front, left optical frame; NaN where it is not known.
    """

    vehicle: int
    stamps_ns: NDArray[np.int64]
    speed_mps: Array
    position_m: Array

    def at(self, stamps_ns: Sequence[int]) -> NDArray[np.int64]:
        """Return the row index of each stamp; -1 where there is none."""
        wanted = np.asarray(stamps_ns, dtype=np.int64)
        row = np.clip(np.searchsorted(self.stamps_ns, wanted), 1, len(self.stamps_ns) - 1) \
            if len(self.stamps_ns) > 1 else np.zeros(len(wanted), dtype=np.int64)
        before = np.maximum(row - 1, 0)
        row = np.where(np.abs(self.stamps_ns[before] - wanted)
                       < np.abs(self.stamps_ns[row] - wanted), before, row)
        return np.where(np.abs(self.stamps_ns[row] - wanted) <= SAME_NS, row, -1)

    def speed_at(self, stamps_ns: Sequence[int]) -> Array:
        """Return the true speeds at stamps, m/s; NaN where they are unknown."""
        row = self.at(stamps_ns)
        return np.where(row < 0, np.nan, self.speed_mps[row])


def truth_of_rows(rows: Sequence[Mapping[str, Any]]) -> tuple[VehicleTruth, ...]:
    """
    Group rows by vehicle, in the order of the vehicles' numbers.

    :param rows: with ``stamp_ns``, ``vehicle``, ``speed`` and, where known, ``x``, ``y``, ``z``.
    """
    out = []
    for vehicle in sorted({int(row['vehicle']) for row in rows}):
        mine = sorted((row for row in rows if int(row['vehicle']) == vehicle),
                      key=lambda row: int(row['stamp_ns']))
        out.append(VehicleTruth(
            vehicle, np.array([row['stamp_ns'] for row in mine], dtype=np.int64),
            np.array([row['speed'] for row in mine], dtype=float),
            np.array([[row.get(c, np.nan) for c in _POSITION] for row in mine], dtype=float)))
    return tuple(out)


def read_truth(path: Union[str, Path]) -> tuple[VehicleTruth, ...]:
    """
    Return the content of ``truth.csv``, by vehicle.

    Columns ``stamp`` (s) and ``speed`` (m/s), and where known ``vehicle``, ``x``, ``y`` and
    ``z`` (m); others are ignored.

    :raises InputError: names the line and column at fault.
    """
    columns, rows = read_rows(path, 'truth.csv')
    for name in ('stamp', 'speed'):
        if name not in columns:
            raise InputError(path, 'columns', ','.join(columns) or 'none', f'a column {name}')
    if not rows:
        raise InputError(path, 'rows', 'none', 'a row for each vehicle and pair')
    return truth_of_rows([_row(row) for row in rows])


def _row(row: CsvRow) -> dict[str, Any]:
    """Return the values of a row."""
    def parse(name: str) -> Decimal:
        return row.number(name, 'a finite number', -_LARGEST, _LARGEST)
    known = [c for c in _POSITION if row.values.get(c)]
    return {**{c: float(parse(c)) for c in ('speed', *known)},
            'stamp_ns': int(parse('stamp') * 10 ** 9),
            'vehicle': int(parse('vehicle')) if row.values.get('vehicle') else 0}
