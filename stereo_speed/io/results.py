# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Write the files of a run: ``tracks.csv``, ``passes.csv`` and ``summary.json``.

The same run gives the same files, byte for byte: numbers have a fixed number of digits, rows
and keys a fixed order, and no wall-clock time is written. The files are written to a temporary
place and renamed when complete, ``summary.json`` last, so that a folder with a summary is a
finished run.
"""
from __future__ import annotations

from concurrent.futures import CancelledError
import dataclasses
from enum import Enum
import hashlib
from importlib.metadata import PackageNotFoundError, version
import json
import math
from pathlib import Path
import platform
import threading
from typing import Any, ContextManager, Iterable, Mapping, Optional, Sequence

import cv2
import numpy as np
import scipy

from .atomic import csv_text, PathLike, staged, write_whole
from ..core.compiled import kernels
from ..core.passes import PassResult, SecondEstimate, VehicleKind
from ..core.records import TrackUpdate
from ..core.units import seconds

TRACKS, PASSES, SUMMARY = 'tracks.csv', 'passes.csv', 'summary.json'
TRACK_COLUMNS = ('stamp_ns', 'track', 'lane', 'state', 'speed_mps', 'speed_std_mps',
                 'smoothed_mps', 's_m', 'lateral_m', 'x_m', 'y_m', 'z_m')
PASS_COLUMNS = ('track', 'lane', 'first_ns', 'last_ns', 'pairs', 'speed_mps', 'speed_std_mps',
                'verdict', 'reason', 'lane_to', 'end', 'first_mps', 'last_mps', 'max_mps',
                'std_matching_mps', 'std_path_mps', 'std_stamps_mps', 'std_calibration_mps',
                'second_mps', 'second_std_mps', 'second_pairs', 'direction', 'class',
                'class_probability', 'width_m', 'width_std_m', 'height_m', 'height_std_m')
PLOTS = ('speed.png', 'road.png', 'strip.png')  # written by ``report``
REPORTS = ('report.html', 'video.avi', 'run.sqlite')  # optional files
_OLDER = (SUMMARY, TRACKS, PASSES, *PLOTS, *REPORTS)  # the summary is removed first
_DIGITS = 5  # 0.01 mm and 0.01 mm/s, well below the uncertainty of any result


def kind_of(column: str) -> type:
    """Return the type of a column by its name: ``int``, ``float`` or ``str``."""
    if column in ('track', 'pairs') or column.endswith(('_ns', '_pairs')):
        return int
    return float if column.endswith(('_mps', '_m', '_s', '_deg', '_probability')) else str


def write_run(out_dir: PathLike, updates: Optional[Sequence[TrackUpdate]],
              passes: Sequence[PassResult], summary: Mapping[str, Any]) -> None:
    """
    Write the three files of a run and remove those of an older run in the same folder.

    :param out_dir: folder, made where it is missing.
    :param updates: every update of every track, in any order; None leaves ``tracks.csv`` to
        :class:`.track_rows.TrackRows`.
    :param passes: every pass, in any order.
    :param summary: versions, parameters, seed, input hash, timings; the same for a repeated run.
    :raises InputError: the folder cannot be written.
    """
    tracks = {} if updates is None else {TRACKS: tracks_csv(updates, passes)}
    write_whole(out_dir, {**tracks, PASSES: passes_csv(passes), SUMMARY: summary_json(summary)},
                [name for name in _OLDER if updates is not None or name != TRACKS])


def staged_run(out_dir: PathLike) -> ContextManager[Path]:
    """
    Yield a hidden folder for a run of more than three files; see :func:`.atomic.staged`.

    :param out_dir: output folder, where the files replace those of an older run.
    """
    return staged(out_dir, _OLDER)


def file_sha256(path: Path, stop: Optional[threading.Event] = None) -> str:
    """
    Return the SHA-256 of a file, hex; large files are read in blocks.

    :param path: the file.
    :param stop: ends it early where it is set, by another thread.
    :raises CancelledError: it was ended early.
    """
    digest = hashlib.sha256()
    with path.open('rb') as stream:
        for block in iter(lambda: stream.read(1 << 20), b''):
            if stop is not None and stop.is_set():
                raise CancelledError(f'no longer wanted: the hash of {path}')
            digest.update(block)
    return digest.hexdigest()


def tracks_csv(updates: Iterable[TrackUpdate], passes: Iterable[PassResult]) -> str:
    """
    Return the text of ``tracks.csv``: a row per vehicle and pair, by stamp, then track.

    :param updates: the live updates.
    :param passes: the passes, for the smoothed speeds; a missing one leaves the field empty.
    """
    smoothed = {p.track: p.smoothed for p in passes}
    return csv_text(TRACK_COLUMNS, [
        track_row(u, smoothed.get(u.track, {}).get(u.stamp_ns))
        for u in sorted(updates, key=lambda u: (u.stamp_ns, u.track))])


def track_row(update: TrackUpdate, smoothed_mps: Optional[float]) -> tuple[object, ...]:
    """
    Return a row of ``tracks.csv``.

    :param update: a live update.
    :param smoothed_mps: the smoothed speed of its pair, m/s; None where there is none.
    """
    numbers = (update.speed_mps, update.speed_std_mps, smoothed_mps, update.s_m,
               update.lateral_m, *update.position_m)
    return (update.stamp_ns, update.track, update.lane, update.state.value, *map(fixed, numbers))


def passes_csv(passes: Iterable[PassResult]) -> str:
    """Return the text of ``passes.csv``: a row per vehicle, by track."""
    rows = []
    for p in sorted(passes, key=lambda p: p.track):
        parts = (None,) * 4 if p.budget is None else (
            p.budget.matching_mps, p.budget.path_mps, p.budget.stamps_mps,
            p.budget.calibration_mps)
        rows.append((p.track, p.lane, p.first_ns, p.last_ns, p.pairs, fixed(p.speed_mps),
                     fixed(p.speed_std_mps), p.verdict.value, p.reason, p.lane_to, p.end,
                     *map(fixed, (*p.profile_mps, *parts)), *_second(p.second),
                     '' if p.direction is None else p.direction, *_vehicle(p.vehicle)))
    return csv_text(PASS_COLUMNS, rows)


def _second(second: Optional[SecondEstimate]) -> tuple[str, str, str]:
    """Return the cells of the second estimate, empty where there is none."""
    if second is None:
        return '', '', ''
    return fixed(second.speed_mps), fixed(second.speed_std_mps), str(second.pairs)


def _vehicle(vehicle: Optional[VehicleKind]) -> tuple[str, ...]:
    """Return the cells of a vehicle's class and size, empty where they are unknown."""
    if vehicle is None:
        return ('',) * 6
    return (vehicle.name, *map(fixed, (
        vehicle.probability, vehicle.width_m, vehicle.width_std_m, vehicle.height_m,
        vehicle.height_std_m)))


