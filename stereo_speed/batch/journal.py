# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The journal of a run: a line of JSON for each finished job, which survives a crash."""
from __future__ import annotations

from contextlib import AbstractContextManager
import json
from pathlib import Path
from typing import Any, Mapping, Optional, TextIO, Union

from ..io.atomic import prepare_folder
from ..io.exclusive import open_alone

JOURNAL = 'runs.jsonl'


class Journal(AbstractContextManager['Journal']):
    """
    Keeps the finished jobs; one process at a time may write it.

    :param out_dir: folder, made where it is missing; None keeps nothing.
    :raises InputError: the folder cannot be written, or another run is writing to it.
    """

    def __init__(self, out_dir: Union[str, Path, None]) -> None:
        self._file: Optional[TextIO] = None
        if out_dir is None:
            return
        self.path = prepare_folder(out_dir) / JOURNAL
        self._file = open_alone(self.path, 'journal')

    def __exit__(self, *_: object) -> None:
        """Close the file, which releases the lock."""
        if self._file is not None:
            self._file.close()

    def rows(self) -> dict[str, dict[str, Any]]:
        """Return the last row of each key; a line truncated by a crash is ignored."""
        found: dict[str, dict[str, Any]] = {}
        if self._file is None:
            return found
        self._file.seek(0)
        for line in self._file:
            try:
                row = json.loads(line)
                found[row['key']] = row
            except (ValueError, KeyError, TypeError):
                continue
        return found

    def append(self, row: Mapping[str, Any]) -> None:
        """Append a row as one line."""
        if self._file is None:
            return
        text = json.dumps(row, sort_keys=True) + '\n'
        # Start a new line if a crash truncated the last one.
        end = self._file.seek(0, 2)
        self._file.write(text if not end or self._ends_line() else '\n' + text)
        self._file.flush()

    def _ends_line(self) -> bool:
        with self.path.open('rb') as file:
            file.seek(-1, 2)
            return file.read(1) == b'\n'
