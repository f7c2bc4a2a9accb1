# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Read targets and their initial boxes, marked by a person in a video (YAML)."""
from __future__ import annotations

import math
from typing import Sequence

import numpy as np

from .atomic import PathLike
from ..core.errors import SiteError
from ..core.strict_yaml import kind, load_yaml, StrictMapping
from ..core.units import is_finite
from ..monocular.boxes import Target

_LARGEST = 1e6  # px or degrees; a larger number is taken for a typing error


def load_targets(path: PathLike) -> list[Target]:
    """
    Read the targets file (``environment_targets: 1``).

    :raises SiteError: names the field, what was found and what was wanted.
    """
    top = StrictMapping(path, '', load_yaml(path, 'environment_targets'),
                        ('environment_targets', 'targets'))
    targets: list[Target] = []
    for index, item in enumerate(top.listed('targets')):
        fields = StrictMapping(path, f'targets[{index}]', item,
                               ('id', 'frame', 'box', 'angle_deg'))
        target = _target(fields)
        if target.id in [t.id for t in targets]:
            raise fields.error('id', f'{target.id} twice', 'a different id for each target')
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


def _number(fields: StrictMapping, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) \
            or not is_finite(value) or abs(value) > _LARGEST:
        raise fields.error(key, kind(value), 'a finite number')
    return float(value)


def check_targets(targets: Sequence[Target], width: int, height: int, where: object) -> None:
    """
    Refuse a target whose box is outside the image.

    :raises SiteError: names the target.
    """
    for index, target in enumerate(targets):
        x, y, w, h = target.box_px
        if x >= width or y >= height or x + w <= 0 or y + h <= 0:
            raise SiteError(where, f'targets[{index}].box', [float(v) for v in target.box_px],
                            f'a box in the image of {width}x{height} px')
