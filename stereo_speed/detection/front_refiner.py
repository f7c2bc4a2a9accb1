# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
From a seed to a face: its depth by both views, its middle and its width by its symmetry.

Through a window at the height of bumpers one sees a front only from the plane it stands on, so
moving to the depth at which both views agree, and looking through that plane again, ends there.
Fronts and rears are symmetric: the axis tells their middle to a few centimetres, and the outermost
edges that are mirrored and stand at the same depth tell their width.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np
from numpy.typing import NDArray

from .lane_geometry import LaneGeometry
from .patches import correlate, cut, Floats, level_rows, mirrored, peak
from .plane_sweep import Proposal
from .pyramid import level_of, PairPyramids, Patches, View

GRID_M = 0.03
ROWS = 9
HALF = 42  # samples from the axis to the edge of the window: lorries are as wide
_SHIFTS = 4
_FIRST_HALF_M = 0.9  # as much is looked at before the width is known
_ASIDE_M, _CLOSE_M = 1.4, 0.3  # the axis is sought this far to either side: first, and later
_MIDDLE = 25  # samples from the axis to the edge of what tells the axis then
_STRIDE = 2
_DARK = 16.0
_ROUNDS = 5
_SETTLED_M = 0.006  # of x in the right view: the depth is found
_HOPELESS = 0.3  # correlations below this are no face nearby
_MOST_M = 8.0  # a step of depth is no longer
_SAME_S_M, _SAME_X_M = 1.5, 0.3  # faces nearer to each other are one
_ALIKE = 0.5  # edges of a face are alike by more than this, mirrored and in the other view
_OFF_AXIS = 2  # samples by which an edge may be nearer to the axis than its mirror image
_BAND = 3  # columns an edge takes
_WEAK_SHARE = 0.5  # weaker edges, as a share of the strongest, do not count
_LEAST_HALF_M = 0.45
_BEYOND_M = 0.06  # a face ends a little beyond its outermost strong edges, often those of lamps
_LYING_SHIFTS = 1  # the road may be a little higher or lower than the path says


@dataclass(frozen=True)
class FrontHypothesis:
    """
    An upright, symmetric thing on a plane across the lane.

    :param s_m: arc length, m.
    :param x_m: offset of its axis to the left of the path, m.
    :param half_m: half of its width, m.
    :param cross_ncc: left-right correlation of what varies across it.
    :param symmetry: correlation with its mirror image, mean of both views.
    :param contrast: standard deviation of its grey values about the mean of their row.
    """

    s_m: float
    x_m: float
    half_m: float
    cross_ncc: float
    symmetry: float
    contrast: float


