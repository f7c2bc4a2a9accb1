# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Measure long bags in parts, so that an interrupted run resumes at the last finished part.

A part ends when it is long enough and no vehicle is in view.  The next part starts with a new
pipeline that takes over only the rig motion, the statistics of the stamps and the track numbers.
So a resumed run writes the same files as an uninterrupted one.  The results so far are kept in a
hidden folder until all files of the run are written.
"""
from __future__ import annotations

import argparse
from dataclasses import replace
import hashlib
import json
import os
from pathlib import Path
import shutil
from typing import Any, Callable, Collection, Iterator, Mapping, NamedTuple, Optional, TextIO

import cv2
import numpy as np
from numpy.typing import NDArray

from ..batch.job import source_hash
from ..core.errors import InputError
from ..core.records import StereoPair
from ..io.exclusive import open_alone
from ..io.record_json import record_of, record_text
from ..io.results import file_sha256, software_versions
from ..pipeline.pipeline import SpeedPipeline, Step
from ..pipeline.run import Run

PART_PAIRS = 3000  # least length of a part; an interruption loses at most a few minutes
FOLDER = '.replay'
_STEPS = 'steps.jsonl'
_OWN = ('bag', 'bags', 'out', 'jobs', 'dask', 'run')  # per bag, or without effect on results


class Done(NamedTuple):
    """
    Progress of an earlier, interrupted run.

    :param pairs: number of pairs done.
    :param next_track: number of the next track.
    :param wall_s: time spent in the pipeline, s.
    :param size: length of the file up to this point, bytes.
    """

    pairs: int
    next_track: int
    wall_s: float
    size: int


class Parts:
    """
    The parts of a run; a context manager.

    After an error the kept results are removed.  After an interruption they stay, and so do those
    of all parts but the last one after the last pair, until :meth:`remove`, as the files are still
    to be written then.

    :param folder: output folder of the run; with None nothing is kept, and the parts are the same.
    :param identity: everything that determines the results; kept results of a run with another
        identity are discarded.
    :param fresh: makes a new pipeline.
    :param least_pairs: least length of a part.
    """

    def __init__(self, folder: Optional[Path], identity: Mapping[str, Any],
                 fresh: Callable[[], SpeedPipeline], least_pairs: int = PART_PAIRS) -> None:
        self._folder = None if folder is None else folder / FOLDER
        self._digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        self._fresh, self._least_pairs = fresh, least_pairs
        self._file: Optional[TextIO] = None
        self._since, self._frames = 0, 0  # first pair of the part; number of frames kept
        self._pairs = 0  # number of pairs measured
        self._open: set[int] = set()
        self.done: Optional[Done] = None

    def __enter__(self) -> Parts:
        """Return itself, with the progress of an earlier run in ``done``."""
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            path = self._folder / _STEPS
            self._file = open_alone(path, 'folder')
            self.done = self._last_cut(path)
            self._file.truncate(0 if self.done is None else self.done.size)
            if self.done is None:
                self._write({'identity': self._digest})
            else:
                self._since = self.done.pairs
        return self

    def __exit__(self, kind: Optional[type[BaseException]], *_: object) -> None:
        """Remove the kept results after an error other than of the disk."""
        if self._file is not None:
            self._file.close()
            if kind is not None and issubclass(kind, Exception) and not issubclass(kind, OSError):
                self.remove()

    def remove(self) -> None:
        """Remove the kept results."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def steps(self) -> Iterator[tuple[Step, Collection[int]]]:
        """Yield the kept steps and, for each, the numbers of the open tracks."""
        if self.done is None or self._folder is None:
            return
        path = self._folder / _STEPS
        with path.open('rb') as file:
            while file.tell() < self.done.size:
                content = record_of(file.readline().decode(), path)
                if isinstance(content, list):
                    updates, passes, open_tracks = content
                    yield Step(updates, passes), set(open_tracks)

    def tell(self, pair: StereoPair, step: Step, open_tracks: Collection[int]) -> None:
        """
        Keep the step of a pair.

        :param open_tracks: numbers of the tracks whose passes are still to come.
        """
        if step.updates or step.passes or open_tracks != self._open:
            self._write([step.updates, [replace(p, trace=None) for p in step.passes],
                         sorted(open_tracks)])
        self._open = set(open_tracks)

    def ends(self, pair: StereoPair, pipeline: SpeedPipeline) -> bool:
        """Return whether the part ends with this pair."""
        self._pairs = pair.index + 1
        return self._pairs - self._since >= self._least_pairs and pipeline.is_idle()

    def begin(self, pipeline: SpeedPipeline, so_far: Run) -> SpeedPipeline:
        """
        Return the pipeline of the next part.

        :param so_far: the run up to the start of the part.
        """
        self._since = self._pairs
        self._write({'pairs': self._pairs, 'next_track': pipeline.next_track,
                     'wall_s': so_far.wall_s}, flush=True)
        fresh = self._fresh()
        fresh.go_on_from(pipeline)
        return fresh

    def add_frame(self, image: NDArray[np.uint8]) -> None:
        """Keep an annotated frame."""
        if self._folder is not None:
            cv2.imwrite(str(self._folder / f'frame{self._frames}.png'), image)
        self._frames += 1

    def next_frame(self) -> NDArray[np.uint8]:
        """Return the kept frames one after the other, in their order."""
        path = self._folder / f'frame{self._frames}.png' if self._folder is not None else Path()
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise InputError(path, 'frame', 'no image',
                             'the folder unchanged; remove it to start again')
        self._frames += 1
        return np.asarray(image, np.uint8)

    def _write(self, content: Any, flush: bool = False) -> None:
        if self._file is not None:
            self._file.write(record_text(content) + '\n')
            if flush:
                self._file.flush()
                os.fsync(self._file.fileno())

    def _last_cut(self, path: Path) -> Optional[Done]:
        """Return the last end of a part in a file; None where there is none for this run."""
        found, size = None, 0
        with path.open('rb') as file:
            for number, line in enumerate(file):
                size += len(line)
                if number == 0 and self._digest.encode() not in line:
                    return None
                if line.startswith(b'{"!":"dict","v":[["pairs"') and line.endswith(b'\n'):
                    cut = record_of(line.decode(), path)
                    found = Done(cut['pairs'], cut['next_track'], cut['wall_s'], size)
        return found


