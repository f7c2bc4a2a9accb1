# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Read passes from folders of runs and SQLite files, and reference speeds from CSV."""
from __future__ import annotations

from decimal import Decimal
import json
import math
from pathlib import Path
import sqlite3
from typing import Mapping, Optional, Sequence

from .csv_rows import CsvRow, read_rows
from .results import PASSES, SUMMARY
from ..core.errors import InputError
from ..survey.reference import ReferenceSpeed
from ..survey.traffic import Vehicle

DATABASES = ('.sqlite', '.db')
_WANTED = ('lane', 'first_ns', 'last_ns', 'speed_mps', 'speed_std_mps', 'verdict', 'reason')
_REFERENCE = ('time_ns', 'lane', 'speed_mps', 'std_mps')
_FASTEST_MPS = 150.0


def read_vehicles(places: Sequence[Path]) -> list[Vehicle]:
    """
    Return the passes of runs, in the order of the places and their rows.

    :param places: folders of runs, folders that hold folders of runs, or SQLite files with a
        table ``passes``.
    :raises InputError: a place without passes, or an unusable table.
    """
    out: list[Vehicle] = []
    for place in places:
        if place.suffix in DATABASES and place.is_file():
            out += _of_database(place)
            continue
        folders = [place] if (place / PASSES).is_file() else sorted(
            path.parent for path in place.glob(f'*/{PASSES}'))
        if not folders:
            raise InputError(place, 'passes', 'none', f'a folder with {PASSES}, or with folders '
                             f'that have it, or a file {" or ".join(DATABASES)}')
        for folder in folders:
            out += _of_folder(folder)
    return out


def _of_folder(folder: Path) -> list[Vehicle]:
    columns, rows = read_rows(folder / PASSES, PASSES)
    _check(folder / PASSES, columns, _WANTED)
    limits = _limits(folder / SUMMARY)
    return [_vehicle(row, limits) for row in rows]


def _of_database(path: Path) -> list[Vehicle]:
    """Return the passes of a database whose table has the columns of ``passes.csv``."""
    try:
        database = sqlite3.connect(f'{path.resolve().as_uri()}?mode=ro', uri=True)
        try:
            cursor = database.execute('SELECT * FROM passes ORDER BY first_ns, track')
            columns = tuple(str(one[0]) for one in cursor.description)
            _check(path, columns, _WANTED)
            return [_vehicle(CsvRow(path, f'row {number}', {
                name: '' if value is None else str(value) for name, value in zip(columns, row)}),
                {}) for number, row in enumerate(cursor, 1)]
        finally:
            database.close()
    except sqlite3.Error as error:
        raise InputError(path, 'database', error, 'an SQLite file with a table passes') from None


def _check(path: Path, columns: Sequence[str], wanted: Sequence[str]) -> None:
    missing = [name for name in wanted if name not in columns]
    if missing:
        raise InputError(path, 'columns', ','.join(columns) or 'none',
                         'columns including ' + ','.join(missing))


def _limits(path: Path) -> Mapping[str, Optional[float]]:
    """Return the speed limits of the lanes in a run's summary, m/s."""
    try:
        lanes = json.loads(path.read_text(encoding='utf-8'))['lanes']
        return {name: None if lane.get('speed_limit_mps') is None
                else float(lane['speed_limit_mps']) for name, lane in lanes.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(path, 'lanes', f'{type(error).__name__}: {error}',
                         'the summary of a finished run') from None


def _vehicle(row: CsvRow, limits: Mapping[str, Optional[float]]) -> Vehicle:
    measured, limit = row.values['verdict'] == 'measured', row.values.get('limit_mps')
    return Vehicle(
        first_ns=int(_stamp(row, 'first_ns')), last_ns=int(_stamp(row, 'last_ns')),
        lane=row.values['lane'], direction=row.values.get('direction', ''),
        kind=row.values.get('class', ''), reason=row.values['reason'],
        speed_mps=_speed(row, 'speed_mps') if measured else None,
        speed_std_mps=_speed(row, 'speed_std_mps') if measured else None,
        limit_mps=_speed(row, 'limit_mps') if limit else limits.get(row.values['lane']))


def _stamp(row: CsvRow, name: str) -> Decimal:
    return row.number(name, 'a whole number of ns', 0, 2.0 ** 63, step=1)


def _speed(row: CsvRow, name: str) -> float:
    return float(row.number(name, f'm/s in [0, {_FASTEST_MPS:g}]', 0, _FASTEST_MPS))


def read_references(path: Path) -> list[ReferenceSpeed]:
    """
    Return the vehicles of a reference, from a CSV file with ``time_ns,lane,speed_mps,std_mps``.

    :raises InputError: names the line and column at fault.
    """
    columns, rows = read_rows(path, 'CSV file of a reference')
    _check(path, columns, _REFERENCE)
    if not rows:
        raise InputError(path, 'rows', 'none', 'a row for each vehicle')
    out = []
    for row in rows:
        if not row.values['lane']:
            raise InputError(path, f'{row.line}, lane', "''", 'the name of a lane')
        speed, std = _speed(row, 'speed_mps'), _speed(row, 'std_mps')
        if not (speed > 0 and std > 0 and math.isfinite(std)):
            raise InputError(path, row.line, f'speed_mps {speed:g}, std_mps {std:g}',
                             'both more than 0')
        out.append(ReferenceSpeed(time_ns=int(_stamp(row, 'time_ns')), lane=row.values['lane'],
                                  speed_mps=speed, std_mps=std))
    return out
