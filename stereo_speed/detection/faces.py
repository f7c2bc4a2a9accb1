# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
From a seed to a face: its depth by both views, its middle by its symmetry.

Through a window at the height of bumpers one sees a front only from the plane it stands on, so
moving to the depth at which both views agree, and looking through that plane again, ends there.
Fronts and rears are symmetric; the axis tells their middle to a few centimetres.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from .config import DetectorConfig
from .lane_geometry import LaneGeometry
from .scan import Seed
from .views import level_of, PairViews, Patches, View

GRID_M = 0.03
ROWS = 9
_SHIFTS = 4
_ASIDE_M = 0.75  # the axis is sought this far to either side of the seed
_CLOSE_M = 0.15  # and so far when it is nearly found
_ROUNDS = 4
_LYING_SHIFTS = 1  # the road may be a little higher or lower than the path says
_SETTLED_M = 0.012  # in x of the right view
_LEAST_CONTRAST = 2.0


@dataclass(frozen=True)
class Face:
    """
    An upright, symmetric thing on a plane across the lane.

    :param s_m: arc length, m.
    :param x_m: offset of its axis to the left of the path, m.
    :param cross_ncc: left-right correlation where it stands upright.
    :param lying_ncc: left-right correlation were it to lie on the road.
    :param symmetry: correlation with its mirror image, mean of both views.
    :param contrast: standard deviation of its grey values.
    :param unsettled_m: what the right view's shift still is, m.
    """

    s_m: float
    x_m: float
    cross_ncc: float
    lying_ncc: float
    symmetry: float
    contrast: float
    unsettled_m: float


class FaceFinder:
    """
    Refines seeds of one lane.

    :param geometry: the lane.
    :param config: parameters.
    """

    def __init__(self, geometry: LaneGeometry, config: DetectorConfig) -> None:
        self.geometry = geometry
        self.heights_m = np.linspace(config.face_high_m, config.face_low_m, ROWS)
        self.half = round(config.face_width_m / 2 / GRID_M)  # window of 2 half + 1 samples

    def refine(self, seeds: Sequence[Seed], now: PairViews) -> list[Face]:
        """Refine seeds in one batch."""
        if not seeds:
            return []
        s = np.array([seed.s_m for seed in seeds])
        x = np.array([seed.x_m for seed in seeds])
        for turn in range(_ROUNDS):
            aside = round((_ASIDE_M if turn == 0 else _CLOSE_M) / GRID_M)
            found = self._look(s, x, aside, now)
            step = found[0] / self.geometry.rates(s).shift
            last = turn == _ROUNDS - 1
            x = found[1]
            if not last:
                s = s + step
        lying = self._lying(s, x, now)
        return [Face(*(float(v) for v in values)) for values in zip(
            s, x, found[2], lying, found[3], found[4], found[0])]

    def _lying(self, s_m: NDArray[np.float64], x_m: NDArray[np.float64], now: PairViews
               ) -> NDArray[np.float64]:
        """Correlate the views (n,) as if what is seen through the planes lay on the road."""
        left = self.windows(s_m, x_m, 0, now.left, False)
        right = self.windows(s_m, x_m, _LYING_SHIFTS, now.right, True, lying=True)
        width = left.shape[2]
        return np.stack([correlation(left, right[:, :, k:k + width])
                         for k in range(2 * _LYING_SHIFTS + 1)]).max(axis=0)

    def windows(self, s_m: NDArray[np.float64], x_m: NDArray[np.float64], more: int, view: View,
                right: bool, stride: int = 1, lying: bool = False) -> Patches:
        """
        Sample planes about x.

        :param s_m: (n,).
        :param x_m: (n,).
        :param more: samples beyond the window on either side.
        :param stride: 2 takes every other sample of both axes.
        :param lying: sample where the road is that is seen through the planes from the left.
        :return: (n, rows, 2 (half + more) + 1), or as many as the stride leaves.
        """
        reach = np.arange(-self.half - more, self.half + more + 1, stride) * GRID_M
        uv = self.geometry.pixels(s_m, x_m, reach, self.heights_m[::stride], right, lying)
        levels = level_of(self.geometry.rates(s_m).px_per_m * GRID_M)
        out = np.empty(uv.shape[:3], np.float32)
        for level in np.unique(levels):
            out[levels == level] = view.sample(uv[levels == level], int(level))
        return out

    def _look(self, s: NDArray[np.float64], x: NDArray[np.float64], aside: int, now: PairViews
              ) -> tuple[NDArray[np.float64], ...]:
        """Find shift, axis, correlation, symmetry and contrast (n,) at planes s about x."""
        left = self.windows(s, x, aside + _SHIFTS, now.left, False)
        right = self.windows(s, x, aside + _SHIFTS, now.right, True)
        width = 2 * self.half + 1
        mirrored = _symmetry(left, width) + _symmetry(right, width)  # (n, 2 (aside + shifts) + 1)
        inner = mirrored[:, _SHIFTS:mirrored.shape[1] - _SHIFTS] / 2
        best = np.argmax(inner, axis=1)
        rows = np.arange(len(s))
        start = best + _SHIFTS
        mine = _cut(left, start, width)
        scores = np.stack([correlation(mine, _cut(right, start + k, width))
                           for k in range(-_SHIFTS, _SHIFTS + 1)])
        shift, ncc = peak(scores)
        return ((shift - _SHIFTS) * GRID_M, x + (best - aside) * GRID_M, ncc, inner[rows, best],
                mine.std(axis=(1, 2)))