class FrontRefiner:
    """
    Refines seeds of one lane.

    :param geometry: the lane.
    :param low_m: height above the road of the lower edge of what is looked at.
    :param high_m: height of its upper edge.
    :param least_width_m: what is narrower is none.
    """

    def __init__(self, geometry: LaneGeometry, low_m: float, high_m: float,
                 least_width_m: float) -> None:
        self.geometry, self.least_width_m = geometry, least_width_m
        self.heights_m = np.linspace(high_m, low_m, ROWS)

    def refine(self, seeds: Sequence[Proposal], now: PairPyramids, noise: float) -> list[FrontHypothesis]:
        """
        Refine seeds in one batch.

        :param noise: 1-sigma of a grey value.
        """
        s = np.array([seed.s_m for seed in seeds])
        x = np.array([seed.x_m for seed in seeds])
        half = np.full(len(s), _FIRST_HALF_M)
        out: list[FrontHypothesis] = []
        for turn in range(_ROUNDS):
            if not len(s):
                break
            if turn == 0:
                x = self._axis(s, x, now)
            x, shift, half, cross, symmetry, contrast = self._look(s, x, half, now, noise)
            settled = (np.abs(shift) < _SETTLED_M) & (turn > 0)
            done = settled & (2 * half >= self.least_width_m)
            if done.any():
                done[done] = np.abs(self._axis(s[done], x[done], now) - x[done]) < _CLOSE_M
            out += [FrontHypothesis(*map(float, f)) for f in zip(
                s[done], x[done], half[done], cross[done], symmetry[done], contrast[done])]
            s = s + np.clip(shift / self.geometry.rates(s).shift, -_MOST_M, _MOST_M)
            stay = np.flatnonzero(~settled & (cross > _HOPELESS) & (symmetry > _HOPELESS))
            stay = stay[_distinct(s[stay], x[stay], symmetry[stay])]
            s, x, half = s[stay], x[stay], half[stay]
        return out

    def lying_ncc(self, face: FrontHypothesis, now: PairPyramids) -> float:
        """Correlate the views as if what is seen through a face's plane lay on the road."""
        s, x = np.array([face.s_m]), np.array([face.x_m])
        half = round(face.half_m / GRID_M)
        left = level_rows(self.windows(s, x, half, now.left, False))
        right = self.windows(s, x, half + _LYING_SHIFTS, now.right, True, lying=True)
        width = left.shape[2]
        return max(float(correlate(left, level_rows(right[:, :, k:k + width]))[0])
                   for k in range(2 * _LYING_SHIFTS + 1))

    def windows(self, s_m: Floats, x_m: Floats, half: int, view: View, right: bool,
                stride: int = 1, lying: bool = False) -> Patches:
        """
        Sample planes about x.

        :param s_m: (n,).
        :param x_m: (n,).
        :param half: samples from the middle to the edge, a multiple of the stride.
        :param stride: 2 takes every other sample of both axes.
        :param lying: sample where the road is that is seen through the planes from the left.
        :return: (n, rows, 2 half + 1), or as many as the stride leaves.
        """
        reach = np.arange(-half, half + 1, stride, dtype=np.float64) * GRID_M
        uv = self.geometry.pixels(s_m, x_m, reach, self.heights_m[::stride], right, lying)
        levels = level_of(self.geometry.rates(s_m).px_per_m * GRID_M)
        out = np.empty(uv.shape[:3], np.float32)
        for level in np.unique(levels):
            out[levels == level] = view.sample(uv[levels == level], int(level))
        return out

    def _axis(self, s: Floats, x: Floats, now: PairPyramids) -> Floats:
        """
        Find the axes (n,) about which most of what is seen, as wide as a lorry, is mirrored.

        Not the share of it: each lamp is symmetric by itself.  Logarithms, lest lamps be all.
        """
        aside, half = round(_ASIDE_M / GRID_M / _STRIDE), HALF // _STRIDE
        both = np.log(np.maximum(self._both(s, x, (half + aside) * _STRIDE, now, _STRIDE), 0.0)
                      + _DARK)
        energy, _ = mirrored(both, 2 * half + 1)
        return np.asarray(x + (np.argmax(energy, axis=1) - aside) * _STRIDE * GRID_M)

    def _both(self, s: Floats, x: Floats, half: int, now: PairPyramids, stride: int) -> Patches:
        """Sample both views, the rows of the right one below those of the left."""
        return np.concatenate([self.windows(s, x, half, view, right, stride)
                               for view, right in ((now.left, False), (now.right, True))], axis=1)

    def _look(self, s: Floats, x: Floats, half_m: Floats, now: PairPyramids, noise: float
              ) -> tuple[Floats, ...]:
        """Find axis, shift, half width, correlation, symmetry and contrast (n,) of planes s."""
        aside = round(_CLOSE_M / GRID_M)
        both = self._both(s, x, HALF + aside + _SHIFTS, now, 1)
        moved = _middle_axis(both[:, :, HALF + _SHIFTS - _MIDDLE:_MIDDLE - HALF - _SHIFTS])
        x = x + (moved - aside) * GRID_M
        width, start = 2 * HALF + 1, moved + _SHIFTS
        left, right = cut(both[:, :ROWS], start, width), both[:, ROWS:]
        mask = _mask(half_m)
        mine = level_rows(left, mask)
        contrast = np.sqrt((mine ** 2).sum(axis=(1, 2)) / (ROWS * mask.sum(axis=1)))
        scores = np.stack([correlate(mine, level_rows(cut(right, start + k, width), mask))
                           for k in range(-_SHIFTS, _SHIFTS + 1)])
        place, ncc = peak(scores)
        matched = cut(right, start - _SHIFTS + np.round(place).astype(np.int64), width)
        half_m = np.minimum(_half_width(left, matched, noise) + _BEYOND_M, HALF * GRID_M)
        mask = _mask(half_m)
        symmetry = sum(correlate(v, v[:, :, ::-1]) for v in (
            level_rows(left, mask), level_rows(matched, mask))) / 2
        return x, (place - _SHIFTS) * GRID_M, half_m, ncc, np.asarray(symmetry), contrast