def summary_json(summary: Mapping[str, Any]) -> str:
    """Return the text of ``summary.json``: sorted keys; non-finite numbers become null."""
    return json.dumps(_plain(summary), indent=2, sort_keys=True, ensure_ascii=False,
                      allow_nan=False) + '\n'


def software_versions() -> dict[str, str]:
    """Return the versions of the software that the results depend on."""
    from .. import __version__  # here, so that io can be imported by the package itself
    try:
        rosbags = version('rosbags')
    except PackageNotFoundError:
        rosbags = 'unknown'
    return {'stereo_speed': __version__,
            'python': '.'.join(platform.python_version_tuple()[:2]),
            'numpy': np.__version__, 'opencv': cv2.__version__, 'scipy': scipy.__version__,
            'rosbags': rosbags, 'kernels': str(kernels())}


def stream_timings(stamps_ns: Sequence[int]) -> dict[str, Any]:
    """
    Return the timing of the recorded stream, which does not depend on the replay.

    :param stamps_ns: stamps of the pairs, rising, ns.
    """
    facts: dict[str, Any] = {'pairs': len(stamps_ns)}
    if stamps_ns:
        facts.update(first_ns=int(stamps_ns[0]), last_ns=int(stamps_ns[-1]),
                     duration_s=round(seconds(stamps_ns[-1], stamps_ns[0]), 9))
    if len(stamps_ns) > 1:
        steps_ns = np.diff(np.asarray(stamps_ns, dtype=np.int64))
        facts.update(shortest_interval_s=round(int(steps_ns.min()) * 1e-9, 9),
                     longest_interval_s=round(int(steps_ns.max()) * 1e-9, 9),
                     mean_rate_hz=round(1e9 / float(steps_ns.mean()), 6))
    return facts


def fixed(value: Optional[float]) -> str:
    """Return a number with fixed digits; '' where it is unknown; no negative zero."""
    if value is None or not math.isfinite(value):
        return ''
    text = f'{value:.{_DIGITS}f}'
    return text.lstrip('-') if float(text) == 0 else text


def _plain(value: Any) -> Any:
    """Return records, arrays and numpy numbers as JSON types."""
    if isinstance(value, Enum):
        return _plain(value.value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, (str, bool, int, float, type(None))) else str(value)
