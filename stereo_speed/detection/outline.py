# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The moving part of a window: how far a vehicle extends, whatever it looks like.

The road beside a vehicle looks the same as in an earlier pair.  So columns of a window that have
changed show a vehicle, or background that it has uncovered since.  A column that moves with the
vehicle has changed both at its present and at its earlier place, looks the same at both, and does
not lie on the road as a shadow does.  What moves alike may still be another vehicle, farther away;
the views tell that by its depth, for all columns on one side of a front together.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray

from .config import MotionConfig
from .front_sampler import FrontHypothesis, FrontSampler, GRID_M
from .patch_kernels import Floats
from .pyramid import PairPyramids, Patches
from .temporal_match import Interval, Motion, OFF_SAMPLES
from ..vision.box_sums import window_sums
from ..vision.subpixel import parabola_peak

_BESIDE_M = 2.3  # half width of the window, as one lamp of a bus may be that far from the other
_SMOOTH = 3  # columns that are combined
_END = 5  # number of adjacent unmoving columns that end a moving part
_MORE = 2.0  # ratio of residuals from which on the smaller one is the better explanation


def moving_outline(sampler: FrontSampler, x_m: float, s_m: float, most_m: float,
                   interval: Interval, noise: float, config: MotionConfig
                   ) -> Optional[tuple[float, float]]:
    """
    Return middle and half width of the part of a window that has changed, off the road, m.

    :param sampler: sampler of a lane.
    :param x_m: middle of the window, m to the left of the path.
    :param s_m: arc length of its plane, m.
    :param most_m: greatest width, m; of a wider part, the section that has changed most is used.
    :param interval: the pair and an earlier one.
    :param noise: 1-sigma of a grey value.
    :param config: parameters.
    :return: None where nothing has changed.
    """
    half = round(_BESIDE_M / GRID_M)
    place = np.array([s_m]), np.array([x_m]), half
    now, before = (sampler.left(*place, pair)[0] for pair in (interval.now, interval.before))
    road = sampler.right(*place, interval.now, np.zeros(1), lying=True)[0]
    change, allowed = _change(now, _as_bright(before, now), noise)
    lain, _ = _change(now, _as_bright(road, now), noise)
    has = (change > config.change_factor * allowed) & (lain > _MORE * allowed)
    width = min(round(most_m / GRID_M), len(has))
    first = int(np.argmax(window_sums(np.where(has, change - allowed, 0.0)[None], width)[0]))
    inside = np.flatnonzero(has[first:first + width])
    if not len(inside):
        return None
    left, right = first + int(inside[0]) - half, first + int(inside[-1]) - half
    return x_m + (left + right) / 2 * GRID_M, (right - left) / 2 * GRID_M


class Extent(NamedTuple):
    """
    How far everything that moves with a front extends, m to the left of the front's middle.

    :param right_m: its right end.
    :param left_m: its left end.
    :param near_right_m: right end of the part that nothing static separates from the front.
    :param near_left_m: left end of that part.
    """

    right_m: float
    left_m: float
    near_right_m: float
    near_left_m: float

    @property
    def width_m(self) -> float:
        """Return the whole width, m."""
        return self.left_m - self.right_m


