# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The regions of a scene as polygons drawn by a person, and the map made of them."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np
from numpy.typing import NDArray

from .distance import ACCESSIBLE, INACCESSIBLE, Labels, PATHWAY
from ..core.records import Array

KIND_LEVELS = {'pathway': PATHWAY, 'accessible': ACCESSIBLE, 'inaccessible': INACCESSIBLE}


@dataclass(frozen=True, eq=False, kw_only=True)
class Region:
    """
    A part of the scene.

    :param kind: ``pathway``, ``accessible`` or ``inaccessible``.
    :param polygon_px: (n, 2), corners, px; the last is joined to the first. They may lie outside
        the image.
    """

    kind: str
    polygon_px: Array


def draw_map(regions: Sequence[Region], width: int, height: int,
             background: str = 'accessible') -> Labels:
    """
    Draw regions, later ones over earlier ones.

    :param background: kind of the pixels that no region covers.
    :return: (height, width) uint8: 255 pathway, 128 accessible, 0 inaccessible.
    """
    labels = np.full((height, width), KIND_LEVELS[background], np.uint8)
    for region in regions:
        labels[polygon_mask(region.polygon_px, width, height)] = KIND_LEVELS[region.kind]
    return labels


def polygon_mask(polygon_px: Array, width: int, height: int) -> NDArray[np.bool_]:
    """
    Return which pixels have their centre inside a polygon, by the even-odd rule.

    :param polygon_px: (n, 2) corners, px.
    :return: (height, width).
    """
    mask = np.zeros((height, width), dtype=bool)
    columns = np.arange(width)
    for (x0, y0), (x1, y1) in zip(polygon_px, np.roll(polygon_px, -1, axis=0)):
        low, high = min(y0, y1), max(y0, y1)
        # rows with low <= row < high, so that a corner counts for only one of its edges
        rows = np.arange(max(int(np.ceil(low)), 0), min(int(np.ceil(high)), height))
        if len(rows):
            crossing = x0 + (rows - y0) * (x1 - x0) / (y1 - y0)
            mask[rows] ^= columns[None, :] >= crossing[:, None]
    return mask