def shared_options(args: argparse.Namespace) -> dict[str, Any]:
    """Return what the results of all bags depend on: options, files they name, versions."""
    options = {name: value for name, value in vars(args).items() if name not in _OWN}
    paths = [value for value in options.values() if isinstance(value, Path) and value.is_file()]
    return {'options': {name: plain(value) for name, value in sorted(options.items())},
            'inputs': {str(path.resolve()): file_sha256(path) for path in paths},
            'versions': software_versions()}


def plain(value: Any) -> Any:
    """Return an option's value as JSON; paths are absolute."""
    return {'path': str(value.resolve())} if isinstance(value, Path) else value


def files_of(bag: Path) -> list[tuple[str, int, int]]:
    """Return name, size and modification time of a bag's files, which identify the bag."""
    files = sorted(p for p in bag.iterdir() if p.is_file()) if bag.is_dir() else [bag]
    return [(p.name, p.stat().st_size, p.stat().st_mtime_ns) for p in files if p.exists()]


def identity_of(args: argparse.Namespace) -> dict[str, Any]:
    """Return everything that determines the results of one bag."""
    return {'bag': str(args.bag.resolve()), 'files': files_of(args.bag), 'code': source_hash(),
            **shared_options(args)}


def is_kept(args: argparse.Namespace) -> bool:
    """Return whether a run can be resumed; unfinished pictures and records cannot."""
    return not (args.evidence or args.video or args.report)
