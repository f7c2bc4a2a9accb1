# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
SIFT points on a front: D. G. Lowe, IJCV 60(2), 2004 (the 2012 paper's reference [35]).

Matches are mutual nearest neighbours that pass Lowe's ratio test, near where the front's motion
or its depth would carry them; those left to right also lie on their epipolar line.
"""
from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .points import Aim, carry, cut, near_quad, off_epipolar_px, Points
from ...core.records import Array, StereoPair
from ...geometry.rig import StereoRig

Descriptors = NDArray[np.float32]

_WIDTH_PX = 200.0  # fronts smaller than this are magnified for detection
_MOST_SCALE = 4.0
_CONTRAST = 0.015  # fronts are small: Lowe's 0.04 would leave a handful of points
_RATIO = 0.85
_EPIPOLAR_PX = 1.5
_NEAR_PX = 4.0  # beyond the slack, how far a match may lie from its expected place


class SiftPoints:
    """
    Finds SIFT points; see the module's docstring.

    :param rig: the cameras.
    """

    def __init__(self, rig: StereoRig) -> None:
        self.rig = rig
        self._sift = cv2.SIFT.create(contrastThreshold=_CONTRAST)
        self._known: tuple[NDArray[np.int64], Array, Descriptors] | None = None
        self._next_id = 0

    def observe(self, pair: StereoPair, aim: Aim) -> Points:
        """Find the points of a pair, those already known among them."""
        left, left_d = self._detect(pair.left, aim.left, aim)
        right, right_d = self._detect(pair.right, aim.right, aim)
        ids = np.arange(self._next_id, self._next_id + len(left))
        self._next_id += len(left)
        near = _NEAR_PX + aim.slack_px
        if self._known is not None:
            old_ids, old, old_d = self._known
            a, b = match(carry(old, aim.before, aim.left), old_d, left, left_d, near)
            ids[b] = old_ids[a]
        matched = np.full((len(left), 2), np.nan)
        a, b = match(carry(left, aim.left, aim.right), left_d, right, right_d, near)
        good = off_epipolar_px(self.rig, left[a], right[b]) < _EPIPOLAR_PX
        matched[a[good]] = right[b[good]]
        self._known = ids, left, left_d
        return Points(ids, left, matched)

    def _detect(self, image: NDArray[Any], quad: Array, aim: Aim) -> tuple[Array, Descriptors]:
        """Detect points on the expected front: (n, 2) px and (n, 128)."""
        crop, origin = cut(image, quad, aim.slack_px)
        scale = float(np.clip(_WIDTH_PX / max(aim.width_px, 1.0), 1.0, _MOST_SCALE))
        if scale > 1:
            crop = np.asarray(cv2.resize(crop, None, fx=scale, fy=scale,
                                         interpolation=cv2.INTER_CUBIC), np.uint8)
        keypoints, descriptors = self._sift.detectAndCompute(crop, None)
        if not keypoints:
            return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
        # Pixel centres: (x + 1/2) grows with the scale, not x.
        uv = (np.array([k.pt for k in keypoints]) + 0.5) / scale - 0.5 + origin
        inside = near_quad(uv, quad, aim.slack_px)
        return uv[inside], np.asarray(descriptors, np.float32)[inside]


def match(expected: Array, first: Descriptors, places: Array, second: Descriptors,
          near_px: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """
    Match two sets of points.

    :param expected: (n, 2) where the first points should lie in the second image, px.
    :param first: (n, 128) their descriptors.
    :param places: (m, 2) where the second points lie.
    :param second: (m, 128) their descriptors.
    :param near_px: how far from its expected place a match may be.
    :return: indices into the first and into the second points, pair by pair.
    """
    none = np.zeros(0, dtype=np.intp)
    if not len(first) or not len(second):
        return none, none
    square = (first ** 2).sum(1)[:, None] + (second ** 2).sum(1) - 2 * first @ second.T
    apart = np.linalg.norm(expected[:, None] - places[None], axis=2)
    distance = np.where(apart < near_px, np.sqrt(np.maximum(square, 0.0)), np.inf)
    best = distance.argmin(axis=1)
    rows = np.arange(len(first))
    least = distance[rows, best]
    # Several orientations of one keypoint are no rivals to each other.
    rival = np.linalg.norm(places[best][:, None] - places[None], axis=2) > 1.0
    second_best = np.where(rival, distance, np.inf).min(axis=1)
    mutual = distance.argmin(axis=0)[best] == rows
    good = np.isfinite(least) & mutual & (least < _RATIO * second_best)
    return rows[good], best[good]
