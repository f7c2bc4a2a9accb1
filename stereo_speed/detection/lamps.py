# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Keeps the upper and the lower edge of a detected front off lamps that clip.

A clipped lamp keeps its size in pixels while the front grows (``tracking.observation``).  That
moves the outline of a whole lamp inwards from all sides, and leaves its middle in place.  Where
the edge of the front cuts through it, only one side is seen, which moves across the front: a drawn
bus on a wet night was measured 1.4 % too slow.

The lamps are those of the pairs in which the front is detected.
"""
from __future__ import annotations

from typing import Any, NamedTuple, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .front_sampler import FrontHypothesis, GRID_M
from .lane_geometry import LaneGeometry, well_inside
from .pyramid import PairPyramids
from ..core.fronts import LEAST_FRONT_M
from ..core.records import Array, StereoPair
from ..core.tracker_config import NoiseConfig
from ..vision.grey import white_level

_STEP_M = 0.02  # spacing of the rows that are looked at
_MORE_M = 0.45  # greatest distance by which the upper edge moves up
_LOWEST_M = 0.15  # lowest row that is looked at; what clips from there on is light on the road
_LAMP_M = 0.4  # greatest height of lamps with their glare; what is higher is paint in the sun
_MARGIN_PX = 1.0  # least distance of an edge from a clipped pixel
_CLIPPED_SHARE = NoiseConfig().clipped_share  # of full scale, by default


class Look(NamedTuple):
    """
    A front in a pair.

    :param front: the front.
    :param pair: the pair; its images are not used, as those of an earlier one may be gone.
    :param views: left and right image, or parts of them, each with the column and row of the image
        at which it begins.
    """

    front: FrontHypothesis
    pair: StereoPair
    views: Sequence[tuple[NDArray[Any], tuple[int, int]]]

    @classmethod
    def now(cls, front: FrontHypothesis, pair: StereoPair) -> Look:
        """Return a front in the newest pair."""
        return cls(front, pair, [(pair.left, (0, 0)), (pair.right, (0, 0))])

    @classmethod
    def before(cls, front: FrontHypothesis, kept: PairPyramids) -> Look:
        """Return a front in an earlier pair, of which the part that is searched was kept."""
        return cls(front, kept.pair, [
            (view.levels[0], view.origin_px) for view in (kept.left, kept.right)])


def uncut_heights(geometry: LaneGeometry, heights_m: Array, looks: Sequence[Look]) -> Array:
    """
    Return the heights (2,) of the upper and the lower edge of a front, moved off clipped lamps.

    :param geometry: the lane of the front.
    :param heights_m: (2,) heights of its upper and its lower edge above the road, m.
    :param looks: the front in the pairs that show it.
    """
    rows_m = np.arange(heights_m[0] + _MORE_M, _LOWEST_M, -_STEP_M)
    lit, in_view = np.zeros(len(rows_m), dtype=bool), np.ones(len(rows_m), dtype=bool)
    for look in looks:
        of_pair = _seen(geometry, look, rows_m)
        lit, in_view = lit | of_pair[0], in_view & of_pair[1]
    px_per_m = geometry.px_per_m(np.array([look.front.s_m for look in looks])).min()
    return moved_edges(rows_m[in_view], rows_m[lit], heights_m,
                       max(_MARGIN_PX / float(px_per_m), _STEP_M))


def moved_edges(rows_m: Array, lit_m: Array, heights_m: Array, margin_m: float) -> Array:
    """
    Return the heights (2,) of the upper and the lower edge of a front, moved off rows that clip.

    Lamps are to be whole, so the upper edge rather moves up and the lower one down.  Light on the
    road, and paint in the sun, are to be left out.  An edge with nowhere to go stays.

    :param rows_m: (n,) heights where the edges may be, the highest first, m.
    :param lit_m: (k,) heights of the rows that clip, the highest first, m.
    :param heights_m: (2,) heights of the edges, m.
    :param margin_m: least distance of an edge from a row that clips, m.
    """
    high_m, low_m = (float(edge_m) for edge_m in heights_m)
    free_m = rows_m[_off(rows_m, lit_m) > margin_m]
    for top_m, bottom_m in _bands(lit_m, margin_m):
        if bottom_m - margin_m <= high_m <= top_m + margin_m:
            is_lamp = top_m - bottom_m <= _LAMP_M
            high_m = _moved(high_m, free_m[free_m >= low_m + LEAST_FRONT_M],
                            up=True if is_lamp else None)
        if bottom_m - margin_m <= low_m <= top_m + margin_m:
            low_m = _moved(low_m, free_m[free_m <= high_m - LEAST_FRONT_M],
                           up=bottom_m <= _LOWEST_M + margin_m)
    return np.array([high_m, low_m])


def _off(rows_m: Array, lit_m: Array) -> Array:
    """Return the distances (n,) of rows to the nearest row that clips, m."""
    return np.asarray(np.abs(rows_m[:, None] - lit_m).min(axis=1, initial=np.inf))


def _bands(lit_m: Array, margin_m: float) -> list[tuple[float, float]]:
    """Return the highest and the lowest row of each band of rows (n,) with no room in between."""
    ends = np.flatnonzero(-np.diff(lit_m) > 2 * margin_m)
    return [(float(band[0]), float(band[-1])) for band in np.split(lit_m, ends + 1) if len(band)]


def _moved(edge_m: float, free_m: Array, up: Optional[bool]) -> float:
    """
    Return the height where an edge moves to, its own if there is no other.

    :param edge_m: its height, m.
    :param free_m: (n,) heights where it may be, m.
    :param up: whether it rather moves up than down; None for the shorter way.
    """
    def cost(to_m: float) -> tuple[bool, float]:
        return up is not None and (to_m > edge_m) is not up, abs(to_m - edge_m)
    return min(free_m.tolist(), key=cost, default=edge_m)


def _seen(geometry: LaneGeometry, look: Look, rows_m: Array
          ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which rows (n,) of a front clip in either view, and which are well inside both."""
    front, rig = look.front, geometry.rig.as_taken(look.pair.motion)
    columns = 2 * round(front.half_m / GRID_M) + 1
    across_m = front.x_m + np.linspace(-front.half_m, front.half_m, columns)
    now, later = (geometry.points(np.array([front.s_m + ahead_m]), across_m, rows_m)[0]
                  for ahead_m in (0.0, front.ahead_m))
    most = _CLIPPED_SHARE * white_level([look.pair.left, look.pair.right])
    lit, in_view = np.zeros(len(rows_m), dtype=bool), np.ones(len(rows_m), dtype=bool)
    for camera, (image, origin), uv_px in zip(
            (rig.left, rig.right), look.views, rig.project(now, later)[:2]):
        in_view &= well_inside(camera, uv_px).all(axis=1)
        at = np.round(np.nan_to_num(uv_px, nan=-1.0)).astype(int) - np.array(origin)
        size = np.array(image.shape[::-1])
        kept = ((at >= 0) & (at < size)).all(axis=2)
        u, v = np.where(kept[..., None], at, 0).transpose(2, 0, 1)
        lit |= (kept & (image[v, u] >= most)).any(axis=1)
    return lit, in_view
