# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What the still background says of the rig: epipolar residuals of many small details.

The right view is first carried into the left one over the surface of the road, and over infinity
above it, so that what is compared looks alike. A detail must then lie on its epipolar line. Tilt
and roll of one camera against the other show at once; a pan hardly moves anything off its line,
and is left to the lines of the road.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from .cross_sections import SplineImage
from ...core.records import Array
from ...geometry.rig import StereoRig

MOST_DETAILS = 1500
LEAST_DETAILS = 60
DETAIL_STD_PX = 0.05  # no detail is placed better
INDEPENDENT = 60  # errors of neighbours, and of one tree, are alike: more details say no more
_FAR_M, _FURTHEST_M = 1e5, 250.0
_WINDOW_PX, _BLUR_PX, _GAIN = 15, 12.0, 6.0
_MOST_PX = 3.0  # off its epipolar line
_SAME_PX = 0.3  # there and back again
_STEP_RAD = 1e-5


@dataclass(frozen=True, eq=False)
class Epipolar:
    """
    What details say of the turn of the right camera.

    :param residual_px: robust r.m.s. of details off their epipolar lines, as calibrated.
    :param details: how many.
    :param turn_rad: (3,) pan, tilt and roll that fit best.
    :param information: (3, 3) inverse covariance of them, per rad^2.
    """

    residual_px: float
    details: int
    turn_rad: Array
    information: Array


def epipolar_check(rig: StereoRig, images: tuple[NDArray[np.float32], NDArray[np.float32]],
                   plane: tuple[Array, float]) -> Optional[Epipolar]:
    """
    Match details of two clean views and see how far they are off their epipolar lines.

    :param rig: as calibrated.
    :param images: left and right (H, W).
    :param plane: n (3,) and d of the road, left optical frame.
    :return: None where the background has too few details.
    """
    left, right = _matches(rig, images, plane)
    if len(left) < LEAST_DETAILS:
        return None
    residual, slope = off_lines(rig, left, right)
    turn, weight = np.zeros(3), np.ones(len(left))
    for _ in range(20):
        off = residual - slope @ turn
        spread = max(1.4826 * float(np.median(np.abs(off))), DETAIL_STD_PX)
        weight = 1 / (1 + (off / (2 * spread))**2)
        # nothing in the images tells much of a pan
        normal = (slope.T * weight) @ slope / spread**2 + np.eye(3) / np.radians(1.0)**2
        turn = np.linalg.solve(normal, (slope.T * weight) @ residual / spread**2)
    share = min(INDEPENDENT / float(weight.sum()), 1.0)
    return Epipolar(1.4826 * float(np.median(np.abs(residual))), len(left), turn,
                    share * (slope.T * weight) @ slope / spread**2)


def off_lines(rig: StereoRig, left_px: Array, right_px: Array) -> tuple[Array, Array]:
    """
    Give distances (n,) in raw px of right pixels from the epipolar lines of left ones.

    :return: the distances, and (n, 3) by how much a turn of 1 rad would have made them.
    """
    def distance(turned: StereoRig) -> Array:
        line = turned.epipolar_lines_right(left_px)
        line = line / np.linalg.norm(line[:, :2], axis=-1, keepdims=True)
        return np.asarray(np.sum(line * turned.right.rays(right_px), axis=-1) * rig.right.K[0, 0])
    slopes = []
    for axis in range(3):
        turn = np.zeros(3)
        turn[axis] = _STEP_RAD
        slopes.append((distance(rig.turned(-turn)) - distance(rig.turned(turn))) / (2 * _STEP_RAD))
    return distance(rig), np.stack(slopes, axis=-1)


def _matches(rig: StereoRig, images: tuple[NDArray[np.float32], NDArray[np.float32]],
             plane: tuple[Array, float]) -> tuple[Array, Array]:
    """Match details: raw pixels (n, 2) of both views."""
    height, width = images[0].shape
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    carried = _carry(rig, np.stack([u, v], axis=-1), plane)
    warped = SplineImage(images[1])(carried)
    known = np.isfinite(warped)
    pictures = [_flattened(image) for image in (
        images[0], np.where(known, warped, images[0]).astype(np.float32))]
    mask = cv2.erode(known.astype(np.uint8), np.ones((2 * _WINDOW_PX + 1,) * 2, np.uint8))
    corners = cv2.goodFeaturesToTrack(
        pictures[0], MOST_DETAILS, 0.02, 8.0, mask=mask, blockSize=7)
    if corners is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    options = {'winSize': (_WINDOW_PX, _WINDOW_PX), 'maxLevel': 3, 'criteria': (
        cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 0.002)}
    there, good, _ = cv2.calcOpticalFlowPyrLK(*pictures, corners, None, **options)
    back, good_back, _ = cv2.calcOpticalFlowPyrLK(*pictures[::-1], there, None, **options)
    same = np.linalg.norm((back - corners).reshape(-1, 2), axis=-1) < _SAME_PX
    same &= (good.ravel() == 1) & (good_back.ravel() == 1)
    left = corners.reshape(-1, 2)[same].astype(np.float64)
    right = _carry(rig, there.reshape(-1, 2)[same].astype(np.float64), plane)
    residual = off_lines(rig, left, right)[0]
    near = np.isfinite(residual) & (np.abs(residual) < _MOST_PX)
    return left[near], right[near]


def _carry(rig: StereoRig, uv_px: Array, plane: tuple[Array, float]) -> Array:
    """Carry left pixels (..., 2) into the right view over the road, or infinity above it."""
    rays = rig.left.rays(uv_px)
    toward = rays @ plane[0]
    depth = np.where(toward / plane[1] > 1 / _FURTHEST_M, plane[1] / np.where(
        toward == 0, 1.0, toward), _FAR_M)
    points = rig.to_right(rays * depth[..., None])
    z = points[..., 2:]
    return rig.right.distort(points[..., :2] / np.where(z > 0.1, z, np.nan))


def _flattened(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Take the slow changes out of an image and spread the rest over 8 bits."""
    slow = cv2.GaussianBlur(image, (0, 0), _BLUR_PX)
    return np.clip(128 + _GAIN * (image - slow), 0, 255).astype(np.uint8)