def going_extent(sampler: FrontSampler, front: FrontHypothesis, motion: Motion,
                 interval: Interval, noise: float, config: MotionConfig,
                 apart_m: float = math.inf) -> Extent:
    """
    Return how far everything extends that moves with a front and is not its shadow.

    What stands farther from the cameras than the front, by both views, is left out.

    Hidden columns beside it are included, as they may move with it: adjacent columns that show
    neither the front nor the background, such as where a pole stands in front, now or in the
    earlier pair.

    :param sampler: sampler of its lane.
    :param front: the front in the pair.
    :param motion: motion of the front from the earlier pair.
    :param interval: the pair and the earlier one.
    :param noise: 1-sigma of a grey value.
    :param config: parameters.
    :param apart_m: least shift of the right view by which something stands farther away, on the
        plane of the front, m.
    :return: the extent, without any width where nothing moves.
    """
    half = round(_BESIDE_M / GRID_M)
    s, x = np.array([front.s_m]), np.array([front.x_m])
    core = round(front.half_m / GRID_M)
    middle = slice(half - core, half + core + 1)
    here = _Window.of(sampler, front, half, middle, interval.now, noise)
    there = _Window.of(sampler, replace(
        front, s_m=front.s_m - motion.gone_m, x_m=front.x_m + motion.aside_m,
        ahead_m=interval.before.pair.right_lag_s * motion.speed_mps), half, middle,
        interval.before, noise)
    still = sampler.left(s, x, half, interval.before)[0]
    left = sampler.left(s - motion.gone_m, x + motion.aside_m, half, interval.now)[0]
    changed, allowed = _change(here.left, _as_bright(still, here.left), noise)
    changed_there, allowed_there = _change(there.left, _as_bright(left, there.left), noise)
    left_over, _ = _change(here.left, _matched(
        there.left, here.left[:, middle], there.left[:, middle]), noise)
    has_changed = changed > config.change_factor * allowed
    has_changed_there = changed_there > config.change_factor * allowed_there
    goes = (has_changed & (changed > _MORE * left_over)
            & has_changed_there & (here.standing < _MORE * np.maximum(here.lain, allowed)))
    other = _stands_farther(here, goes, middle, apart_m)
    goes &= ~other
    if not goes.any():
        return Extent(0.0, 0.0, 0.0, 0.0)
    # If one view is out of focus, even static background differs between the views in both pairs.
    unlike = max(min(here.unlike(~has_changed), there.unlike(~has_changed_there)), 1.0)
    here, there = (replace(window, allowed=unlike * window.allowed) for window in (here, there))
    stays = ~has_changed | (here.standing > _MORE * np.maximum(here.behind, here.allowed)) | (
        there.shows_behind & (left_over > _MORE * allowed))
    columns = np.flatnonzero(goes)
    first, last = int(columns[0]), int(columns[-1])
    from_, to = _reached(goes | ~(other | here.shows_behind & stays), middle)
    first = from_ if from_ < first - max(here.unseen, 0) else first
    last = to if to > last + max(-here.unseen, 0) else last
    return Extent(*(GRID_M * (column - half + end) for column, end in (
        (first, -0.5), (last, 0.5), (max(first, from_), -0.5), (min(last, to), 0.5))))


@dataclass(frozen=True, eq=False)
class _Window:
    """
    The columns of a window around a front in one pair.

    Differences between the views are sums of squares over a column.

    :param left: (rows, w) grey values of the left view.
    :param allowed: (w,) difference that noise and sampling explain.
    :param standing: (w,) difference if the column stands where the front does.
    :param lain: (w,) difference if the column lies on the road.
    :param farther: (k, w) differences if the column stands farther away, by more and more samples,
        and still.
    :param moving: the same if it moves as the front does.
    :param unseen: number of columns of road beside the front that the front hides in the right
        view: positive before its first column, negative after its last.
    """

    left: Patches
    allowed: Floats
    standing: Floats
    lain: Floats
    farther: Floats
    moving: Floats
    unseen: int

    @classmethod
    def of(cls, sampler: FrontSampler, front: FrontHypothesis, half: int, middle: slice,
           pair: PairPyramids, noise: float) -> _Window:
        """
        Return the window around a front in a pair.

        :param sampler: sampler of its lane.
        :param front: the front.
        :param half: columns from its middle to the edge of the window.
        :param middle: columns of the front in the window.
        :param pair: the pair.
        :param noise: 1-sigma of a grey value.
        """
        s, x, ahead = (np.array([v]) for v in (front.s_m, front.x_m, front.ahead_m))
        left = sampler.left(s, x, half, pair)[0]
        stands, lies = (sampler.right(s, x, half, pair, ahead, lying=lying)[0]
                        for lying in (False, True))
        farther, unseen = _farther(sampler, front, half, pair, np.zeros(1))

        def misfit(view: Patches) -> tuple[Floats, Floats]:
            return _change(left, _matched(view, left[:, middle], stands[:, middle]), noise)
        standing, allowed = misfit(stands)
        still = moving = np.array([misfit(view)[0] for view in farther])
        if ahead.any():
            moving = np.array([misfit(view)[0] for view in _farther(
                sampler, front, half, pair, ahead)[0]])
        return cls(left, allowed, standing, misfit(lies)[0], still, moving, unseen)

    @cached_property
    def behind(self) -> Floats:
        """Return the least difference (w,) if a column lies on the road or stands farther away."""
        return np.asarray(np.min([self.lain, *self.farther], axis=0))

    def unlike(self, still: NDArray[np.bool_]) -> float:
        """
        Return the ratio of the views' difference to what noise and sampling explain.

        :param still: (w,) columns that have not changed, most of which both views show.
        """
        return float(np.median(self.behind[still] / self.allowed[still])) if still.any() else 1.0

    @property
    def shows_behind(self) -> NDArray[np.bool_]:
        """Return which columns (w,) show the background behind the front."""
        return np.asarray(self.behind < _MORE * self.allowed)


