# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Where along a lane something upright that moves may stand.

The lane is covered with upright planes across it, each sampled in both views by maps that are
made once.  A window of such a plane that looks other than in an earlier pair, and has texture, is
compared with the right view, shifted by a few samples either way.  The shift at which they agree
best says how far in truth the thing is from that plane, and at which height: what lies on the road
is shifted most, the lower part of a vehicle's front votes for the plane it stands on.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .config import DetectorConfig
from .lane_geometry import LaneGeometry
from .pyramid import level_of, PairPyramids, Patches, View

_GRID_M = 0.04  # between samples across
_ROWS = 6  # samples up the face
_SHIFTS = 3  # samples either way
_WINDOW_M = 1.4
_PLANE_SHIFT_M = 0.012  # a step between planes shifts the right view by this
_EVERY = 4  # windows start at every so manieth sample
_STILL_NCC = 0.75  # above this nothing has moved
_LEAST_NCC = 0.6
_LEAST_CONTRAST = 2.0  # grey levels; below it there is nothing but noise
_NOISE_TIMES = 1.2
_LEAST_VOTES = 1.5
_APART_X_M, _APART_S_SHARE = 1.0, 0.06  # two seeds are this far from each other
_MOST_SEEDS = 6


@dataclass(frozen=True)
class Proposal:
    """
    A place where a face may stand.

    :param s_m: arc length, m.
    :param x_m: offset of its middle to the left of the path, m.
    :param votes: how many windows say so.
    """

    s_m: float
    x_m: float
    votes: float


