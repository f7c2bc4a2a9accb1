# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Corners on a front, followed by optical flow over time and across the views.

Pyramidal Lucas-Kanade (J.-Y. Bouguet, "Pyramidal implementation of the Lucas Kanade feature
tracker", 2000) on corners of J. Shi and C. Tomasi, CVPR 1994; matches must survive the way back
(Z. Kalal, K. Mikolajczyk, J. Matas, "Forward-backward error", ICPR 2010).  The earlier image, and
the right one, are first warped by the homography that the expected motion, or depth, gives the
front's plane: what is left for the flow is a pixel or two, without change of scale.
"""
from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .points import Aim, carry, cut, homography, near_quad, off_epipolar_px, Points
from ...core.records import Array, StereoPair
from ...geometry.rig import StereoRig

_MOST_POINTS = 60
_QUALITY = 0.02
_ROUND_TRIP_PX = 0.3
_EPIPOLAR_PX = 1.0
_LEVELS = 2
_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 0.003)


class FlowPoints:
    """
    Follows corners; see the module's docstring.

    :param rig: the cameras.
    """

    def __init__(self, rig: StereoRig) -> None:
        self.rig = rig
        self._known: tuple[NDArray[np.int64], Array, NDArray[Any]] | None = None
        self._next_id = 0

    def observe(self, pair: StereoPair, aim: Aim) -> Points:
        """Find the points of a pair, those already known among them."""
        crop, origin = cut(pair.left, aim.left, aim.slack_px)
        window = window_px(aim.width_px)
        ids, left = self._again(crop, origin, aim, window)
        fresh = _corners(crop, origin, aim, left)
        ids = np.concatenate([ids, np.arange(self._next_id, self._next_id + len(fresh))])
        self._next_id += len(fresh)
        left = np.concatenate([left, fresh])
        right = self._across(pair.right, crop, origin, left, aim, window)
        self._known = ids, left, pair.left
        return Points(ids, left, right)

    def _again(self, crop: NDArray[np.uint8], origin: Array, aim: Aim, window: int
               ) -> tuple[NDArray[np.int64], Array]:
        """Find the known points again."""
        if self._known is None:
            return np.zeros(0, np.int64), np.zeros((0, 2))
        ids, old, image = self._known
        warped = _warped(image, aim.before, aim.left, crop.shape, origin)
        at = carry(old, aim.before, aim.left) - origin
        to, good = flow(warped, crop, at, at, window)
        good &= near_quad(to + origin, aim.left, aim.slack_px)
        return ids[good], (to + origin)[good]

    def _across(self, image: NDArray[Any], crop: NDArray[np.uint8], origin: Array, left: Array,
                aim: Aim, window: int) -> Array:
        """Match points to the right view: (n, 2) px, NaN where it fails."""
        out = np.full((len(left), 2), np.nan)
        warped = _warped(image, aim.right, aim.left, crop.shape, origin)
        to, good = flow(crop, warped, left - origin, left - origin, window)
        right = carry(to + origin, aim.left, aim.right)
        good &= self.rig.right.inside(right)
        good[good] = off_epipolar_px(self.rig, left[good], right[good]) < _EPIPOLAR_PX
        out[good] = right[good]
        return out


def window_px(width_px: float) -> int:
    """Give the side of the flow's window, odd: a sixth of the front, within reason."""
    return 2 * int(np.clip(width_px / 12, 4, 10)) + 1


def flow(first: NDArray[np.uint8], second: NDArray[np.uint8], uv: Array, guess: Array,
         window: int) -> tuple[Array, NDArray[np.bool_]]:
    """
    Follow points from one image to another and back.

    :param uv: (n, 2) px in the first image.
    :param guess: (n, 2) px, where to begin in the second.
    :param window: side of the window, px.
    :return: (n, 2) px in the second image, and (n,) which came back to where they began.
    """
    if not len(uv):
        return np.zeros((0, 2)), np.zeros(0, bool)
    how: dict[str, Any] = {
        'winSize': (window, window), 'maxLevel': _LEVELS, 'criteria': _STOP,
        'flags': cv2.OPTFLOW_USE_INITIAL_FLOW}
    start, toward = (np.ascontiguousarray(x, dtype=np.float32)[:, None].copy()
                     for x in (uv, guess))
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        first, second, start, toward, **how)
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(second, first, there, start.copy(), **how)
    trip = np.linalg.norm((back - start)[:, 0], axis=1)
    good = (found[:, 0] == 1) & (found_back[:, 0] == 1) & (trip < _ROUND_TRIP_PX)
    return there[:, 0].astype(float), good


def _corners(crop: NDArray[np.uint8], origin: Array, aim: Aim, known: Array) -> Array:
    """Find corners on the expected front that are not yet followed: (n, 2) px."""
    wanted = _MOST_POINTS - len(known)
    if wanted <= 0:
        return np.zeros((0, 2))
    apart = max(2.0, aim.width_px / 25)
    mask = np.zeros(crop.shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(aim.left - origin).astype(np.int32), 255)
    for u, v in known - origin:
        cv2.circle(mask, (round(float(u)), round(float(v))), round(apart), 0, -1)
    found = cv2.goodFeaturesToTrack(crop, wanted, _QUALITY, apart, mask=mask, blockSize=5)
    return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(float) + origin


def _warped(image: NDArray[Any], source: Array, target: Array, shape: tuple[int, ...],
            origin: Array) -> NDArray[np.uint8]:
    """Warp an image so that a quad of it lies on another, and cut out a region of that."""
    part, first = cut(image, source, max(shape))
    h = homography(source - first, target - origin)
    return np.asarray(cv2.warpPerspective(
        part, h, shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)
