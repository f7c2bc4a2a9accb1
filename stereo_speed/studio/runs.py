# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Runs to review: folders written by ``replay``, and runs that were measured on the page."""
from __future__ import annotations

import csv
from dataclasses import dataclass, field
import io
import json
import math
from pathlib import Path
from typing import Any, Mapping, Optional, Sequence, Union

from ..core.errors import InputError
from ..core.passes import PassResult
from ..core.records import TrackUpdate
from ..io.atomic import csv_text
from ..io.results import (
    kind_of, PASS_COLUMNS, PASSES, passes_csv, PLOTS, SUMMARY, TRACK_COLUMNS, TRACKS, tracks_csv)

WANTED = PASS_COLUMNS[:9]  # columns that every table of passes has
MOST_BYTES = 512 * 2**20  # largest accepted table
FORMULA = ('=', '+', '-', '@', '\t', '\r')  # first characters of a spreadsheet formula

Cell = Union[str, int, float, None]
Row = dict[str, Cell]


@dataclass(frozen=True)
class Opened:
    """
    The details of one pass.

    :param rows: rows of its pairs, by time, with the known columns of ``tracks.csv``.
    :param more: values beyond those of its row.
    """

    rows: Sequence[Row]
    more: Row = field(default_factory=dict)


class Run:
    """
    Passes that are reviewed together, from any source.

    :param name: name shown to users.
    :param kind: ``folder``, ``measured``, ``log`` or ``evidence``.
    """

    def __init__(self, name: str, kind: str) -> None:
        self.name, self.kind = name, kind

    @property
    def bag_hash(self) -> str:
        """Return the hash of the measured bag; empty where it is unknown."""
        return ''

    @property
    def plots(self) -> list[str]:
        """Return the names of its plots."""
        return []

    def overview(self) -> dict[str, Any]:
        """Return the entry for the list of runs."""
        return {'name': self.name, 'kind': self.kind}

    def rows(self) -> list[Row]:
        """Return its passes, each with a permanent ``key``; may be slow."""
        raise NotImplementedError

    def opened(self, key: int) -> Optional[Opened]:
        """Return the details of one pass; None for an unknown key."""
        raise NotImplementedError

    def at(self, stamp_ns: int) -> list[Row]:
        """Return the known rows of all vehicles in one pair."""
        return []

    def plot(self, name: str) -> Optional[Path]:
        """Return the path of a plot; None for an unknown name."""
        return None

    def table(self, keys: Sequence[int]) -> str:
        """
        Return some of its passes as CSV, in the order of the keys.

        :raises InputError: an unknown key.
        """
        by_key = {row['key']: row for row in self.rows()}
        missing = [key for key in keys if key not in by_key]
        if missing:
            raise InputError('page', 'keys', missing[0], 'keys of passes of this run')
        columns = [name for name in next(iter(by_key.values()), {}) if name != 'key']
        return csv_text(columns, [[as_cell(by_key[key][name]) for name in columns]
                                  for key in keys])


