# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Find what can be reviewed at a path: runs, a log of passes, records of violations."""
from __future__ import annotations

from pathlib import Path
from typing import Sequence

from .evidence import EvidenceRun
from .pass_logs import PassLogRun
from .runs import Run, RunFolder
from ..core.errors import InputError
from ..io.pass_tables import SQLITE
from ..io.results import PASSES, SUMMARY

EVIDENCE = 'evidence'  # folder of records inside the folder of a run
_WANTED = 'a folder of replay, replay-many or evidence, or an SQLite file of passes'


def open_runs(places: Sequence[Path]) -> list[Run]:
    """
    Return the runs, logs and records to review.

    :param places: folders of runs, with the records in them; folders of such folders; folders of
        records; SQLite files with a table ``passes``.
    :raises InputError: a place without any, or with a damaged one.
    """
    out: list[Run] = []
    for place in places:
        name = place.resolve().name
        if place.is_file():
            out.append(PassLogRun(place, name))
        elif not place.is_dir():
            raise InputError(place, 'folder', 'no such folder', _WANTED)
        elif EvidenceRun.is_one(place):
            out.append(EvidenceRun(place, name))
        elif (place / SUMMARY).is_file() and (place / PASSES).is_file():
            out += _of_run(place, name)
        else:
            out += _of_folders(place, name)
    return out


def _of_run(folder: Path, name: str) -> list[Run]:
    """Return a run, and the records of violations in its folder."""
    out: list[Run] = [RunFolder.read(folder, name)]
    records = folder / EVIDENCE
    if records.is_dir() and EvidenceRun.is_one(records):
        out.append(EvidenceRun(records, f'{name}/{EVIDENCE}'))
    return out


def _of_folders(place: Path, name: str) -> list[Run]:
    """Return the runs in the subfolders of a folder, and their common table if there is one."""
    out: list[Run] = []
    if (place / SQLITE).is_file():
        out.append(PassLogRun(place / SQLITE, f'{name}/{SQLITE}'))
    for path in sorted(path.parent for path in place.glob(f'*/{PASSES}')):
        out += _of_run(path, f'{name}/{path.name}')
    if not out:
        raise InputError(place, SUMMARY, 'none, and none in its folders', _WANTED)
    return out
