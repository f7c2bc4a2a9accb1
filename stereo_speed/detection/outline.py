# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What of a window moves: how far out from its middle a vehicle reaches, whatever it looks like.

The road beside a vehicle looks as it did in an earlier pair.  So columns of a window that have
changed show a vehicle, or what it has uncovered since.  What goes with it has changed where it is
and where it came from, looks here as it did there, and does not lie on the road as a shadow does.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Optional

import numpy as np
from numpy.typing import NDArray

from .config import MotionConfig
from .front_sampler import FrontHypothesis, FrontSampler, GRID_M
from .patch_kernels import Floats
from .pyramid import PairPyramids, Patches
from .temporal_match import Interval, Motion, OFF_SAMPLES
from ..vision.box_sums import window_sums

_BESIDE_M = 2.3  # the other lamp of a bus is so far from one of them
_SMOOTH = 3  # columns that are looked at together
_END = 5  # columns beside each other end what goes
_MORE = 2.0  # an explanation that leaves so many times less is the better one


def moving_outline(sampler: FrontSampler, x_m: float, s_m: float, most_m: float,
                   interval: Interval, noise: float, config: MotionConfig
                   ) -> Optional[tuple[float, float]]:
    """
    Return middle and half width of what has changed in a window and does not lie on the road, m.

    :param sampler: of a lane.
    :param x_m: middle of the window.
    :param s_m: arc length of its plane.
    :param most_m: greatest width; of what is wider, the part that has changed most.
    :param interval: the pair and an earlier one.
    :param noise: 1-sigma of a grey value.
    :param config: parameters.
    :return: None where there is nothing.
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


def going_width(sampler: FrontSampler, front: FrontHypothesis, motion: Motion,
                interval: Interval, noise: float, config: MotionConfig) -> float:
    """
    Return the width of all that goes with a front, and is no shadow of it, m.

    What is hidden beside it counts, too, for it may go with it: columns next to it that show
    neither it nor what is behind it, as where a pole stands in front, now or a moment ago.

    :param sampler: of its lane.
    :param front: in the pair.
    :param motion: of the front, from the earlier pair.
    :param interval: the pair and the earlier one.
    :param noise: 1-sigma of a grey value.
    :param config: parameters.
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
    if not goes.any():
        return 0.0
    # Of views of which one is out of focus neither pair shows alike what stands still.
    unlike = max(min(here.unlike(~has_changed), there.unlike(~has_changed_there)), 1.0)
    here, there = (replace(window, allowed=unlike * window.allowed) for window in (here, there))
    stays = ~has_changed | (here.standing > _MORE * np.maximum(here.behind, here.allowed)) | (
        there.shows_behind & (left_over > _MORE * allowed))
    columns = np.flatnonzero(goes)
    first, last = int(columns[0]), int(columns[-1])
    from_, to = _reached(goes | ~(here.shows_behind & stays), middle)
    first = from_ if from_ < first - max(here.unseen, 0) else first
    last = to if to > last + max(-here.unseen, 0) else last
    return (last - first + 1) * GRID_M


