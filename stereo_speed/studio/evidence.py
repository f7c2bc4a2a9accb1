# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Records of violations under review: their figures, their files, and their verification.

A record's content is not trusted: its files are looked up by their index in its own list, only
below its own folder, and its faults are shown beside its content.
"""
from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
import re
from typing import Any, Optional

from .runs import Cell, Opened, Row, Run
from ..enforcement.schema import schema_fault
from ..enforcement.verify import CHAIN_FILE, HEAD_FILE, RECORD_FILE, SEAL_FILE, verify

COLUMNS = ('number', 'first_ns', 'lane', 'speed_mps', 'speed_std_mps', 'limit_mps', 'measured',
           'considered', 'limit', 'unit')  # columns of a row, beside the record's name
MOST_BYTES = 64 * 2**20  # largest accepted JSON of a record
_TYPES = {'.jpg': 'image/jpeg', '.png': 'image/png'}  # shown on a page; others are downloads


@dataclass(frozen=True)
class RecordFile:
    """
    A file of a record.

    :param path: path of the file.
    :param media_type: its MIME type.
    :param shown: whether a page may show it; otherwise it is a download.
    """

    path: Path
    media_type: str
    shown: bool


class EvidenceRun(Run):
    """
    A folder of records, or one record.

    :param folder: folder of all records with their chain, or of one record.
    :param name: name shown to users.
    """

    def __init__(self, folder: Path, name: str) -> None:
        super().__init__(name, 'evidence')
        self.folder = folder
        self._names: list[str] = []  # names of records, in the order they were first seen
        self._read: dict[str, tuple[tuple[int, int], Optional[dict[str, Any]]]] = {}

    @staticmethod
    def is_one(folder: Path) -> bool:
        """Return whether a folder contains records, or is one."""
        names = (CHAIN_FILE, HEAD_FILE, RECORD_FILE, SEAL_FILE)
        return any((folder / name).is_file() for name in names)

    def overview(self) -> dict[str, Any]:
        """Return the entry for the list of runs."""
        return {**super().overview(), 'passes': len(self._found()), 'measured': None}

    def rows(self) -> list[Row]:
        """Return a row for each record; an unreadable one has only its name."""
        return [_row(key, name, self._record(name)) for key, name in enumerate(self._found())]

    def opened(self, key: int) -> Optional[Opened]:
        """Return the profile of one record."""
        if key >= len(self._names):
            return None
        record = self._record(self._names[key])
        if record is None:
            return Opened([], {'unreadable': f'{RECORD_FILE} is no record'})
        return Opened(_profile(record), _more(record))

    def files(self, key: int) -> list[str]:
        """Return the names of the files that one record lists, in a fixed order."""
        record = self._record(self._names[key]) if key < len(self._names) else None
        return [] if record is None else sorted(record['files'])

    def file(self, key: int, index: int) -> Optional[RecordFile]:
        """Return a file by its index in the list; None if missing or outside the folder."""
        names = self.files(key)
        if index >= len(names):
            return None
        folder = self._place(self._names[key]).resolve()
        path = (folder / names[index]).resolve()
        if not path.is_relative_to(folder) or not path.is_file():
            return None
        kind = _TYPES.get(path.suffix)
        return RecordFile(path, kind or 'application/octet-stream', kind is not None)

    def verified(self) -> dict[str, Any]:
        """
        Verify all records; slow, because all files are read.

        :return: ``faults`` and ``notes``, lines; ``records``, their number; ``keys`` of the
            signers; and ``of``, the faults of each record by its key.
        """
        found = verify(self.folder)
        names = {name: key for key, name in enumerate(self._found())}
        return {'faults': found.faults, 'notes': found.notes, 'records': found.records,
                'keys': sorted(found.keys), 'of': {
                    str(key): own for name, key in names.items() if (own := [
                        line for line in found.faults if _is_about(line, name)])}}

    def _found(self) -> list[str]:
        """Return the names of all records seen so far, new ones last."""
        if (self.folder / RECORD_FILE).is_file():
            return self._names or self._add([self.folder.resolve().name])
        there = sorted(path.name for path in self.folder.iterdir()
                       if not path.is_symlink() and (path / RECORD_FILE).is_file())
        return self._add([name for name in there if name not in self._names])

    def _add(self, names: list[str]) -> list[str]:
        self._names += names
        return self._names

    def _place(self, name: str) -> Path:
        """Return the folder of a record."""
        return self.folder if (self.folder / RECORD_FILE).is_file() else self.folder / name

    def _record(self, name: str) -> Optional[dict[str, Any]]:
        """Return the content of a record; None where it is unreadable or invalid."""
        path = self._place(name) / RECORD_FILE
        try:
            stat = path.stat()
        except OSError:
            return None
        state, (known, record) = (stat.st_mtime_ns, stat.st_size), self._read.get(
            name, ((-1, -1), None))
        if known != state:
            record = _parsed(path) if stat.st_size <= MOST_BYTES else None
            self._read[name] = state, record
        return record


def _parsed(path: Path) -> Optional[dict[str, Any]]:
    """Return the content of a record; None where it is unreadable or invalid."""
    try:
        record = json.loads(path.read_bytes().decode('utf-8'))
    except (OSError, ValueError, RecursionError):
        return None
    return None if schema_fault(record) else record


def _is_about(line: str, name: str) -> bool:
    """Return whether a line mentions a record."""
    return re.search(rf'(?<![\w-]){re.escape(name)}(?![\w-])', line) is not None


def _row(key: int, name: str, record: Optional[dict[str, Any]]) -> Row:
    known: Row = {}
    if record is not None:
        speed = record['speed']
        known = {'number': record['number'], 'first_ns': record['time']['first_stamp_ns'],
                 'lane': record['place']['lane'], 'speed_mps': speed['measured_mps'],
                 'speed_std_mps': speed['measured_std_mps'], 'limit_mps': speed['limit_mps'],
                 **{name: speed[name] for name in ('measured', 'considered', 'limit', 'unit')}}
    return {'key': key, 'id': name, **dict.fromkeys(COLUMNS), **known}


def _profile(record: dict[str, Any]) -> list[Row]:
    return [{'stamp_ns': one['stamp_ns'], 'state': one['state'], 'speed_mps': one['live_mps'],
             'speed_std_mps': one['live_std_mps'], 'smoothed_mps': one['smoothed_mps']}
            for one in record['speed']['profile']]


def _more(record: dict[str, Any]) -> Row:
    """Return the main figures of a record, beyond those of its row."""
    speed, place, instrument = record['speed'], record['place'], record['instrument']
    out: Row = {f'std_{key}': value for key, value in (speed['std_parts_mps'] or {}).items()}
    second = speed['second'] or {}
    out.update(second_mps=second.get('speed_mps'), second_std_mps=second.get('speed_std_mps'),
               tolerance_mps=speed['tolerance_mps'], margin_mps=speed['margin_mps'])
    words: dict[str, Cell] = {
        'first_utc': record['time']['first_utc'], 'last_utc': record['time']['last_utc'],
        'clock': record['time']['source'],
        'site': place['site'], 'place': place['place'], 'direction': record['direction'],
        'instrument': instrument['name'], 'approved': instrument['approved'],
        'run': record['run'], 'vehicle': record['track']}
    return {**out, **words}
