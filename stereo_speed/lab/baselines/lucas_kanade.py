# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Corners on a front, tracked by optical flow over time and between the views.

Pyramidal Lucas-Kanade (J.-Y. Bouguet, "Pyramidal implementation of the Lucas Kanade feature
tracker", 2000) on corners of J. Shi and C. Tomasi, CVPR 1994; matches must pass a forward-backward
check (Z. Kalal, K. Mikolajczyk, J. Matas, "Forward-backward error", ICPR 2010).  The earlier
image, and the right one, are first warped by the homography of the front's plane that the expected
motion, or depth, implies: one or two pixels of flow remain, without change of scale.
"""
from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .points import (
    crop_around, ExpectedFront, Grey, homography, near_quad, off_epipolar_px, Points, transfer)
from .settings import FlowSettings
from ...core.records import Array, StereoPair
from ...geometry.rig import StereoRig

_LEVELS = 2  # of the pyramid: only one or two pixels of flow remain
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 0.003)  # steps; px


class FlowPoints:
    """
    Tracks corners; see the module's docstring.

    :param rig: the cameras.
    :param settings: number and strength of corners, limits of matches.
    """

    def __init__(self, rig: StereoRig, settings: FlowSettings) -> None:
        self.rig, self.settings = rig, settings
        self._known: tuple[NDArray[np.int64], Array, Grey] | None = None
        self._next_id = 0

    def observe(self, pair: StereoPair, expected: ExpectedFront) -> Points:
        """Return the points of a pair of 8-bit images, including those already known."""
        part, origin = crop_around(pair.left, expected.left, expected.slack_px)
        ids, left = self._follow(part, origin, expected)
        fresh = self._corners(part, origin, expected, left)
        ids = np.concatenate([ids, np.arange(self._next_id, self._next_id + len(fresh))])
        self._next_id += len(fresh)
        left = np.concatenate([left, fresh])
        right = self._across(pair.right, part, origin, left, expected)
        self._known = ids, left, pair.left
        return Points(ids, left, right)

    def _follow(self, part: Grey, origin: Array, expected: ExpectedFront
                ) -> tuple[NDArray[np.int64], Array]:
        """Return ids and positions of the known points found in the next left view."""
        if self._known is None:
            return np.zeros(0, np.int64), np.zeros((0, 2))
        ids, old, image = self._known
        warped = _warped(image, expected.before, expected.left, part.shape, origin)
        at = transfer(old, expected.before, expected.left) - origin
        to, good = flow(warped, part, at, window_px(expected.width_px),
                        self.settings.most_round_trip_px)
        good &= near_quad(to + origin, expected.left, expected.slack_px)
        return ids[good], (to + origin)[good]

    def _across(self, image: Grey, part: Grey, origin: Array, left: Array,
                expected: ExpectedFront) -> Array:
        """Return positions of points in the right view, (n, 2) px; NaN where unknown."""
        out = np.full((len(left), 2), np.nan)
        warped = _warped(image, expected.right, expected.left, part.shape, origin)
        to, good = flow(part, warped, left - origin, window_px(expected.width_px),
                        self.settings.most_round_trip_px)
        right = transfer(to + origin, expected.left, expected.right)
        good &= self.rig.right.inside(right)
        good[good] = (off_epipolar_px(self.rig, left[good], right[good])
                      < self.settings.most_epipolar_px)
        out[good] = right[good]
        return out

    def _corners(self, part: Grey, origin: Array, expected: ExpectedFront, known: Array) -> Array:
        """Return new corners on the expected front, (n, 2) px."""
        wanted = self.settings.most_points - len(known)
        if wanted <= 0:
            return np.zeros((0, 2))
        apart = max(2.0, expected.width_px / 25)
        mask = np.zeros(part.shape, np.uint8)
        cv2.fillConvexPoly(mask, np.round(expected.left - origin).astype(np.int32), 255)
        for u, v in known - origin:
            cv2.circle(mask, (round(float(u)), round(float(v))), round(apart), 0, -1)
        found = cv2.goodFeaturesToTrack(
            part, wanted, self.settings.least_quality, apart, mask=mask, blockSize=5)
        return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(float) + origin


def window_px(width_px: float) -> int:
    """Return the odd side of the flow's window: a sixth of the front, within limits."""
    return 2 * int(np.clip(width_px / 12, 4, 10)) + 1


def flow(first: Grey, second: Grey, uv: Array, window: int, most_round_trip_px: float
         ) -> tuple[Array, NDArray[np.bool_]]:
    """
    Track points from one image to another, with a forward-backward check.

    :param uv: (n, 2), px in the first image, and start of the search in the second.
    :param window: side of the window, px.
    :param most_round_trip_px: greatest allowed forward-backward error, px.
    :return: positions (n, 2) in the second image, px, and a mask (n,) of those that pass.
    """
    if not len(uv):
        return np.zeros((0, 2)), np.zeros(0, bool)
    how: dict[str, Any] = {
        'winSize': (window, window), 'maxLevel': _LEVELS, 'criteria': _STOP,
        'flags': cv2.OPTFLOW_USE_INITIAL_FLOW}
    start = np.ascontiguousarray(uv, dtype=np.float32)[:, None]
    there, found, _ = cv2.calcOpticalFlowPyrLK(first, second, start, start.copy(), **how)
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(second, first, there, start.copy(), **how)
    trip = np.linalg.norm((back - start)[:, 0], axis=1)
    good = (found[:, 0] == 1) & (found_back[:, 0] == 1) & (trip < most_round_trip_px)
    return there[:, 0].astype(float), good


def _warped(image: Grey, source: Array, target: Array, shape: tuple[int, ...], origin: Array
            ) -> Grey:
    """Return a region of an image, warped so that a quad in it coincides with another."""
    part, first = crop_around(image, source, max(shape))
    h = homography(source - first, target - origin)
    return np.asarray(cv2.warpPerspective(
        part, h, shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)
