# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Read the map of a scene: its image (PNG), and the polygons it is drawn from (YAML)."""
from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .atomic import PathLike
from .decoding import read_image
from ..core.errors import InputError
from ..core.strict_yaml import load_yaml, StrictMapping
from ..monocular.distance import KINDS, Labels
from ..monocular.regions import KIND_LEVELS, Region


def load_map(path: PathLike) -> Labels:
    """
    Read a map: 8-bit, one channel, 255 pathway, 128 accessible, 0 inaccessible.

    :raises InputError: unreadable, another format, or other values.
    """
    wanted = 'an 8-bit grey image of 255 pathway, 128 accessible, 0 inaccessible'
    image = read_image(path, cv2.IMREAD_UNCHANGED, wanted, 'map')
    if image.dtype != np.uint8 or image.ndim != 2:
        raise InputError(path, 'map', f'{image.dtype} of shape {image.shape}', wanted)
    strange = sorted(set(np.unique(image).tolist()) - set(KINDS))
    if strange:
        raise InputError(path, 'map', f'grey levels {strange[:5]}', wanted)
    return np.asarray(image, dtype=np.uint8)


def check_map_size(labels: Labels, image: NDArray[np.uint8], where: object) -> None:
    """
    Refuse a map whose size differs from the frames'.

    :param labels: (H, W), the map.
    :param image: (H, W, 3), a frame.
    :param where: the map's file.
    :raises InputError: names both sizes.
    """
    if image.shape[:2] != labels.shape:
        height, width = image.shape[:2]
        raise InputError(where, 'size of the map', f'{labels.shape[1]}x{labels.shape[0]} px',
                         f'{width}x{height} px as the frames')


def load_regions(path: PathLike) -> tuple[list[Region], str]:
    """
    Read a polygons file (``stereo_speed_map: 1``).

    :return: the regions, in drawing order, and the kind of the background.
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