@dataclass(frozen=True, eq=False)
class _Window:
    """
    What a pair shows about a front.

    :param left: (rows, w) grey values of the left view.
    :param allowed: (w,) of the differences of a column, what explains itself.
    :param standing: (w,) difference from the right view, if it stands where the front does,
    :param lain: (w,) if it lies on the road, and
    :param behind: (w,) if it does, or stands farther away.
    :param unseen: columns of road beside the front that the right view does not show, for the
        front is before them: positive in front of its first column, else behind its last.
    """

    left: Patches
    allowed: Floats
    standing: Floats
    lain: Floats
    behind: Floats
    unseen: int

    @classmethod
    def of(cls, sampler: FrontSampler, front: FrontHypothesis, half: int, middle: slice,
           pair: PairPyramids, noise: float) -> _Window:
        """Return the columns up to half a width from the middle of a front, of that slice."""
        s, x, ahead = (np.array([v]) for v in (front.s_m, front.x_m, front.ahead_m))
        left = sampler.left(s, x, half, pair)[0]
        stands, lies = (sampler.right(s, x, half, pair, ahead, lying=lying)[0]
                        for lying in (False, True))
        farther, unseen = _farther(sampler, front, half, pair)
        misfits = [_change(left, _matched(view, left[:, middle], stands[:, middle]), noise)
                   for view in (stands, lies, *farther)]
        return cls(left, misfits[0][1], misfits[0][0], misfits[1][0],
                   np.min([misfit for misfit, _ in misfits[1:]], axis=0), unseen)

    def unlike(self, still: NDArray[np.bool_]) -> float:
        """
        Return how many times as much as noise and sampling explain the views differ.

        :param still: (w,) columns that have not changed: most show what both views do.
        """
        return float(np.median(self.behind[still] / self.allowed[still])) if still.any() else 1.0

    @property
    def shows_behind(self) -> NDArray[np.bool_]:
        """Return the columns (w,) that show what is behind the front."""
        return np.asarray(self.behind < _MORE * self.allowed)


def _farther(sampler: FrontSampler, front: FrontHypothesis, half: int, now: PairPyramids
             ) -> tuple[list[Patches], int]:
    """
    Return windows of the right view as what the left one shows would be seen farther away.

    From a little behind the front to the horizon it moves by the baseline, on the plane.

    :return: the windows; and how many columns of road beside the front the right view does not
        show, for the front is before them: positive in front of the first column of the front.
    """
    s, x = np.array([front.s_m]), np.array([front.x_m])
    rates = sampler.geometry.rates(s)
    shift, ahead_m, climb = (float(v[0]) for v in (rates.shift, rates.ahead_m, rates.climb))
    most = math.ceil(abs(shift * ahead_m) / GRID_M)
    wide = sampler.right(s, x, half + most, now, np.zeros(1))[0]
    way = 1 if shift > 0 else -1
    road_m = abs(sampler.heights_m[0] / climb)  # behind the front, through its upper edge
    strip = math.ceil(most * road_m / (ahead_m + road_m))
    return [wide[:, most + way * k:][:, :2 * half + 1] for k in range(1, most + 1)], way * strip


def _reached(may: NDArray[np.bool_], middle: slice) -> tuple[int, int]:
    """
    Return the first and the last column that is reached from the middle by such as may go with it.

    A few that may not, one here and one there, do so by chance.
    """
    ends = np.convolve(~may, np.ones(_END), 'same') == _END
    before, after = (np.flatnonzero(part) for part in (ends[:middle.start], ends[middle.stop:]))
    reach = _END // 2  # of the columns about each end
    return (int(before[-1]) + reach + 1 if len(before) else 0,
            middle.stop + int(after[0]) - reach - 1 if len(after) else len(may) - 1)


def _change(now: Patches, then: Patches, noise: float) -> tuple[Floats, Floats]:
    """Return the squares of the differences of columns, and what explains itself of them."""
    steep = np.square(np.gradient(now)).sum(axis=0)
    columns = np.square(now - then), 2 * noise ** 2 + OFF_SAMPLES ** 2 * steep
    change, allowed = (np.convolve(v.sum(axis=0), np.ones(_SMOOTH), 'same') for v in columns)
    return change, allowed


def _as_bright(other: Patches, now: Patches) -> Patches:
    """Return a window as bright as another one, most of which shows the same."""
    return np.asarray(other * (np.median(now) / max(float(np.median(other)), 1.0)))


def _matched(values: Patches, to: Patches, part: Patches) -> Patches:
    """Return grey values as they would be were a part of them as bright and rich as another."""
    gain = to.std() / max(float(part.std()), 1.0)
    return np.asarray((values - part.mean()) * gain + to.mean())
