# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Write ``tracks.csv`` during the run, so that hours of traffic fit in memory.

A row contains the smoothed speed, so it is final only when the pass of its track has been
measured. The file is ordered by stamp, so final rows wait for those of tracks that began earlier.
"""
from __future__ import annotations

from contextlib import AbstractContextManager
import heapq
from pathlib import Path
import shutil
import tempfile
from typing import Collection, Sequence

from .atomic import csv_text, PathLike, prepare_folder
from .results import TRACK_COLUMNS, track_row
from ..core.passes import PassResult
from ..core.records import TrackUpdate


class TrackRows(AbstractContextManager['TrackRows']):
    """
    The rows of ``tracks.csv``, kept in an unnamed temporary file; a context manager.

    :param folder: folder of that file; a killed process leaves nothing there.
    :raises InputError: the folder cannot be written.
    """

    def __init__(self, folder: PathLike) -> None:
        self._file = tempfile.TemporaryFile('w+b', dir=prepare_folder(folder))
        self._file.write(csv_text(TRACK_COLUMNS, ()).encode())
        self._open: dict[int, list[TrackUpdate]] = {}  # by track, in order of stamps
        self._final: list[tuple[int, int, str]] = []  # a heap of stamp, track, line

    def __exit__(self, *_: object) -> None:
        """Discard the temporary file."""
        self._file.close()

    @property
    def waiting(self) -> int:
        """Return the number of rows that are held in memory."""
        return len(self._final) + sum(map(len, self._open.values()))

    def add(self, updates: Sequence[TrackUpdate], passes: Sequence[PassResult],
            open_tracks: Collection[int]) -> None:
        """
        Add the updates and passes of one pair.

        :param updates: updates of the pair, later than all before.
        :param passes: passes that have ended since.
        :param open_tracks: numbers of the tracks whose passes are still to come; rows of any
            other track without a pass are dropped, because it was no vehicle.
        """
        for update in updates:
            self._open.setdefault(update.track, []).append(update)
        for result in passes:
            self._close(result)
        for track in self._open.keys() - set(open_tracks):
            del self._open[track]
        self._write()

    def save(self, path: Path) -> None:
        """
        Write the whole table; call it only after the run.

        :param path: the file.
        """
        self._open.clear()
        self._write()
        self._file.seek(0)
        with path.open('wb') as out:
            shutil.copyfileobj(self._file, out)

    def _close(self, result: PassResult) -> None:
        """Complete the rows of a pass with its smoothed speeds."""
        for update in self._open.pop(result.track, ()):
            row = track_row(update, result.smoothed.get(update.stamp_ns))
            heapq.heappush(self._final, (update.stamp_ns, result.track,
                                         csv_text([str(cell) for cell in row], ())))

    def _write(self) -> None:
        """Write the final rows that are earlier than all waiting ones."""
        first_ns = min((rows[0].stamp_ns for rows in self._open.values()), default=None)
        while self._final and (first_ns is None or self._final[0][0] < first_ns):
            self._file.write(heapq.heappop(self._final)[2].encode())
