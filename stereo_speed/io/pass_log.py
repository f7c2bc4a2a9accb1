# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Passes and readings in an SQLite file that any tool can read while it is written.

Every pass is in the file, synced, before :meth:`PassLog.add_pass` returns: a power cut loses no
added pass, and leaves a file that opens.  The table ``passes`` has a pass's unique ``id``, the
columns of ``passes.csv`` that its JSON contains, and the JSON itself.
"""
from __future__ import annotations

from contextlib import AbstractContextManager, closing
import csv
import json
from pathlib import Path
import sqlite3
from typing import Any, Mapping, Optional, Sequence, Union

from .pass_json import FORMAT, pass_text
from ..core.errors import InputError
from ..core.passes import PassResult
from ..core.records import TrackState

_PASSES = {
    'id': 'TEXT PRIMARY KEY', 'run': 'TEXT', 'track': 'INTEGER', 'lane': 'TEXT',
    'lane_to': 'TEXT', 'direction': 'TEXT', 'first_ns': 'INTEGER', 'last_ns': 'INTEGER',
    'pairs': 'INTEGER', 'speed_mps': 'REAL', 'speed_std_mps': 'REAL', 'verdict': 'TEXT',
    'reason': 'TEXT', 'end': 'TEXT', 'second_mps': 'REAL', 'second_std_mps': 'REAL',
    'second_pairs': 'INTEGER', 'class': 'TEXT', 'class_probability': 'REAL', 'json': 'TEXT'}
_TRACKS = {
    'stamp_ns': 'INTEGER', 'vehicle': 'TEXT', 'speed_mps': 'REAL', 'speed_std_mps': 'REAL',
    'x_m': 'REAL', 'y_m': 'REAL', 'z_m': 'REAL'}
_BUSY_S = 5.0  # how long to wait for a reader that holds a lock on the file

Value = Union[str, int, float, None]


class PassLog(AbstractContextManager['PassLog']):
    """
    An SQLite file of passes and readings; a context manager.

    :param path: path of the file; an existing file is appended to.
    :param live: whether others read it meanwhile; it then uses a write-ahead log.
    :raises InputError: the file cannot be written, or is not such a database.
    """

    def __init__(self, path: Path, *, live: bool = True) -> None:
        self.path = path
        try:
            self._database = sqlite3.connect(path, timeout=_BUSY_S)
            self._database.execute(f'PRAGMA journal_mode={"WAL" if live else "DELETE"}')
            self._database.execute('PRAGMA synchronous=FULL')
            with self._database:
                for name, columns in (('passes', _PASSES), ('tracks', _TRACKS)):
                    told = ', '.join(f'"{column}" {kind}' for column, kind in columns.items())
                    self._database.execute(f'CREATE TABLE IF NOT EXISTS {name} ({told})')
                self._database.execute(
                    'CREATE INDEX IF NOT EXISTS tracks_by_stamp ON tracks (stamp_ns)')
            self._check()
        except sqlite3.Error as error:
            raise InputError(path, 'database', error, 'an SQLite file that can be written') \
                from None

    def __exit__(self, *_: object) -> None:
        """Commit what was added, and close the file."""
        self.close()

    def close(self) -> None:
        """Commit what was added, and close the file, even if the disk cannot be written."""
        with closing(self._database):
            self._database.commit()

    def _check(self) -> None:
        """Refuse a file whose tables have other columns."""
        for name, columns in (('passes', _PASSES), ('tracks', _TRACKS)):
            found = [row[1] for row in self._database.execute(f'PRAGMA table_info({name})')]
            if found != list(columns):
                raise InputError(self.path, f'table {name}', ','.join(found), ','.join(columns))

    def add_pass(self, text: str) -> bool:
        """
        Add a pass, unless it is already in the file, and sync it to disk.

        :param text: JSON of the pass, as on the topic ``passes``.
        :return: whether it was new.
        :raises InputError: the text does not describe a pass, or has values that SQLite cannot
            store.
        """
        row = _pass_row(text)
        places = ', '.join('?' * len(_PASSES))
        try:
            with self._database:
                self.keep()
                return self._database.execute(
                    f'INSERT OR IGNORE INTO passes VALUES ({places})', row  # noqa: S608
                ).rowcount == 1
        except (OverflowError, UnicodeEncodeError, sqlite3.ProgrammingError,
                sqlite3.InterfaceError, sqlite3.DataError) as error:
            raise InputError('pass', 'value', f'{type(error).__name__}: {error}',
                             'numbers of 64 bits and valid text') from None

    def add_track(self, stamp_ns: int, vehicle: str, speed_mps: Optional[float],
                  speed_std_mps: Optional[float], position_m: Sequence[float]) -> None:
        """
        Add a track's state in a pair; it is committed with the next pass, or by :meth:`keep`.

        :param vehicle: name of the track, ``vehicle_<number>``.
        :param speed_mps: speed; None where the track is not confirmed.
        :param position_m: (3,) position of its front, left optical frame.
        """
        self._database.execute(
            f'INSERT INTO tracks VALUES ({", ".join("?" * len(_TRACKS))})',  # noqa: S608
            (stamp_ns, vehicle, speed_mps, speed_std_mps, *map(float, position_m)))

    def keep(self) -> bool:
        """Commit what was added to disk; return whether there was anything."""
        some = self._database.in_transaction
        self._database.commit()
        return some


def _pass_row(text: str) -> list[Value]:
    """Return the row of a pass."""
    try:
        data: Mapping[str, Any] = json.loads(text)
        if data['stereo_speed_pass'] != FORMAT:
            raise InputError('pass', 'stereo_speed_pass', data['stereo_speed_pass'], str(FORMAT))
        second, vehicle = data['second'] or {}, data['vehicle'] or {}
        known = {
            **{name: data[name] for name in _PASSES if name in data},
            'first_ns': data['first_stamp_ns'], 'last_ns': data['last_stamp_ns'],
            'second_mps': second.get('speed_mps'),
            'second_std_mps': second.get('speed_std_mps'), 'second_pairs': second.get('pairs'),
            'class': vehicle.get('class'), 'class_probability': vehicle.get('probability'),
            'json': text}
        return [known[name] for name in _PASSES]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError('pass', 'JSON', f'{type(error).__name__}: {error}',
                         'a pass as pass.schema.json describes it') from None


def write_pass_log(path: Path, run: str, tracks: Path, passes: Sequence[PassResult]) -> None:
    """
    Write passes and readings of a finished run; the same run gives the same bytes.

    :param path: path of a new file.
    :param run: name of the run, for the ids of its passes.
    :param tracks: ``tracks.csv`` of the run, which has all readings of a run of any length.
    :raises InputError: the file cannot be written.
    """
    try:
        with PassLog(path, live=False) as log, tracks.open(newline='', encoding='utf-8') as file:
            for row in csv.DictReader(file):
                measured = row['state'] == TrackState.CONFIRMED.value
                speed, std = (float(row[key]) if measured and row[key] else None
                              for key in ('speed_mps', 'speed_std_mps'))
                log.add_track(int(row['stamp_ns']), f'vehicle_{row["track"]}', speed, std,
                              [float(row[axis] or 'nan') for axis in ('x_m', 'y_m', 'z_m')])
            for one in sorted(passes, key=lambda p: p.track):
                log.add_pass(pass_text(run, one))
    except sqlite3.Error as error:
        raise InputError(path, 'database', error, 'a disk that can be written') from None
