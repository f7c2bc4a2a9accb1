# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The part of an annotated front that is measured.

Bodies are rounded where the front ends, and corners are marked to a pixel at best: a strip along
each edge shows the flank, the hood, the road or another vehicle as often as the front.  What it
shows changes as the vehicle comes nearer.

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
    Return an annotated front without its edges, and without the windscreen of a lorry or bus.

    These are kept where hardly anything would be left without them, as of a windscreen alone.
    Quads that do not match are returned as they are; whether they show a front is left to the
    tracker.

    :param start: what a track of the whole front would start from.
    """
    front, config = start.front, start.config.start
    placed = place_front(start, PartGrid(start.config.parts, start.config.samples_per_part))
    if isinstance(placed, Refusal):
        return front
    on_plane = placed.front.corners_m + placed.pose[1:]
    top_m, bottom_m = on_plane[:2, 1], on_plane[[3, 2], 1]
    width_m, high_m = float(np.ptp(on_plane[:, 0])), top_m - bottom_m
    if min(width_m, *high_m) < LEAST_FRONT_M:
        return front
    above_m = np.zeros(2)
    if width_m >= config.tall_width_m and bottom_m.max() <= config.tall_high_m - LEAST_FRONT_M:
        above_m = np.maximum(top_m - config.tall_high_m, 0.0)
    edge_m = np.clip((high_m - above_m - LEAST_FRONT_M) / 2, 0.0, config.edge_m)
    low, high = edge_m / high_m, 1 - (above_m + edge_m) / high_m
    beside = config.edge_m / width_m
    left_px, right_px = (_without_sides(_between(quad_px, low, high), beside)
                         for quad_px in (front.left_px, front.right_px))
    return replace(front, left_px=left_px, right_px=right_px)


def _between(quad_px: Array, low: Array, high: Array) -> Array:
    """
    Return the part of a quad (4, 2) between two heights, px.

    :param low: (2,) shares of its left and of its right edge at which the part begins.
    :param high: (2,) shares at which it ends.
    """
    top, bottom = quad_px[:2], quad_px[[3, 2]]
    lower, upper = (bottom + share[:, None] * (top - bottom) for share in (low, high))
    return np.concatenate([upper, lower[::-1]])


def _without_sides(quad_px: Array, share: float) -> Array:
    """Return a quad (4, 2) without a share of its width at either side, px."""
    return np.asarray(quad_px + share * (quad_px[[1, 0, 3, 2]] - quad_px))
