# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Keeps the edges of a detected front off lamps that clip.

A clipped lamp keeps its size in pixels while the front grows (``tracking.photometry``).  A whole
lamp does so on all sides, and its middle stays in place.  Where the edge of the front cuts through
it, only one side of its outline counts, which moves across the front: a bus on a wet night, cut
so, was measured 1.4 % too slow.
"""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .front_sampler import FrontHypothesis, GRID_M
from .lane_geometry import LaneGeometry
from ..core.records import Array, StereoPair
from ..core.tracker_config import NoiseConfig

_STEP_M = 0.02  # spacing of the rows that are looked at
_MORE_M = 0.45  # greatest distance by which the upper edge moves up; lamps are lower than that
_ROAD_M = 0.15  # height up to which lamps are mirrored in a wet road, and light it
_LEAST_HEIGHT_M = 0.3  # least height of a front
_MARGIN_PX = 1.0  # least distance of an edge from a clipped pixel
_CLIPPED_SHARE = NoiseConfig().clipped_share  # of full scale


def uncut_heights(geometry: LaneGeometry, front: FrontHypothesis, heights_m: Array,
                  pair: StereoPair) -> Array:
    """
    Return the heights (2,) of the upper and the lower edge of a front, moved off clipped lamps.

    :param geometry: the lane of the front.
    :param front: the front in the pair.
    :param heights_m: (2,) heights of its upper and its lower edge above the road, m.
    :param pair: the pair.
    """
    rows_m = np.arange(heights_m[0] + _MORE_M, _ROAD_M, -_STEP_M)
    lit_m = rows_m[_lit(geometry, front, rows_m, pair)]
    margin_m = _MARGIN_PX / float(geometry.px_per_m(np.array([front.s_m]))[0])
    return moved_edges(rows_m, lit_m, heights_m, max(margin_m, _STEP_M))


def moved_edges(rows_m: Array, lit_m: Array, heights_m: Array, margin_m: float) -> Array:
    """
    Return the heights (2,) of the upper and the lower edge of a front, moved off rows that clip.

    Either edge moves up, so that the front has whole lamps and none of the light on the road, or
    else down.  An edge with nowhere to go stays.

    :param rows_m: (n,) heights where the edges may be, m.
    :param lit_m: (k,) heights of the rows that clip, m.
    :param heights_m: (2,) heights of the edges, m.
    :param margin_m: least distance of an edge from a row that clips, m.
    """
    free_m = rows_m[_off(rows_m, lit_m) > margin_m]
    high_m, low_m = heights_m
    if _off(heights_m[:1], lit_m) <= margin_m:
        high_m = _moved(high_m, free_m[free_m >= low_m + _LEAST_HEIGHT_M])
    if _off(heights_m[1:], lit_m) <= margin_m:
        low_m = _moved(low_m, free_m[free_m <= high_m - _LEAST_HEIGHT_M])
    return np.array([high_m, low_m])


def _off(rows_m: Array, lit_m: Array) -> Array:
    """Return the distances (n,) of rows to the nearest row that clips, m."""
    return np.asarray(np.abs(rows_m[:, None] - lit_m).min(axis=1, initial=np.inf))


def _moved(edge_m: float, free_m: Array) -> float:
    """Return the free height next above an edge, or else next below it, or else its own."""
    above, below = free_m[free_m > edge_m], free_m[free_m < edge_m]
    if len(above):
        return float(above.min())
    return float(below.max()) if len(below) else edge_m


def _lit(geometry: LaneGeometry, front: FrontHypothesis, rows_m: Array, pair: StereoPair
         ) -> NDArray[np.bool_]:
    """Return which rows (n,) of the plane of a front clip in either view."""
    across_m = front.x_m + np.arange(-front.half_m, front.half_m + GRID_M, GRID_M)
    now, later = (geometry.points(np.array([front.s_m + ahead_m]), across_m, rows_m)[0]
                  for ahead_m in (0.0, front.ahead_m))
    left, right, *valid = geometry.rig.as_taken(pair.motion).project(now, later)
    lit = np.zeros(len(rows_m), dtype=bool)
    for image, uv, in_image in zip((pair.left, pair.right), (left, right), valid):
        clipped = _greys(image, uv) >= _CLIPPED_SHARE * np.iinfo(image.dtype).max
        lit |= (in_image & clipped).any(axis=1)
    return lit


def _greys(image: Array, uv_px: Array) -> Array:
    """Return the grey values (n, m) of the pixels nearest to pixels (n, m, 2)."""
    last = np.array(image.shape[::-1]) - 1
    u, v = np.clip(np.round(np.nan_to_num(uv_px)), 0, last).astype(int).transpose(2, 0, 1)
    return np.asarray(image[v, u])
