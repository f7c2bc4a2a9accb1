# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A plane sweep along a lane: proposes places where something upright and moving may stand.

The lane is covered with upright planes across it, each of which is sampled in both views by
precomputed maps.  A window of a plane that has texture and differs from an earlier pair is
compared with the right view, shifted by a few samples either way.  The best shift gives the true
distance of the object from that plane, and its height: objects on the road are shifted most, while
the lower part of a vehicle's front votes for the plane on which it stands.

A right view that is exposed later shows a vehicle further along the lane.  As that distance is
not known yet, the sweep is repeated for a few speeds, and the best votes of all of them count.
"""
from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from .config import DetectorConfig
from .lane_geometry import LaneGeometry
from .patch_kernels import Floats
from .pyramid import level_of, PairPyramids, Patches, Pyramid
from ..vision.box_sums import window_sums
from ..vision.subpixel import parabola_peak

_GRID_M = 0.04  # spacing of samples across the lane
_ROWS = 6  # samples over the height of the front
_SHIFTS = 3  # greatest shift either way, in samples
_WINDOW_M = 1.4  # width of a window, less than that of a car
_PLANE_SHIFT_M = 0.012  # shift of the right view from one plane to the next
_EVERY = 4  # step between windows, in samples
_LEAST_SQUARE = 1e-3  # least sum of squares of a window; avoids a division by zero
_ABOVE_BELOW_M = 0.25  # greatest height above the front that a window may vote for
_LOWEST_M = -0.25  # votes for a lower height belong to something nearer
_APART_X_M = 1.0  # least distance of two proposals across the lane
_APART_S_SHARE = 0.06  # least distance of two proposals along the lane, as a share of the range
_SPEED_SHIFT_M = 0.08  # shift of a later right view from one trial speed to the next


@dataclass(frozen=True)
class Proposal:
    """
    A place where a front may stand.

    :param s_m: arc length, m.
    :param x_m: offset of its middle to the left of the path, m.
    :param half_m: half of the initial width, m.
    :param ahead_m: distance travelled along the lane until the right view is exposed, m.
    :param votes: weighted number of windows that vote for it.
    """

    s_m: float
    x_m: float
    half_m: float = 0.9
    ahead_m: float = 0.0
    votes: float = 0.0


@dataclass(frozen=True, eq=False)
class _Windows:
    """
    Samples of planes, with the sums of windows over them.

    :param values: (n, rows, w) samples.
    :param total: (n, windows) sums.
    :param square: (n, windows) sums of squares about the mean of each window.
    """

    values: Patches
    total: Floats
    square: Floats

    def take(self, planes: NDArray[np.int64]) -> _Windows:
        """Return the windows of some planes."""
        return _Windows(self.values[planes], self.total[planes], self.square[planes])


class PlaneSweep:
    """
    Proposes fronts on one lane by precomputed maps.

    :param geometry: the lane.
    :param config: parameters.
    """

    def __init__(self, geometry: LaneGeometry, config: DetectorConfig) -> None:
        self.geometry, self.config = geometry, config
        front = config.front
        self._heights_m = np.linspace(front.high_m, front.low_m, _ROWS)
        seen = geometry.seen(config.sweep.least_px_per_m, _WINDOW_M, self._heights_m)
        self.s_m = _planes(geometry, seen)
        half = front.reach_m + _WINDOW_M / 2
        self.x_m = np.arange(-half, half + _GRID_M / 2, _GRID_M)
        more = _GRID_M * np.arange(1, _SHIFTS + 1)
        self._wide_m = np.concatenate([self.x_m[0] - more[::-1], self.x_m, self.x_m[-1] + more])
        self._left = self._right = np.zeros((0, 1, 1, 2), np.float32)
        if not len(self.s_m):
            return
        left = geometry.project(self.s_m, self.x_m, self._heights_m)[0]
        right = geometry.project(self.s_m, self._wide_m, self._heights_m)[1]
        self._left, self._right = (np.nan_to_num(uv, nan=-1e4).astype(np.float32)
                                   for uv in (left, right))
        self.rates = geometry.rates(self.s_m)
        self.level = level_of(self.rates.px_per_m * _GRID_M)
        self.depth_m = np.linalg.norm(geometry.lane.path.position(self.s_m), axis=-1)
        self._window = round(_WINDOW_M / _GRID_M)
        self._starts = np.arange(0, len(self.x_m) - self._window + 1, _EVERY)
        self.middle_m = self.x_m[self._starts] + (self._window - 1) * _GRID_M / 2

    @property
    def pixels(self) -> tuple[Patches, Patches]:
        """Return what is sampled in the left and the right view, pixels of shape (..., 2)."""
        return self._left, self._right

    def proposals(self, now: PairPyramids, before: PairPyramids, noise: float) -> list[Proposal]:
        """
        Return proposals of upright, moving fronts, the best first.

        :param now: the pair.
        :param before: an earlier pair.
        :param noise: 1-sigma of a grey value.
        """
        if not len(self.s_m):
            return []
        limits = self.config.sweep
        every = np.arange(len(self.s_m))
        left, earlier = (self._windows(self._sample(v.left, self._left, every))
                         for v in (now, before))
        still = self._ncc(left, earlier)
        contrast = np.sqrt(left.square / (self._window * _ROWS))
        live = (still < limits.still_ncc) & (
            contrast > max(limits.least_contrast, limits.noise_factor * noise))
        planes = np.flatnonzero(live.any(axis=1))
        if not len(planes):
            return []
        seen, ahead_m = left.take(planes), self._ahead_m(now.pair.right_lag_s)
        votes = np.zeros((len(ahead_m), len(self.s_m), len(self.middle_m)))
        for k, gone_m in enumerate(ahead_m):
            right = self._sample(now.right, self._right_pixels(planes, gone_m), planes)
            best, shift_m = self._shifts(seen, right)
            votes[k] = self._votes(planes, live[planes] & (best > limits.least_ncc), best, shift_m)
        return self._peaks(votes, ahead_m)

    def _ahead_m(self, lag_s: float) -> Floats:
        """Return the distance travelled during the lag at each trial speed, m."""
        if not lag_s:
            return np.zeros(1)
        limits = self.config.motion
        least_m, most_m = limits.least_speed_mps * lag_s, limits.greatest_speed_mps * lag_s
        shift_m = float(np.median(np.abs(self.rates.slide))) * abs(most_m - least_m)
        return np.linspace(least_m, most_m, max(math.ceil(shift_m / _SPEED_SHIFT_M), 2) + 1)

    def _right_pixels(self, planes: NDArray[np.int64], ahead_m: float) -> Patches:
        """Return the pixels of planes in the right view at the time of its exposure."""
        if not ahead_m:
            return self._right[planes]
        count = len(planes)
        return self.geometry.right_pixels(
            self.s_m[planes], np.zeros(count), self._wide_m, self._heights_m,
            np.full(count, ahead_m))

    def _sample(self, view: Pyramid, uv: Patches, planes: NDArray[np.int64]) -> Patches:
        """Sample a view at the pixels (n, rows, w, 2) of planes (n,)."""
        out = np.empty(uv.shape[:3], np.float32)
        for level in np.unique(self.level[planes]):
            mine = self.level[planes] == level
            out[mine] = view.sample(uv[mine], int(level))
        return out

    def _box(self, values: Patches) -> Floats:
        """Return the sums (n, windows) of samples (n, rows, w) over windows."""
        return window_sums(values.sum(axis=1), self._window)[:, self._starts]

    def _windows(self, values: Patches) -> _Windows:
        total = self._box(values)
        square = self._box(values * values) - total ** 2 / (self._window * _ROWS)
        return _Windows(values, total, np.maximum(square, _LEAST_SQUARE))

    def _ncc(self, a: _Windows, b: _Windows) -> Floats:
        """Return the correlation of each window with the same window of other samples."""
        mixed = self._box(a.values * b.values) - a.total * b.total / (self._window * _ROWS)
        return np.asarray(mixed / np.sqrt(a.square * b.square))

    def _shifts(self, left: _Windows, right: Patches) -> tuple[Floats, Floats]:
        """Return the best correlation of each window, and its shift, m; NaN at the ends."""
        width = left.values.shape[-1]
        ncc = np.stack([self._ncc(left, self._windows(right[..., k:k + width]))
                        for k in range(2 * _SHIFTS + 1)])
        place, best = parabola_peak(ncc)
        top = np.argmax(ncc, axis=0)
        inner = (top > 0) & (top < 2 * _SHIFTS)
        return best, np.where(inner, (place - _SHIFTS) * _GRID_M, np.nan)

    def _votes(self, planes: NDArray[np.int64], live: NDArray[np.bool_], ncc: Floats,
               shift_m: Floats) -> Floats:
        """Return the votes (S, windows) of live windows for the planes that objects stand on."""
        votes = np.zeros((len(self.s_m), len(self.middle_m)))
        further_m = shift_m / self.rates.shift[planes][:, None]
        height = float(self._heights_m.mean()) + self.rates.climb[planes][:, None] * further_m
        with np.errstate(invalid='ignore'):
            good = live & (height > _LOWEST_M) & (
                height < self.config.front.high_m + _ABOVE_BELOW_M)
        i, j = np.nonzero(good)
        at = np.interp(self.s_m[planes[i]] + further_m[i, j], self.s_m,
                       np.arange(len(self.s_m)), left=-1.0, right=-1.0)
        inside = at >= 0
        np.add.at(votes, (np.round(at[inside]).astype(int), j[inside]), ncc[i, j][inside])
        return votes

    def _peaks(self, votes: Floats, ahead_m: Floats) -> list[Proposal]:
        """Return the best places of votes (speeds, S, windows), one per neighbourhood."""
        smooth = votes.copy()
        smooth[:, 1:] += votes[:, :-1]
        smooth[:, :-1] += votes[:, 1:]
        sums = smooth.copy()
        sums[..., 1:] += 0.5 * smooth[..., :-1]
        sums[..., :-1] += 0.5 * smooth[..., 1:]
        best, speed = sums.max(axis=0), np.argmax(sums, axis=0)
        out: list[Proposal] = []
        while len(out) < self.config.sweep.most_proposals:
            i, j = np.unravel_index(int(np.argmax(best)), best.shape)
            if best[i, j] < self.config.sweep.least_votes:
                break
            out.append(Proposal(float(self.s_m[i]), float(self.middle_m[j]),
                                ahead_m=float(ahead_m[speed[i, j]]), votes=float(best[i, j])))
            near_s = np.abs(self.s_m - self.s_m[i]) < _APART_S_SHARE * self.depth_m[i]
            near_x = np.abs(self.middle_m - self.middle_m[j]) < _APART_X_M
            best[np.ix_(near_s, near_x)] = 0
        return out


def _planes(geometry: LaneGeometry, seen: Floats) -> Floats:
    """Return the arc lengths of planes that are equally spaced in shift of the right view."""
    if len(seen) < 2:
        return np.zeros(0)
    steps = np.abs(geometry.rates(seen).shift) * np.gradient(seen)
    place = np.cumsum(steps)
    count = max(int((place[-1] - place[0]) / _PLANE_SHIFT_M), 2)
    return np.interp(np.linspace(place[0], place[-1], count), place, seen)
