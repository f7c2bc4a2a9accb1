# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The part of an annotated front that is measured.

The windscreen of a lorry or bus lies behind its bumper and mirrors sky, trees and road.  What it
mirrors does not grow as the front does, which would be taken for another speed.  A detected front
of that width ends at the same height, unless lamps clip there.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from .initialise import place_front
from .protocol import Refusal, TrackStart
from ..core.fronts import LEAST_FRONT_M
from ..core.records import Array, InitialFront
from ..vision.haar import PartGrid


def measured_part(start: TrackStart) -> InitialFront:
    """
    Return a front without what lies above the bumper and the grille of a lorry or bus.

    Narrower fronts are returned as they are, and so are those of which hardly anything would be
    left, as of a windscreen alone.  Whether quads that do not match show a front is left to the
    tracker.

    :param start: what a track of the whole front would start from.
    """
    front, config = start.front, start.config.start
    placed = place_front(start, PartGrid(start.config.parts, start.config.samples_per_part))
    if isinstance(placed, Refusal):
        return front
    on_plane = placed.front.corners_m + placed.pose[1:]
    top_m, bottom_m = on_plane[:2, 1], on_plane[[3, 2], 1]
    if np.ptp(on_plane[:, 0]) < config.tall_width_m or top_m.max() <= config.tall_high_m \
            or bottom_m.max() > config.tall_high_m - LEAST_FRONT_M:
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