def _cut(values: Patches, start: NDArray[np.int64], width: int) -> Patches:
    """Cut columns ``start`` to ``start + width`` out of each of (n, rows, w)."""
    columns = start[:, None] + np.arange(width)
    return np.take_along_axis(values, columns[:, None, :], axis=2)


def correlation(a: Patches, b: Patches) -> NDArray[np.float64]:
    """Correlate patches (n, rows, w) one by one; those without contrast give 0."""
    a, b = (v - v.mean(axis=(1, 2), keepdims=True) for v in (a, b))
    floor = _LEAST_CONTRAST ** 2 / 4 * a[0].size
    size = np.sqrt(np.maximum((a * a).sum(axis=(1, 2)), floor)
                   * np.maximum((b * b).sum(axis=(1, 2)), floor))
    return np.asarray((a * b).sum(axis=(1, 2)) / size, dtype=np.float64)


def sliding_correlation(patch: Patches, wide: Patches) -> NDArray[np.float64]:
    """
    Correlate one patch with every window of its width in each of wider ones.

    :param patch: (rows, w).
    :param wide: (n, rows, w + k).
    :return: (n, k + 1).
    """
    rows, width = patch.shape
    count = patch.size
    floor = _LEAST_CONTRAST ** 2 / 4 * count
    centred = patch - patch.mean()
    mixed = np.stack([np.einsum('nrw,rw->n', wide[:, :, k:k + width], centred)
                      for k in range(wide.shape[2] - width + 1)], axis=1)
    total, square = (_sums(v, width) for v in (wide, wide * wide))
    spread = np.maximum(square - total ** 2 / count, floor)
    return mixed / np.sqrt(spread * max(float((centred ** 2).sum()), floor))


def _sums(values: Patches, width: int) -> NDArray[np.float64]:
    """Sum over all windows of a width: (n, rows, w + k) to (n, k + 1)."""
    total = np.cumsum(values.sum(axis=1), axis=-1, dtype=np.float64)
    total = np.concatenate([np.zeros((len(total), 1)), total], axis=1)
    return total[:, width:] - total[:, :-width]


def _symmetry(values: Patches, width: int) -> NDArray[np.float64]:
    """Correlate each window of a width with its mirror image: (n, rows, w) to (n, windows)."""
    every = sliding_window_view(values, width, axis=2)  # (n, rows, windows, width)
    half = width // 2
    total, square = every.sum(axis=(1, 3)), np.einsum('nrwk,nrwk->nw', every, every)
    count = width * values.shape[1]
    front, back = every[..., :half], every[..., :half:-1]
    mixed = 2 * np.einsum('nrwk,nrwk->nw', front, back) + np.einsum(
        'nrw,nrw->nw', every[..., half], every[..., half])
    mean = total ** 2 / count
    floor = _LEAST_CONTRAST ** 2 / 4 * count
    return np.asarray((mixed - mean) / np.maximum(square - mean, floor), dtype=np.float64)


def peak(scores: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """
    Find the place of the greatest score along the first axis, to a fraction, and the score.

    :param scores: (k, n).
    """
    top = np.argmax(scores, axis=0)
    inner = np.clip(top, 1, len(scores) - 2)
    low, mid, high = (np.take_along_axis(scores, inner[None] + k, axis=0)[0] for k in (-1, 0, 1))
    bend = np.minimum(low - 2 * mid + high, -1e-9)
    part = np.clip((low - high) / (2 * bend), -1.0, 1.0)
    return np.where(top == inner, inner + part, top), scores.max(axis=0)