def _stands_farther(here: _Window, goes: NDArray[np.bool_], middle: slice, apart_m: float
                    ) -> NDArray[np.bool_]:
    """
    Return which columns (w,) belong to something that moves, but stands farther than the front.

    On each side, these are all columns from the moving one nearest to the front outwards, or none.

    :param here: the window.
    :param goes: (w,) which columns move.
    :param middle: columns of the front.
    :param apart_m: least shift by which something stands farther away, m.
    """
    out = np.zeros(len(goes), dtype=bool)
    columns = np.flatnonzero(goes)
    right, left = columns[columns < middle.start], columns[columns >= middle.stop]
    for some, side in ((right, slice(0, int(right.max(initial=-1)) + 1)),
                       (left, slice(int(left.min(initial=len(goes))), None))):
        misfits = np.array([here.standing[some].sum(), *here.moving[:, some].sum(axis=1)])
        shift, _ = parabola_peak(-misfits)
        if shift * GRID_M > apart_m and misfits[0] > _MORE * misfits.min():
            out[side] = True
    return out


def _farther(sampler: FrontSampler, front: FrontHypothesis, half: int, now: PairPyramids,
             ahead_m: Floats) -> tuple[list[Patches], int]:
    """
    Return windows of the right view for objects at greater ranges than the front.

    On the plane of the front, objects shift by the baseline from just behind it to the horizon.

    :param sampler: sampler of its lane.
    :param front: the front.
    :param half: columns from its middle to the edge of the windows.
    :param now: the pair.
    :param ahead_m: (1,) distance that they travel until the right view is exposed, m.
    :return: the windows; and the number of columns of road beside the front that the front hides
        in the right view, positive before its first column.
    """
    s, x = np.array([front.s_m]), np.array([front.x_m])
    rates = sampler.geometry.rates(s)
    shift, range_m, climb = (float(v[0]) for v in (rates.shift, rates.ahead_m, rates.climb))
    to_horizon = math.ceil(abs(shift * range_m) / GRID_M)
    most = max(to_horizon, 2)  # at least, to interpolate
    wide = sampler.right(s, x, half + most, now, ahead_m)[0]
    way = 1 if shift * range_m > 0 else -1  # farther away is back along a lane that approaches
    road_m = abs(sampler.heights_m[0] / climb)  # hidden road behind the front, by its upper edge
    strip = math.ceil(to_horizon * road_m / (abs(range_m) + road_m))
    return [wide[:, most + way * k:][:, :2 * half + 1] for k in range(1, most + 1)], way * strip


def _reached(may: NDArray[np.bool_], middle: slice) -> tuple[int, int]:
    """
    Return the first and last column that are connected to the middle by columns that may move.

    Gaps of fewer than ``_END`` columns are bridged, as they occur by chance.

    :param may: (w,) which columns may move with the front.
    :param middle: columns of the front.
    """
    ends = np.convolve(~may, np.ones(_END), 'same') == _END
    before, after = (np.flatnonzero(part) for part in (ends[:middle.start], ends[middle.stop:]))
    reach = _END // 2  # from the centre of each end to its edge
    return (int(before[-1]) + reach + 1 if len(before) else 0,
            middle.stop + int(after[0]) - reach - 1 if len(after) else len(may) - 1)


def _change(now: Patches, then: Patches, noise: float) -> tuple[Floats, Floats]:
    """Return squared differences (w,) of columns, and the part that noise and sampling explain."""
    steep = np.square(np.gradient(now)).sum(axis=0)
    columns = np.square(now - then), 2 * noise ** 2 + OFF_SAMPLES ** 2 * steep
    change, allowed = (np.convolve(v.sum(axis=0), np.ones(_SMOOTH), 'same') for v in columns)
    return change, allowed


def _as_bright(other: Patches, now: Patches) -> Patches:
    """Return a window scaled to the median brightness of another one, mostly of the same scene."""
    return np.asarray(other * (np.median(now) / max(float(np.median(other)), 1.0)))


def _matched(values: Patches, to: Patches, part: Patches) -> Patches:
    """Return values with gain and level such that a part of them matches another patch."""
    gain = to.std() / max(float(part.std()), 1.0)
    return np.asarray((values - part.mean()) * gain + to.mean())
