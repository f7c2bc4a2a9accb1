# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The journal of a run: a line of JSON for each finished job, kept through a crash."""
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
    Keeps what is done; one process at a time.

    :param out_dir: folder, made when it is not there; None keeps nothing.
    :raises InputError: a folder that cannot be written, or that another run is writing.
    """

    def __init__(self, out_dir: Union[str, Path, None]) -> None:
        self._file: Optional[TextIO] = None
        if out_dir is None:
            return
        self.path = prepare_folder(out_dir) / JOURNAL
        self._file = open_alone(self.path, 'journal')

    def __exit__(self, *_: object) -> None:
        """Close the file and with it the lock."""
        if self._file is not None:
            self._file.close()

    def rows(self) -> dict[str, dict[str, Any]]:
        """Return the last row of each key; a line cut off by a crash is ignored."""
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
        """Write a row, whole, in one step."""
        if self._file is None:
            return
        text = json.dumps(row, sort_keys=True) + '\n'
        # Ends a line that a crash has cut off.
        end = self._file.seek(0, 2)
        self._file.write(text if not end or self._ends_line() else '\n' + text)
        self._file.flush()

    def _ends_line(self) -> bool:
        with self.path.open('rb') as file:
            file.seek(-1, 2)
            return file.read(1) == b'\n'
