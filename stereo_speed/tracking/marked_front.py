# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The part of an annotated front that is measured.

The windscreen of a lorry or bus lies behind its bumper and mirrors sky, trees and road.  What it
mirrors does not grow with the front, which would be taken for a lower speed.  A detected front
of that width ends below the windscreen anyway.
"""
from __future__ import annotations

from dataclasses import replace
from typing import Union

import numpy as np

from .initialise import place_front
from .protocol import Refusal, TrackStart
from ..core.records import Array, InitialFront
from ..vision.haar import PartGrid


def measured_part(start: TrackStart) -> Union[InitialFront, Refusal]:
    """
    Return a front without what lies above the bumper and the grille of a lorry or bus.

    Narrower fronts are returned as they are, and so are quads that have no such lower part, as
    that of a windscreen alone.

    :param start: what a track of the whole front would start from.
    :return: the part, or why there is no front.
    """
    front, config = start.front, start.config.start
    placed = place_front(start, PartGrid(start.config.parts, start.config.samples_per_part))
    if isinstance(placed, Refusal):
        return placed
    on_plane = placed.front.corners_m + placed.pose[1:]
    top_m, bottom_m = on_plane[:2, 1], on_plane[[3, 2], 1]
    if np.ptp(on_plane[:, 0]) < config.tall_width_m or top_m.max() <= config.tall_high_m \
            or bottom_m.max() > config.tall_high_m / 2:
        return front
    above = np.clip((top_m - config.tall_high_m) / (top_m - bottom_m), 0.0, 1.0)
    return replace(front, left_px=_without_top(front.left_px, above),
                   right_px=_without_top(front.right_px, above))


def _without_top(quad_px: Array, above: Array) -> Array:
    """
    Return a quad (4, 2) without the upper part of its left and of its right edge, px.

    :param above: (2,) shares of these edges to leave out.
    """
    top, bottom = quad_px[:2], quad_px[[3, 2]]
    return np.concatenate([top + above[:, None] * (bottom - top), quad_px[2:]])