class RunFolder(Run):
    """
    A run that ``replay`` has written, or that was measured on the page.

    :param name: name of the folder or of the run.
    :param passes: text of its ``passes.csv``.
    :param tracks: text of its ``tracks.csv``.
    :param summary: content of its ``summary.json``.
    :param folder: folder of its plots; None for a run without a folder.
    """

    def __init__(self, name: str, passes: str, tracks: str, summary: Mapping[str, Any],
                 folder: Optional[Path] = None) -> None:
        super().__init__(name, 'measured' if folder is None else 'folder')
        self.folder, self.summary = folder, dict(summary)
        self.passes = read_table(passes, f'{name}/{PASSES}', WANTED)
        self._texts = list(csv.reader(io.StringIO(passes, newline='')))
        self._by_track: dict[int, list[Row]] = {}
        self._by_stamp: dict[int, list[Row]] = {}
        for row in read_table(tracks, f'{name}/{TRACKS}', TRACK_COLUMNS):
            self._by_track.setdefault(_whole(row['track']), []).append(row)
            self._by_stamp.setdefault(_whole(row['stamp_ns']), []).append(row)

    @classmethod
    def read(cls, folder: Path, name: str) -> RunFolder:
        """
        Read a finished folder of ``replay``.

        :raises InputError: it is no such folder, or damaged.
        """
        texts = {}
        for file in (SUMMARY, PASSES, TRACKS):
            path = folder / file
            if not path.is_file():
                raise InputError(folder, file, 'no such file', 'a folder that replay has written')
            if path.stat().st_size > MOST_BYTES:
                raise InputError(path, 'file', f'{path.stat().st_size} bytes',
                                 f'at most {MOST_BYTES}')
            try:
                texts[file] = path.read_text(encoding='utf-8')
            except UnicodeDecodeError as error:
                raise InputError(path, 'file', str(error), 'text in UTF-8') from None
        try:
            summary = json.loads(texts[SUMMARY])
        except ValueError as error:
            raise InputError(folder / SUMMARY, 'file', str(error), 'JSON') from None
        if not isinstance(summary, dict):
            raise InputError(folder / SUMMARY, 'file', type(summary).__name__, 'a JSON object')
        return cls(name, texts[PASSES], texts[TRACKS], summary, folder)

    @classmethod
    def measured(cls, name: str, updates: Sequence[TrackUpdate], passes: Sequence[PassResult],
                 summary: Mapping[str, Any]) -> RunFolder:
        """Return a run of newly measured passes."""
        return cls(name, passes_csv(passes), tracks_csv(updates, passes), summary)

    @property
    def plots(self) -> list[str]:
        """Return the names of the existing plots."""
        if self.folder is None:
            return []
        return [name for name in PLOTS if (self.folder / name).is_file()]

    def plot(self, name: str) -> Optional[Path]:
        """Return the path of a plot; None for an unknown name."""
        return self.folder / name if self.folder is not None and name in self.plots else None

    @property
    def bag_hash(self) -> str:
        """Return the hash of the measured bag; empty where it is unknown."""
        given = self.summary.get('input')
        value = given.get('bag_sha256') if isinstance(given, dict) else None
        return value if isinstance(value, str) else ''

    def rows(self) -> list[Row]:
        """Return its passes; the key of each is its index in the table."""
        return [{'key': key, **row} for key, row in enumerate(self.passes)]

    def opened(self, key: int) -> Optional[Opened]:
        """Return the details of one pass."""
        if key >= len(self.passes):
            return None
        return Opened(self._by_track.get(_whole(self.passes[key]['track']), []))

    def at(self, stamp_ns: int) -> list[Row]:
        """Return the rows of all vehicles in one pair."""
        return self._by_stamp.get(stamp_ns, [])

    def table(self, keys: Sequence[int]) -> str:
        """Return some of its passes with the digits of the original file."""
        head, *texts = self._texts
        missing = [key for key in keys if not 0 <= key < len(texts)]
        if missing:
            raise InputError('page', 'keys', missing[0], 'keys of passes of this run')
        known = [name in PASS_COLUMNS and kind_of(name) is not str for name in head]
        return csv_text(head, [[text if number else as_cell(text) for number, text in
                                zip(known, texts[key])] for key in keys])

    def overview(self) -> dict[str, Any]:
        """Return the entry for the list of runs."""
        return {**super().overview(), 'passes': len(self.passes),
                'measured': sum(row['verdict'] == 'measured' for row in self.passes)}


def as_cell(value: Cell) -> Cell:
    """Return a cell that a spreadsheet does not take for a formula."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value


def read_table(text: str, where: str, wanted: Sequence[str]) -> list[Row]:
    """
    Read a table with at least some columns.

    :raises InputError: names the line and the column at fault.
    """
    reader = csv.DictReader(io.StringIO(text, newline=''))
    missing = [name for name in wanted if name not in (reader.fieldnames or ())]
    if missing:
        raise InputError(where, 'columns', 'no ' + ', '.join(missing), ', '.join(wanted))
    rows = []
    for number, raw in enumerate(reader, 2):
        if None in raw or None in raw.values():
            raise InputError(where, f'line {number}', 'another number of cells',
                             f'{len(reader.fieldnames or ())}')
        rows.append({key: _cell(key, value, where, number) for key, value in raw.items()})
    return rows


def _cell(column: str, text: str, where: str, line: int) -> Cell:
    """Read one cell; cells of unknown columns are numbers if possible, else text."""
    known = column in PASS_COLUMNS or column in TRACK_COLUMNS
    kind = kind_of(column) if known else float
    if kind is str:
        return text
    if text == '':
        return None
    try:
        if kind is int:
            return int(text)
        value = float(text)
    except ValueError:
        if known:
            raise InputError(where, f'line {line}, {column}', repr(text), 'a number') from None
        return text
    return value if math.isfinite(value) else None


def _whole(value: Cell) -> int:
    """Return a cell whose column holds whole numbers."""
    assert isinstance(value, int)  # noqa: S101 (for the types)
    return value
