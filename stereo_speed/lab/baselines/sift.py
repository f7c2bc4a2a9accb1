# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
SIFT points on a front: D. G. Lowe, IJCV 60(2), 2004 (the 2012 paper's reference [35]).

Matches are mutual nearest neighbours that pass Lowe's ratio test, near the position expected from
the front's motion or its depth; left-to-right matches also lie on their epipolar line.
"""
from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .points import crop_around, ExpectedFront, Grey, near_quad, off_epipolar_px, Points, transfer
from .settings import SiftSettings
from ...core.records import Array, StereoPair
from ...geometry.rig import StereoRig

Descriptors = NDArray[np.float32]

_WIDTH_PX = 200.0  # fronts narrower than this are magnified for detection
_MOST_SCALE = 4.0  # a greater magnification shows no more detail
_SAME_PX = 1.0  # keypoints nearer than this are one, with several orientations


class SiftPoints:
    """
    Finds SIFT points; see the module's docstring.

    :param rig: the cameras.
    :param settings: contrast of keypoints, limits of matches.
    """

    def __init__(self, rig: StereoRig, settings: SiftSettings) -> None:
        self.rig, self.settings = rig, settings
        self._sift = cv2.SIFT.create(contrastThreshold=settings.least_contrast)
        self._known: tuple[NDArray[np.int64], Array, Descriptors] | None = None
        self._next_id = 0

    def observe(self, pair: StereoPair, expected: ExpectedFront) -> Points:
        """Return the points of a pair of 8-bit images, including those already known."""
        left, left_d = self._detect(pair.left, expected.left, expected)
        right, right_d = self._detect(pair.right, expected.right, expected)
        ids = np.arange(self._next_id, self._next_id + len(left))
        self._next_id += len(left)
        near, ratio = self.settings.most_offset_px + expected.slack_px, self.settings.most_ratio
        if self._known is not None:
            old_ids, old, old_d = self._known
            a, b = match(transfer(old, expected.before, expected.left), old_d, left, left_d,
                         near, ratio)
            ids[b] = old_ids[a]
        matched = np.full((len(left), 2), np.nan)
        a, b = match(transfer(left, expected.left, expected.right), left_d, right, right_d,
                     near, ratio)
        good = off_epipolar_px(self.rig, left[a], right[b]) < self.settings.most_epipolar_px
        matched[a[good]] = right[b[good]]
        self._known = ids, left, left_d
        return Points(ids, left, matched)

    def _detect(self, image: Grey, quad: Array, expected: ExpectedFront
                ) -> tuple[Array, Descriptors]:
        """Return points on the expected front, (n, 2) px, and descriptors (n, 128)."""
        part, origin = crop_around(image, quad, expected.slack_px)
        scale = float(np.clip(_WIDTH_PX / max(expected.width_px, 1.0), 1.0, _MOST_SCALE))
        if scale > 1:
            part = np.asarray(cv2.resize(part, None, fx=scale, fy=scale,
                                         interpolation=cv2.INTER_CUBIC), np.uint8)
        keypoints, descriptors = self._sift.detectAndCompute(part, None)
        if not keypoints:
            return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
        # With pixel centres at integers, (x + 1/2) scales, not x.
        uv = (np.array([k.pt for k in keypoints]) + 0.5) / scale - 0.5 + origin
        inside = near_quad(uv, quad, expected.slack_px)
        return uv[inside], np.asarray(descriptors, np.float32)[inside]


def match(expected: Array, first: Descriptors, found: Array, second: Descriptors, near_px: float,
          ratio: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """
    Match two sets of points, and return indices into the first and into the second.

    :param expected: (n, 2), expected positions of the first points in the second image, px.
    :param first: (n, 128), their descriptors.
    :param found: (m, 2), positions of the second points.
    :param second: (m, 128), their descriptors.
    :param near_px: greatest distance of a match from its expected position.
    :param ratio: greatest distance of a match as a share of that of the second best.
    """
    none = np.zeros(0, dtype=np.intp)
    if not len(first) or not len(second):
        return none, none
    square = (first ** 2).sum(1)[:, None] + (second ** 2).sum(1) - 2 * first @ second.T
    apart = np.linalg.norm(expected[:, None] - found[None], axis=2)
    distance = np.where(apart < near_px, np.sqrt(np.maximum(square, 0.0)), np.inf)
    best = distance.argmin(axis=1)
    rows = np.arange(len(first))
    least = distance[rows, best]
    rival = np.linalg.norm(found[best][:, None] - found[None], axis=2) > _SAME_PX
    second_best = np.where(rival, distance, np.inf).min(axis=1)
    mutual = distance.argmin(axis=0)[best] == rows
    good = np.isfinite(least) & mutual & (least < ratio * second_best)
    return rows[good], best[good]
