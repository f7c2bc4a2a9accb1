# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Write the output folder of a run of the monocular tracker."""
from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, Iterable, Mapping, Optional, Sequence

from .atomic import csv_text, PathLike, staged
from .mot import boxes_text, fixed
from .results import summary_json
from ..monocular.boxes import TargetEnd, TargetEstimate

BOXES, TARGETS, ENDS, SUMMARY = 'boxes.txt', 'targets.csv', 'ends.csv', 'summary.json'
ANNOTATED = 'annotated.avi'
RUN_FILES = (SUMMARY, BOXES, TARGETS, ENDS, ANNOTATED)  # the first shows that a run is complete
TARGET_COLUMNS = ('frame', 'id', 'x', 'y', 'w', 'h', 'angle_deg', 'd_px', 'd_rate_px')
END_COLUMNS = ('id', 'first_frame', 'last_frame', 'frames', 'end')


def targets_text(estimates: Iterable[TargetEstimate]) -> str:
    """Return the text of ``targets.csv``; an infinite distance is written ``inf``."""
    rows = [(e.frame, e.id, *map(fixed, (*e.box_px, math.degrees(e.angle_rad), e.distance_px,
                                         e.distance_rate_px)))
            for e in sorted(estimates, key=lambda e: (e.frame, e.id))]
    return csv_text(TARGET_COLUMNS, rows)


def ends_text(ends: Iterable[TargetEnd]) -> str:
    """Return the text of ``ends.csv``: how each target ended, a row per target."""
    return csv_text(END_COLUMNS, [
        (e.id, e.first_frame, e.last_frame, e.frames, e.state.value)
        for e in sorted(ends, key=lambda e: e.id)])


def write_targets(out_dir: PathLike, estimates: Sequence[TargetEstimate],
                  ends: Sequence[TargetEnd], summary: Mapping[str, Any],
                  annotated: Optional[Path] = None) -> None:
    """
    Write the files of a run; they appear when complete, ``summary.json`` last.

    The files of an older run in that folder are removed.

    :param annotated: finished video, which is moved into the folder; None where there is none.
    :raises InputError: a folder that cannot be written.
    """
    texts = {BOXES: boxes_text(estimates), TARGETS: targets_text(estimates),
             ENDS: ends_text(ends), SUMMARY: summary_json(summary)}
    with staged(out_dir, RUN_FILES) as aside:
        for name, text in texts.items():
            (aside / name).write_bytes(text.encode('utf-8'))
        if annotated is not None:
            os.replace(annotated, aside / ANNOTATED)
