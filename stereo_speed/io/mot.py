# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Files of the monocular tracker: map, polygons and targets in, boxes out, ground truth in.

Boxes are in the MOTChallenge's format: ``frame,id,x,y,w,h,conf,-1,-1,-1``, frames from 1.
"""
from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, Iterable, Mapping, Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .atomic import csv_text, PathLike, staged
from .results import summary_json
from ..core.errors import InputError, SiteError
from ..core.records import Array
from ..core.strict_yaml import StrictMapping, load_yaml
from ..monocular.boxes import Target, TargetEnd, TargetEstimate
from ..monocular.distance import KINDS
from ..monocular.regions import KIND_LEVELS, Region

BOXES, TARGETS, ENDS, SUMMARY = 'boxes.txt', 'targets.csv', 'ends.csv', 'summary.json'
ANNOTATED = 'annotated.avi'
RUN_FILES = (SUMMARY, BOXES, TARGETS, ENDS, ANNOTATED)  # the first tells that a run is complete
TARGET_COLUMNS = ('frame', 'id', 'x', 'y', 'w', 'h', 'angle_deg', 'd_px', 'd_rate_px')
END_COLUMNS = ('id', 'first_frame', 'last_frame', 'frames', 'end')
_LARGEST = 1e6  # px


def load_targets(path: PathLike) -> list[Target]:
    """
    Read the targets file (``environment_targets: 1``).

    :raises SiteError: names the field, what was found and what was wanted.
    """
    top = StrictMapping(path, '', load_yaml(path, 'environment_targets'),
                 ('environment_targets', 'targets'))
    targets: list[Target] = []
    for index, item in enumerate(top.listed('targets')):
        fields = StrictMapping(path, f'targets[{index}]', item, ('id', 'frame', 'box', 'angle_deg'))
        target = _target(fields)
        if target.id in [t.id for t in targets]:
            raise fields.error('id', f'{target.id} again', 'an id of its own for each target')
        targets.append(target)
    return targets


def _target(fields: StrictMapping) -> Target:
    number, frame = fields.integer('id'), fields.integer('frame')
    if frame < 1:
        raise fields.error('frame', frame, 'the number of a frame, from 1')
    box = fields.listed('box')
    if len(box) != 4:
        raise fields.error('box', f'{len(box)} values', 'x, y, w, h in px')
    values = [_number(fields, f'box[{i}]', value) for i, value in enumerate(box)]
    if min(values[2:]) <= 0:
        raise fields.error('box', values, 'a width and height above 0 px')
    angle = _number(fields, 'angle_deg', fields.data.get('angle_deg', 0))
    return Target(id=number, frame=frame, box_px=np.array(values), angle_rad=math.radians(angle))


def _number(fields: StrictMapping, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) \
            or not math.isfinite(value) or abs(value) > _LARGEST:
        raise fields.error(key, repr(value), 'a finite number')
    return float(value)


def check_targets(targets: Sequence[Target], width: int, height: int, where: object) -> None:
    """
    Refuse a target that is nowhere in the image.

    :raises SiteError: names it.
    """
    for index, target in enumerate(targets):
        x, y, w, h = target.box_px
        if x >= width or y >= height or x + w <= 0 or y + h <= 0:
            raise SiteError(where, f'targets[{index}].box', [float(v) for v in target.box_px],
                            f'a box in the image of {width}x{height} px')


def load_map(path: PathLike) -> NDArray[np.uint8]:
    """
    Read a map: 8-bit, one channel, 255 pathway, 128 accessible, 0 inaccessible.

    :raises InputError: unreadable, or anything else in it.
    """
    wanted = 'an 8-bit grey image of 255 pathway, 128 accessible, 0 inaccessible'
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise InputError(path, 'map', error.strerror, wanted) from None
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    if image is None:
        raise InputError(path, 'map', f'{data.size} bytes that are no image', wanted)
    if image.dtype != np.uint8 or image.ndim != 2:
        raise InputError(path, 'map', f'{image.dtype} of shape {image.shape}', wanted)
    strange = sorted(set(np.unique(image).tolist()) - set(KINDS))
    if strange:
        raise InputError(path, 'map', f'grey levels {strange[:5]}', wanted)
    return np.asarray(image, dtype=np.uint8)


def load_regions(path: PathLike) -> tuple[list[Region], str]:
    """
    Read a polygons file (``stereo_speed_map: 1``).

    :return: the regions, in the order they are drawn, and the kind of the rest.
    :raises SiteError: names the field, what was found and what was wanted.
    """
    top = StrictMapping(path, '', load_yaml(path, 'stereo_speed_map'),
                 ('stereo_speed_map', 'background', 'regions'))
    background = _kind(top, 'background') if 'background' in top else 'accessible'
    regions = []
    for index, item in enumerate(top.listed('regions')):
        fields = StrictMapping(path, f'regions[{index}]', item, ('kind', 'polygon'))
        regions.append(Region(kind=_kind(fields, 'kind'),
                              polygon_px=fields.points('polygon', 2, 3)))
    return regions, background


def _kind(fields: StrictMapping, key: str) -> str:
    kind = fields.text(key)
    if kind not in KIND_LEVELS:
        raise fields.error(key, repr(kind), ', '.join(KIND_LEVELS))
    return kind


def load_truth(path: PathLike) -> dict[int, dict[int, Array]]:
    """
    Read boxes in the MOTChallenge's format.

    :return: for each id, its boxes (4,) by frame.
    :raises InputError: names the line, what was found and what was wanted.
    """
    wanted = 'frame,id,x,y,w,h and more, frames from 1'
    truth: dict[int, dict[int, Array]] = {}
    try:
        lines = Path(path).read_text(encoding='utf-8').splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, 'file', ' '.join(str(error).split()), wanted) from None
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            values = [float(v) for v in line.split(',')]
        except ValueError:
            values = []
        if len(values) < 6 or not all(map(math.isfinite, values)) \
                or values[0] < 1 or values[0] % 1 or values[1] % 1 or min(values[4:6]) <= 0:
            raise InputError(path, f'line {number}', repr(line[:60]), wanted)
        if len(values) > 6 and values[6] == 0:
            continue  # the MOTChallenge: not to be considered
        truth.setdefault(int(values[1]), {})[int(values[0])] = np.array(values[2:6])
    if not truth:
        raise InputError(path, 'boxes', 'none', wanted)
    return truth


def boxes_text(estimates: Iterable[TargetEstimate]) -> str:
    """Give the text of ``boxes.txt``: upright boxes; the confidence is the similarity."""
    lines = [f'{e.frame},{e.id},' + ','.join(_fixed(v) for v in (*e.envelope_px, e.similarity))
             + ',-1,-1,-1\n' for e in sorted(estimates, key=lambda e: (e.frame, e.id))]
    return ''.join(lines)


def targets_text(estimates: Iterable[TargetEstimate]) -> str:
    """Give the text of ``targets.csv``; a distance that is infinite reads ``inf``."""
    rows = [(e.frame, e.id, *map(_fixed, (*e.box_px, math.degrees(e.angle_rad), e.distance_px,
                                          e.distance_rate_px)))
            for e in sorted(estimates, key=lambda e: (e.frame, e.id))]
    return csv_text(TARGET_COLUMNS, rows)


def ends_text(ends: Iterable[TargetEnd]) -> str:
    """Give the text of ``ends.csv``: a row per target that says how it ended."""
    return csv_text(END_COLUMNS, [
        (e.id, e.first_frame, e.last_frame, e.frames, e.state.value)
        for e in sorted(ends, key=lambda e: e.id)])


def write_targets(out_dir: PathLike, estimates: Sequence[TargetEstimate],
                  ends: Sequence[TargetEnd], summary: Mapping[str, Any],
                  annotated: Optional[Path] = None) -> None:
    """
    Write the files of a run; they appear when whole, ``summary.json`` last.

    Those of an older run there are removed, also those that this one does not have.

    :param annotated: the finished video, which is moved; None for a run without.
    :raises InputError: a folder that cannot be written.
    """
    texts = {BOXES: boxes_text(estimates), TARGETS: targets_text(estimates),
             ENDS: ends_text(ends), SUMMARY: summary_json(summary)}
    with staged(out_dir, RUN_FILES) as aside:
        for name, text in texts.items():
            (aside / name).write_bytes(text.encode('utf-8'))
        if annotated is not None:
            os.replace(annotated, aside / ANNOTATED)


def _fixed(value: float) -> str:
    if not math.isfinite(value):
        return 'inf' if value > 0 else '-inf'
    text = f'{value:.3f}'
    return text.lstrip('-') if float(text) == 0 else text
