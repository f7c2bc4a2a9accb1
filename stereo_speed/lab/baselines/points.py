# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Points on a vehicle's front in both views, the common part of all sources of points.

A source finds points in a pair near the expected front, matches them left to right, and recognises
those that it found before.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from ...core.records import Array, StereoPair
from ...geometry.rig import StereoRig
from ...vision.sampling import crop

_MARGIN_PX = 12  # margin around a region, because points at its edges need surroundings

Grey = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class ExpectedFront:
    """
    The expected position of a front.

    :param left: (4, 2), expected corners in the raw left view, px.
    :param right: (4, 2), the same in the raw right view.
    :param before: (4, 2), its corners in the left view of the last pair in which it was seen.
    :param slack_px: greatest error of the expectation.
    """

    left: Array
    right: Array
    before: Array
    slack_px: float

    @property
    def width_px(self) -> float:
        """Return the width of the expected front."""
        return float(np.ptp(self.left[:, 0]))


@dataclass(frozen=True, eq=False)
class Points:
    """
    Points of one pair.

    :param ids: (n,), ids, which a point keeps from pair to pair.
    :param left: (n, 2), raw left pixels.
    :param right: (n, 2), raw right pixels; NaN where there is no match.
    """

    ids: NDArray[np.int64]
    left: Array
    right: Array

    @property
    def matched(self) -> NDArray[np.bool_]:
        """Return a mask (n,) of the points matched in both views."""
        return np.asarray(np.isfinite(self.right).all(axis=1))

    def only(self, keep: NDArray[np.bool_]) -> Points:
        """Return the points of a mask."""
        return Points(self.ids[keep], self.left[keep], self.right[keep])


class PointSource(Protocol):
    """Finds points in pair after pair."""

    def observe(self, pair: StereoPair, expected: ExpectedFront) -> Points:
        """Return the points of a pair of 8-bit images, including those already known."""


def crop_around(image: Grey, corners: Array, margin_px: float) -> tuple[Grey, Array]:
    """
    Return a contiguous region of an image, and its origin (2,), px.

    :param corners: (n, 2), points that the region must contain, px.
    :param margin_px: margin around them.
    """
    part, first = crop(image, corners.min(axis=0), corners.max(axis=0),
                       int(np.ceil(margin_px)) + _MARGIN_PX)
    return np.ascontiguousarray(part), first.astype(float)


def near_quad(uv: Array, quad: Array, slack_px: float) -> NDArray[np.bool_]:
    """Return a mask (n,) of points (n, 2) in a quad or at most ``slack_px`` outside it."""
    outline = np.ascontiguousarray(quad, dtype=np.float32)[:, None]
    return np.array([cv2.pointPolygonTest(outline, (float(u), float(v)), True) >= -slack_px
                     for u, v in uv], dtype=bool)


def off_epipolar_px(rig: StereoRig, left: Array, right: Array) -> Array:
    """Return distances (n,) of right pixels (n, 2) from the epipolar lines of left ones, px."""
    lines = rig.epipolar_lines_right(left)
    off = np.abs(np.sum(lines * rig.right.rays(right), axis=1))
    return np.asarray(off / np.hypot(lines[:, 0], lines[:, 1]) * float(rig.right.K[1, 1]))


def transfer(uv: Array, source: Array, target: Array) -> Array:
    """Return pixels (n, 2) mapped by the homography between two quads (4, 2)."""
    h = homography(source, target)
    out = np.column_stack([uv, np.ones(len(uv))]) @ h.T
    return np.asarray(out[:, :2] / out[:, 2:], np.float64)


def homography(source: Array, target: Array) -> Array:
    """Return the homography, (3, 3), that maps one quad (4, 2) to another."""
    return np.asarray(cv2.getPerspectiveTransform(
        np.ascontiguousarray(source, dtype=np.float32),
        np.ascontiguousarray(target, dtype=np.float32)), dtype=np.float64)