def _middle_axis(both: Patches) -> NDArray[np.int64]:
    """Find the windows (n,) in which the middle of a face is most symmetric."""
    found, most = mirrored(both, 2 * _MIDDLE + 1)
    return np.asarray(np.argmax(found / most, axis=1))


def _mask(half_m: Floats) -> NDArray[np.bool_]:
    """Mark the columns (n, 2 HALF + 1) within half a width (n,) of the axis."""
    columns = np.abs(np.arange(-HALF, HALF + 1)) * GRID_M
    return np.asarray(columns <= half_m[:, None] + 1e-9)


def _half_width(left: Patches, right: Patches, noise: float) -> Floats:
    """
    Find the outermost edges that are mirrored and that both views see at this depth.

    :param left: (n, rows, 2 HALF + 1).
    :param right: the same, already shifted to agree.
    :param noise: 1-sigma of a grey value; edges that may be noise do not count.
    :return: (n,) m; 0 where there are none.
    """
    views = [np.gradient(v, axis=2) for v in (left, right)]
    plus = [v[:, :, HALF:] for v in views]  # outwards from the axis
    minus = [-v[:, :, HALF::-1] for v in views]
    of_plus, of_minus = (_band(a, a) / 2 + _band(b, b) / 2 for a, b in (plus, minus))
    same = (_band(*plus) + _band(*minus)) / (of_plus + of_minus + 1e-6)
    alike = np.full(same.shape, -1.0)
    for k in range(-_OFF_AXIS, _OFF_AXIS + 1):
        mixed = np.mean([_band(a, np.roll(b, k, axis=2)) for a, b in zip(plus, minus)], axis=0)
        alike = np.maximum(alike, mixed / np.sqrt(of_plus * np.roll(of_minus, k, axis=1) + 1e-6))
    weaker = np.sqrt(np.minimum(of_plus, of_minus) / (ROWS * _BAND))
    weaker[:, :round(_LEAST_HALF_M / GRID_M)] = 0  # there is more on a face than its edges
    weaker[:, HALF - 1:] = 0
    alike = np.where((alike > _ALIKE) & (same > _ALIKE) & (weaker > noise), weaker, 0.0)
    good = alike > _WEAK_SHARE * alike.max(axis=1, keepdims=True)
    last = HALF - np.argmax(good[:, ::-1], axis=1)
    near = last[:, None] - np.arange(_BAND + 1)  # the band begins to see an edge before it
    edge = last - np.argmax(np.take_along_axis(weaker, np.maximum(near, 0), axis=1), axis=1)
    return np.asarray(np.where(good.any(axis=1), edge, 0) * GRID_M)


def _band(a: Patches, b: Patches) -> Floats:
    """Sum up products over the rows and a few columns: (n, rows, k) to (n, k)."""
    products = np.einsum('nrk,nrk->nk', a, b).astype(np.float64)
    out = products.copy()
    out[:, 1:] += products[:, :-1]
    out[:, :-1] += products[:, 1:]
    return np.asarray(out)


def _distinct(s_m: Floats, x_m: Floats, worth: Floats) -> list[int]:
    """Give the numbers of places that are not near a better one."""
    out: list[int] = []
    for k in np.argsort(-worth, kind='stable'):
        if all(abs(s_m[k] - s_m[j]) > _SAME_S_M or abs(x_m[k] - x_m[j]) > _SAME_X_M for j in out):
            out.append(int(k))
    return out
