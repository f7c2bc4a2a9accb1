# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Cuts across a line of the road, in a raw image.

A cut runs across the road at one arc length, so that metres along it are true metres: the middle
of a painted band is the middle in space, however askew the camera sees it. The image is read
through an interpolating cubic spline.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from ...core.records import Array
from ...road.fit import RoadFit

STEP_PX = 1.5  # between cuts
BORDER_PX = 3.0
_DENSE = 4000
_MIN_SINE = 0.12  # of the angle between the line and the cut in the image


class SplineImage:
    """
    An image that can be read between its pixels.

    :param image: (H, W).
    """

    def __init__(self, image: NDArray[np.float32]) -> None:
        self.shape = image.shape
        self._coefficients = spline_filter(image.astype(np.float32), order=3, output=np.float32)

    def __call__(self, uv_px: Array) -> Array:
        """Read it at (..., 2) pixels; NaN outside."""
        uv = np.nan_to_num(uv_px, nan=-1e6)
        values = map_coordinates(self._coefficients, [uv[..., 1], uv[..., 0]], order=3,
                                 prefilter=False, mode='nearest', output=np.float64)
        height, width = self.shape
        inside = ((uv >= 0) & (uv <= [width - 1, height - 1])).all(axis=-1)
        return np.where(inside, values, np.nan)


@dataclass(frozen=True, eq=False)
class Cuts:
    """
    Cuts across one line in one view.

    :param s_m: (n,) reference arc lengths.
    :param arc_px: (n,) length along the line in the image.
    :param uv_px: (n, 2) the line in the raw image.
    :param normal: (n, 2) across the line in the image, towards the road's left.
    :param px_per_m: (n,) across the line in the image, for a metre across the road.
    """

    s_m: Array
    arc_px: Array
    uv_px: Array
    normal: Array
    px_per_m: Array

    def take(self, where: NDArray[np.bool_]) -> Cuts:
        """Keep some."""
        return Cuts(self.s_m[where], self.arc_px[where], self.uv_px[where], self.normal[where],
                    self.px_per_m[where])


def cuts_along(fit: RoadFit, line: int, right: bool, ends_px: Array) -> Cuts:
    """
    Lay cuts evenly along a line in a view.

    :param fit: the road as it is known.
    :param line: number of the line.
    :param right: the right view.
    :param ends_px: (2, 2) where the line begins and ends.
    """
    feet = fit.foot(line, right, ends_px)
    s = np.linspace(feet.min(), feet.max(), _DENSE)
    uv = fit.seen(fit.points(line, s, np.zeros_like(s)), right)
    seen = np.isfinite(uv).all(axis=-1)
    s, uv = s[seen], uv[seen]
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(uv, axis=0), axis=-1))])
    count = max(int(arc[-1] / STEP_PX), 2)
    at = np.interp(np.linspace(0, arc[-1], count), arc, s)
    h = 0.02
    near = fit.seen(fit.points(line, at, np.tile([-h, 0.0, h], (count, 1))), right)
    along = fit.seen(fit.points(line, at + h, np.zeros(count)), right) - fit.seen(
        fit.points(line, at - h, np.zeros(count)), right)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    across = (near[:, 2] - near[:, 0]) / (2 * h)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    square = np.sum(normal * across, axis=-1)
    normal, square = normal * np.sign(square)[:, None], np.abs(square)
    camera = fit.problem.rig.right if right else fit.problem.rig.left
    size = np.array([camera.width_px, camera.height_px])
    good = ((near[:, 1] >= BORDER_PX) & (near[:, 1] <= size - 1 - BORDER_PX)).all(axis=-1)
    good &= square > _MIN_SINE * np.linalg.norm(across, axis=-1)
    return Cuts(at, np.linspace(0, arc[-1], count), near[:, 1], normal, square).take(good)


def read_cuts(image: SplineImage, fit: RoadFit, line: int, right: bool, cuts: Cuts,
              across_m: Array) -> Array:
    """
    Read the image along cuts.

    :param across_m: (n, k) places on the cuts, m from the line.
    :return: (n, k) grey levels, NaN outside the image.
    """
    return image(fit.seen(fit.points(line, cuts.s_m, across_m), right))