class PlaneSweep:
    """
    Maps of one lane, and its seeds in a pair.

    :param geometry: the lane.
    :param config: parameters.
    """

    def __init__(self, geometry: LaneGeometry, config: DetectorConfig) -> None:
        self.geometry = geometry
        heights = np.linspace(config.face_high_m, config.face_low_m, _ROWS)
        seen = geometry.seen(config.least_px_per_m, _WINDOW_M, heights)
        self.s_m = _planes(geometry, seen)
        half = config.reach_m + _WINDOW_M / 2
        self.x_m = np.arange(-half, half + _GRID_M / 2, _GRID_M)
        more = _GRID_M * np.arange(1, _SHIFTS + 1)
        wide = np.concatenate([self.x_m[0] - more[::-1], self.x_m, self.x_m[-1] + more])
        self.middle_height_m = float(heights.mean())
        self.low_m, self.high_m = -0.25, config.face_high_m + 0.25
        self._left = self._right = np.zeros((0, 1, 1, 2), np.float32)
        if not len(self.s_m):
            return
        left = geometry.project(self.s_m, self.x_m, heights)[0]
        right = geometry.project(self.s_m, wide, heights)[1]
        self._left, self._right = (np.nan_to_num(uv, nan=-1e4).astype(np.float32)
                                   for uv in (left, right))
        self.rates = geometry.rates(self.s_m)
        self.level = level_of(self.rates.px_per_m * _GRID_M)
        self.depth_m = np.linalg.norm(geometry.lane.path.position(self.s_m), axis=-1)
        self._window = round(_WINDOW_M / _GRID_M)
        starts = np.arange(0, len(self.x_m) - self._window + 1, _EVERY)
        self._starts = starts
        self.middle_m = self.x_m[starts] + (self._window - 1) * _GRID_M / 2

    @property
    def pixels(self) -> tuple[Patches, Patches]:
        """Pixels (..., 2) of the left and the right view that are looked at."""
        return self._left, self._right

    def seeds(self, now: PairPyramids, before: PairPyramids, noise: float) -> list[Proposal]:
        """
        Find where upright things that moved may stand.

        :param now: the pair.
        :param before: an earlier pair.
        :param noise: 1-sigma of a grey value.
        """
        if not len(self.s_m):
            return []
        left, earlier = (self._sample(v.left, self._left, np.arange(len(self.s_m)))
                         for v in (now, before))
        moments = self._moments(left)
        still = self._ncc(left, moments, earlier, self._moments(earlier))
        contrast = np.sqrt(moments[1] / (self._window * _ROWS))
        live = (still < _STILL_NCC) & (contrast > max(_LEAST_CONTRAST, _NOISE_TIMES * noise))
        rows = np.flatnonzero(live.any(axis=1))
        if not len(rows):
            return []
        right = self._sample(now.right, self._right, rows)
        best, shift_m = self._shifts(left[rows], (moments[0][rows], moments[1][rows]), right)
        return self._peaks(self._votes(rows, live[rows] & (best > _LEAST_NCC), best, shift_m))

    def _sample(self, view: View, uv: Patches, rows: NDArray[np.int64]) -> Patches:
        out = np.empty((len(rows), *uv.shape[1:3]), np.float32)
        for level in np.unique(self.level[rows]):
            mine = self.level[rows] == level
            out[mine] = view.sample(uv[rows[mine]], int(level))
        return out

    def _box(self, values: NDArray[np.float32]) -> NDArray[np.float64]:
        """Sum over the windows: (n, rows, w) to (n, windows)."""
        total = np.cumsum(values.sum(axis=1), axis=-1, dtype=np.float64)
        total = np.concatenate([np.zeros((len(total), 1)), total], axis=1)
        return total[:, self._starts + self._window] - total[:, self._starts]

    def _moments(self, values: NDArray[np.float32]) -> tuple[
            NDArray[np.float64], NDArray[np.float64]]:
        """Sum and sum of squares about the mean of each window."""
        total = self._box(values)
        square = self._box(values * values)
        return total, np.maximum(square - total ** 2 / (self._window * _ROWS), 1e-3)

    def _ncc(self, a: NDArray[np.float32], of_a: tuple[NDArray[np.float64], ...],
             b: NDArray[np.float32], of_b: tuple[NDArray[np.float64], ...]
             ) -> NDArray[np.float64]:
        mixed = self._box(a * b) - of_a[0] * of_b[0] / (self._window * _ROWS)
        return np.asarray(mixed / np.sqrt(of_a[1] * of_b[1]))

    def _shifts(self, left: Patches, moments: tuple[NDArray[np.float64], ...], right: Patches
                ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Greatest correlation of each window over the shifts, and the shift, m; NaN at ends."""
        width = left.shape[-1]
        scores = []
        for k in range(2 * _SHIFTS + 1):
            shifted = right[..., k:k + width]
            scores.append(self._ncc(left, moments, shifted, self._moments(shifted)))
        ncc = np.stack(scores)
        top = np.argmax(ncc, axis=0)
        inner = np.clip(top, 1, 2 * _SHIFTS - 1)
        low, mid, high = (np.take_along_axis(ncc, inner[None] + k, axis=0)[0]
                          for k in (-1, 0, 1))
        bend = np.minimum(low - 2 * mid + high, -1e-6)
        shift = (inner - _SHIFTS + np.clip((low - high) / (2 * bend), -1, 1)) * _GRID_M
        return mid, np.where(top == inner, shift, np.nan)

    def _votes(self, rows: NDArray[np.int64], live: NDArray[np.bool_],
               ncc: NDArray[np.float64], shift_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Let each live window vote for the plane on which what it sees stands: (S, windows)."""
        votes = np.zeros((len(self.s_m), len(self.middle_m)))
        further_m = shift_m / self.rates.shift[rows][:, None]
        height = self.middle_height_m + self.rates.climb[rows][:, None] * further_m
        with np.errstate(invalid='ignore'):
            good = live & (height > self.low_m) & (height < self.high_m)
        i, j = np.nonzero(good)
        at = np.interp(self.s_m[rows[i]] + further_m[i, j], self.s_m,
                       np.arange(len(self.s_m)), left=-1.0, right=-1.0)
        inside = at >= 0
        np.add.at(votes, (np.round(at[inside]).astype(int), j[inside]), ncc[i, j][inside])
        return votes

    def _peaks(self, votes: NDArray[np.float64]) -> list[Proposal]:
        """Take the best places one by one, each with its surroundings."""
        smooth = votes.copy()
        smooth[1:] += votes[:-1]
        smooth[:-1] += votes[1:]
        sums = smooth.copy()
        sums[:, 1:] += 0.5 * smooth[:, :-1]
        sums[:, :-1] += 0.5 * smooth[:, 1:]
        out: list[Proposal] = []
        while len(out) < _MOST_SEEDS:
            i, j = np.unravel_index(int(np.argmax(sums)), sums.shape)
            if sums[i, j] < _LEAST_VOTES:
                break
            out.append(Proposal(float(self.s_m[i]), float(self.middle_m[j]), float(sums[i, j])))
            near_s = np.abs(self.s_m - self.s_m[i]) < _APART_S_SHARE * self.depth_m[i]
            near_x = np.abs(self.middle_m - self.middle_m[j]) < _APART_X_M
            sums[np.ix_(near_s, near_x)] = 0
        return out


def _planes(geometry: LaneGeometry, seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Choose planes so that each shifts the right view by as much as the next."""
    if len(seen) < 2:
        return np.zeros(0)
    steps = np.abs(geometry.rates(seen).shift) * np.gradient(seen)
    place = np.cumsum(steps)
    count = max(int((place[-1] - place[0]) / _PLANE_SHIFT_M), 2)
    return np.interp(np.linspace(place[0], place[-1], count), place, seen)
