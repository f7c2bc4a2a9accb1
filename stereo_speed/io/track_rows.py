# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``tracks.csv`` written while a run goes on, so that hours of traffic fit the memory.

A row is final when the pass of its track has been measured, for it holds the smoothed speed; the
file is in order of stamps, so rows wait for the tracks that began before them.
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
    The rows of ``tracks.csv``, kept in a file without a name; a context manager.

    :param folder: where that file is kept; what is killed leaves nothing there.
    :raises InputError: a folder that cannot be written.
    """

    def __init__(self, folder: PathLike) -> None:
        self._file = tempfile.TemporaryFile('w+b', dir=prepare_folder(folder))
        self._file.write(csv_text(TRACK_COLUMNS, ()).encode())
        self._open: dict[int, list[TrackUpdate]] = {}  # by track, in order of stamps
        self._final: list[tuple[int, int, str]] = []  # a heap of stamp, track, line

    def __exit__(self, *_: object) -> None:
        """Let go of the file."""
        self._file.close()

    @property
    def waiting(self) -> int:
        """Return the number of rows that are held in memory."""
        return len(self._final) + sum(map(len, self._open.values()))

    def add(self, updates: Sequence[TrackUpdate], passes: Sequence[PassResult],
            open_tracks: Collection[int]) -> None:
        """
        Take in what came of one pair.

        :param updates: later than all before.
        :param passes: that are over since.
        :param open_tracks: numbers of the tracks whose passes are still to come; what is not
            among them, and is no pass, was no vehicle.
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
        Write the whole table; only when the run is over.

        :param path: the file.
        """
        self._open.clear()
        self._write()
        self._file.seek(0)
        with path.open('wb') as out:
            shutil.copyfileobj(self._file, out)

    def _close(self, result: PassResult) -> None:
        """Complete the rows of a pass by its smoothed speeds."""
        for update in self._open.pop(result.track, ()):
            row = track_row(update, result.smoothed.get(update.stamp_ns))
            heapq.heappush(self._final, (update.stamp_ns, result.track,
                                         csv_text([str(cell) for cell in row], ())))

    def _write(self) -> None:
        """Write the rows that no row to come is before."""
        first_ns = min((rows[0].stamp_ns for rows in self._open.values()), default=None)
        while self._final and (first_ns is None or self._final[0][0] < first_ns):
            self._file.write(heapq.heappop(self._final)[2].encode())
