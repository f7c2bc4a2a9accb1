# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Passes in an SQLite file of ``log_node``, ``replay --sqlite`` or ``replay-many``.

The file is opened read-only and queried each time, so that new passes are seen.
"""
from __future__ import annotations

from contextlib import closing
import json
import math
from pathlib import Path
import sqlite3
from typing import Any, Optional, Sequence

from .runs import Cell, Opened, Row, Run, WANTED
from ..core.errors import InputError
from ..io.results import kind_of, PASS_COLUMNS

MOST_PASSES = 20_000  # number of newest passes that are shown
_NOT_SHOWN = ('id', 'json', 'key')
_BUSY_S = 5.0  # how long to wait for a writer that holds a lock on the file
_PASSES = 'SELECT rowid AS key, * FROM passes'
_READINGS = ('SELECT * FROM tracks WHERE stamp_ns BETWEEN ? AND ? AND vehicle = ? '
             'GROUP BY stamp_ns ORDER BY stamp_ns')  # one row per stamp if measured twice
_STATES = {True: 'confirmed', False: ''}


class PassLogRun(Run):
    """
    The passes of a file.

    :param path: path of the file.
    :param name: name shown to users.
    :raises InputError: it is no such file.
    """

    def __init__(self, path: Path, name: str) -> None:
        super().__init__(name, 'log')
        self.path = path
        self._ask('SELECT 1 FROM passes LIMIT 1')
        columns = {row['name'] for row in self._ask(
            "SELECT name FROM pragma_table_info('passes')")}
        missing = [name for name in WANTED if name not in columns]
        if missing:
            raise InputError(path, 'columns', 'no ' + ', '.join(missing), ', '.join(WANTED))
        self._has_tracks = bool(self._ask(
            "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'tracks'"))

    def overview(self) -> dict[str, Any]:
        """Return the entry for the list of runs."""
        found, = self._ask("SELECT count(*) AS passes, sum(verdict = 'measured') AS measured "
                           'FROM passes')
        return {**super().overview(), 'passes': found['passes'],
                'measured': found['measured'] or 0}

    def rows(self) -> list[Row]:
        """Return the newest passes, in the order in which they were written."""
        found = self._ask(f'{_PASSES} ORDER BY rowid DESC LIMIT {MOST_PASSES}')
        return [self._row(one) for one in reversed(found)]

    def opened(self, key: int) -> Optional[Opened]:
        """Return the details of one pass."""
        found = self._ask(f'{_PASSES} WHERE rowid = ?', (key,))
        if not found:
            return None
        row = self._row(found[0])
        more = _told(found[0]['json']) if 'json' in found[0].keys() else {}
        return Opened(self._track(row), more)

    def _track(self, row: Row) -> list[Row]:
        """Return the readings of a pass; empty where the file has none."""
        if not self._has_tracks:
            return []
        rows = self._ask(_READINGS, (row['first_ns'], row['last_ns'], f'vehicle_{row["track"]}'))
        return [{'track': row['track'], 'lane': row['lane'], 'smoothed_mps': None,
                 'state': _STATES[one['speed_mps'] is not None],
                 **{name: self._cell(name, one[name]) for name in one.keys()
                    if name != 'vehicle'}} for one in rows]

    def _row(self, one: sqlite3.Row) -> Row:
        row = {name: self._cell(name, one[name]) for name in one.keys()
               if name not in _NOT_SHOWN}
        return {'key': one['key'], **row}

    def _cell(self, name: str, value: Any) -> Cell:
        """Return a cell checked for its column's type, which SQLite does not enforce."""
        kind = kind_of(name)
        if value is None:
            return '' if kind is str and name in WANTED else None
        if kind is float and isinstance(value, (int, float)) and math.isfinite(value):
            return float(value)
        if kind is int and isinstance(value, int) or kind is str and isinstance(value, str):
            return value
        raise InputError(self.path, f'passes, {name}', repr(value)[:80],
                         'text' if kind is str else 'a number')

    def _ask(self, query: str, values: Sequence[Cell] = ()) -> list[sqlite3.Row]:
        try:
            with closing(sqlite3.connect(f'{self.path.resolve().as_uri()}?mode=ro', uri=True,
                                         timeout=_BUSY_S)) as database:
                database.row_factory = sqlite3.Row
                return database.execute(query, values).fetchall()
        except sqlite3.Error as error:
            raise InputError(self.path, 'database', error,
                             'an SQLite file with a table passes') from None


def _told(text: object) -> Row:
    """Return the values that only the JSON of a pass has, named as in ``passes.csv``."""
    try:
        data = json.loads(str(text))
        parts, profile = data.get('std_parts_mps') or {}, data.get('profile_mps') or {}
        vehicle = data.get('vehicle') or {}
        found = {**{key: vehicle[key] for key in PASS_COLUMNS if key in vehicle},
                 **{f'std_{key}_mps': value for key, value in parts.items()},
                 **{f'{key}_mps': value for key, value in profile.items()}}
    except (ValueError, AttributeError):
        return {}
    return {key: float(value) for key, value in found.items()
            if isinstance(value, (int, float)) and math.isfinite(value)}
