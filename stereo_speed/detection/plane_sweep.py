# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A plane sweep along a lane: where something upright that moves may stand.

The lane is covered with upright planes across it, each sampled in both views by maps that are
made once.  A window of such a plane that looks other than in an earlier pair, and has texture, is
compared with the right view, shifted by a few samples either way.  The shift at which they agree
best says how far in truth the thing is from that plane, and at which height: what lies on the road
is shifted most, the lower part of a vehicle's front votes for the plane it stands on.

A right view that is exposed later shows a vehicle further along the lane.  How far is not known
yet, so the sweep is repeated for a few speeds, and the best votes of all of them count.
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

_GRID_M = 0.04  # between samples across
_ROWS = 6  # samples up the front
_SHIFTS = 3  # samples either way
_WINDOW_M = 1.4  # less than the width of a car, so that a window sees nothing beside it
_PLANE_SHIFT_M = 0.012  # a step between planes shifts the right view by this
_EVERY = 4  # windows start at one of so many samples
_LEAST_SQUARE = 1e-3  # of a window: a flat one must not divide by zero
_ABOVE_BELOW_M = 0.25  # a vote for a height so far off the front may still be for it
_LOWEST_M = -0.25  # a vote for a height below this is for something nearer
_APART_X_M = 1.0  # two proposals are this far from each other across,
_APART_S_SHARE = 0.06  # or along the lane by this share of their distance
_SPEED_SHIFT_M = 0.08  # a step between speeds shifts a right view that is exposed later by this


@dataclass(frozen=True)
class Proposal:
    """
    A place where a front may stand.

    :param s_m: arc length, m.
    :param x_m: offset of its middle to the left of the path, m.
    :param half_m: half of the width that is looked at first, m.
    :param ahead_m: how far it has gone on along the lane when the right view is exposed, m.
    :param votes: how many windows say so.
    """

    s_m: float
    x_m: float
    half_m: float = 0.9
    ahead_m: float = 0.0
    votes: float = 0.0


@dataclass(frozen=True, eq=False)
class _Windows:
    """
    Samples of planes, and of each window over them the sum, and that of squares about its mean.

    :param values: (n, rows, w) samples.
    :param total: (n, windows).
    :param square: (n, windows).
    """

    values: Patches
    total: Floats
    square: Floats

    def take(self, planes: NDArray[np.int64]) -> _Windows:
        """Return those of some planes."""
        return _Windows(self.values[planes], self.total[planes], self.square[planes])


class PlaneSweep:
    """
    Maps of one lane, and the proposals in a pair.

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
        """Return what is looked at in the left and the right view, pixels of shape (..., 2)."""
        return self._left, self._right

    def proposals(self, now: PairPyramids, before: PairPyramids, noise: float) -> list[Proposal]:
        """
        Return where upright things that moved may stand, the best first.

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
        """Return how far, at each of the speeds tried, a vehicle goes in the lag, m."""
        if not lag_s:
            return np.zeros(1)
        limits = self.config.motion
        least_m, most_m = limits.least_speed_mps * lag_s, limits.greatest_speed_mps * lag_s
        shift_m = float(np.median(np.abs(self.rates.slide))) * abs(most_m - least_m)
        return np.linspace(least_m, most_m, max(math.ceil(shift_m / _SPEED_SHIFT_M), 2) + 1)

    def _right_pixels(self, planes: NDArray[np.int64], ahead_m: float) -> Patches:
        """Return the pixels of planes in the right view when it is exposed."""
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
        """Return the sums over the windows: (n, rows, w) to (n, windows)."""
        return window_sums(values.sum(axis=1), self._window)[:, self._starts]

    def _windows(self, values: Patches) -> _Windows:
        total = self._box(values)
        square = self._box(values * values) - total ** 2 / (self._window * _ROWS)
        return _Windows(values, total, np.maximum(square, _LEAST_SQUARE))

    def _ncc(self, a: _Windows, b: _Windows) -> Floats:
        """Return the correlation of each window with the same one of other samples."""
        mixed = self._box(a.values * b.values) - a.total * b.total / (self._window * _ROWS)
        return np.asarray(mixed / np.sqrt(a.square * b.square))

    def _shifts(self, left: _Windows, right: Patches) -> tuple[Floats, Floats]:
        """Return the best correlation of each window, and its shift in m; NaN at the ends."""
        width = left.values.shape[-1]
        ncc = np.stack([self._ncc(left, self._windows(right[..., k:k + width]))
                        for k in range(2 * _SHIFTS + 1)])
        place, best = parabola_peak(ncc)
        top = np.argmax(ncc, axis=0)
        inner = (top > 0) & (top < 2 * _SHIFTS)
        return best, np.where(inner, (place - _SHIFTS) * _GRID_M, np.nan)

    def _votes(self, planes: NDArray[np.int64], live: NDArray[np.bool_], ncc: Floats,
               shift_m: Floats) -> Floats:
        """Let each live window vote for the plane on which what it sees stands: (S, windows)."""
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
        """Take the best places one by one from votes (speeds, S, windows), with what is near."""
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
    """Return planes, each of which shifts the right view by as much as the next."""
    if len(seen) < 2:
        return np.zeros(0)
    steps = np.abs(geometry.rates(seen).shift) * np.gradient(seen)
    place = np.cumsum(steps)
    count = max(int((place[-1] - place[0]) / _PLANE_SHIFT_M), 2)
    return np.interp(np.linspace(place[0], place[-1], count), place, seen)
