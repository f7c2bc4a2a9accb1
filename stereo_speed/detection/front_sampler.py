# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Samples both views on upright planes across a lane."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .lane_geometry import LaneGeometry
from .patch_kernels import Floats
from .pyramid import level_of, LEVELS, PairPyramids, Patches, Pyramid
from ..core.records import Array

GRID_M = 0.03  # spacing of samples across the lane
ROWS = 9  # samples over the height of a front


@dataclass(frozen=True)
class FrontHypothesis:
    """
    A possible front on a plane across the lane.

    :param s_m: arc length, m.
    :param x_m: offset of its middle to the left of the path, m.
    :param half_m: half of its width, m.
    :param ahead_m: distance travelled along the lane until the right view is exposed, m.
    :param cross_ncc: left-right correlation, with the mean of each row removed.
    :param symmetry: correlation with its mirror image, mean of both views.
    """

    s_m: float
    x_m: float
    half_m: float
    ahead_m: float = 0.0
    cross_ncc: float = 0.0
    symmetry: float = 0.0


class FrontSampler:
    """
    Samples windows at the height of fronts.

    :param geometry: the lane.
    :param low_m: height above the road of the lower edge of the windows, m.
    :param high_m: height above the road of the upper edge of the windows, m.
    """

    def __init__(self, geometry: LaneGeometry, low_m: float, high_m: float) -> None:
        self.geometry = geometry
        self.heights_m = np.linspace(high_m, low_m, ROWS)

    def left(self, s_m: Floats, x_m: Floats, half: int, pair: PairPyramids, stride: int = 1,
             coarser: int = 0) -> Patches:
        """
        Return windows of planes in the left view.

        :param s_m: (n,) arc lengths of the planes, m.
        :param x_m: (n,) offsets of the middles of the windows, m.
        :param half: samples from the middle to the edge, a multiple of the stride.
        :param pair: the pair.
        :param stride: step of the samples along both axes.
        :param coarser: number of pyramid levels coarser than the one that suits the samples.
        :return: (n, rows, 2 half + 1), or fewer samples by the stride.
        """
        uv = self.geometry.left_pixels(s_m, x_m, _reach(half, stride), self.heights_m[::stride])
        return _sampled(self._levels(s_m, coarser), uv, pair.left)

    def right(self, s_m: Floats, x_m: Floats, half: int, pair: PairPyramids, ahead_m: Floats,
              stride: int = 1, lying: bool = False, coarser: int = 0) -> Patches:
        """
        Return windows of planes in the right view.

        Further arguments are those of :meth:`left`.

        :param ahead_m: (n,) distances travelled until the right view is exposed, m.
        :param lying: whether to sample the points of the road that the left camera sees through
            the planes, instead of the planes.
        """
        uv = self.geometry.right_pixels(s_m, x_m, _reach(half, stride), self.heights_m[::stride],
                                        ahead_m, lying)
        return _sampled(self._levels(s_m, coarser), uv, pair.right)

    def both(self, s_m: Floats, x_m: Floats, half: int, pair: PairPyramids, ahead_m: Floats,
             stride: int = 1) -> Patches:
        """Return the windows of the left view, with those of the right view as further rows."""
        levels = self._levels(s_m, 0)
        views = [_sampled(levels, uv, view) for uv, view in zip(
            self.geometry.both_pixels(s_m, x_m, _reach(half, stride), self.heights_m[::stride],
                                      ahead_m), (pair.left, pair.right))]
        return np.concatenate(views, axis=1)

    def _levels(self, s_m: Floats, coarser: int) -> NDArray[np.int64]:
        """Return the pyramid levels (n,) for planes, coarser by a number of levels."""
        return np.minimum(level_of(self.geometry.px_per_m(s_m) * GRID_M) + coarser, LEVELS - 1)


def _sampled(levels: NDArray[np.int64], uv: Patches, view: Pyramid) -> Patches:
    """Return the samples of a view at pixels (n, rows, w, 2), each plane at its level."""
    several = set(levels.tolist())
    if len(several) == 1:
        return view.sample(uv, several.pop())
    out = np.empty(uv.shape[:3], np.float32)
    for level in several:
        out[levels == level] = view.sample(uv[levels == level], level)
    return out


def _reach(half: int, stride: int) -> Array:
    return np.arange(-half, half + 1, stride, dtype=np.float64) * GRID_M
