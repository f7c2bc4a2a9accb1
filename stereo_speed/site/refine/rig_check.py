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

from .config import RefineConfig
from .empty_road import Background
from ...core.records import Array
from ...estimation.robust import robust_std
from ...geometry.ray_plane import Plane
from ...geometry.rig import StereoRig

MOST_DETAILS, LEAST_DETAILS = 1500, 60  # more take time; fewer are chance
_FAR_M = 1e5  # stands for infinity
_FURTHEST_M = 250.0  # of the road; what is above it counts as infinitely far
_NEAREST_M = 0.1  # what is nearer to the right camera's plane is not seen
_WINDOW_PX = 15  # of a detail
_LEVELS = 3  # of the pyramid of the matching
_ACCURACY_PX, _MOST_STEPS = 0.002, 40  # at which the matching stops
_CORNER_SHARE, _CORNERS_APART_PX, _CORNER_PX = 0.02, 8.0, 7  # of goodFeaturesToTrack
_BLUR_PX, _GAIN = 12.0, 6.0  # of the slow changes that are taken out, and of what remains
_MOST_PX = 3.0  # off its epipolar line; what is further was matched wrong
_SAME_PX = 0.3  # by which a detail may miss itself when matched there and back again
_STEP_RAD = 1e-5  # of the differences by the rotation: 1e-2 px
_UNKNOWN_RAD = np.radians(1.0)  # 1-sigma of angles that details do not show, such as a pan
_ROUNDS, _CAUCHY = 20, 2.0  # of reweighting; sigmas at which a detail counts half


@dataclass(frozen=True, eq=False)
class Epipolar:
    """
    What details show of the rotation of the right camera.

    :param residual_px: robust r.m.s. of details off their epipolar lines, as calibrated.
    :param details: how many.
    :param drift_rad: (3,) pan, tilt and roll that fit best.
    :param information: (3, 3) inverse covariance of them, per rad^2.
    """

    residual_px: float
    details: int
    drift_rad: Array
    information: Array


def epipolar_check(rig: StereoRig, views: tuple[Background, Background], plane: Plane,
                   config: RefineConfig = RefineConfig()) -> Optional[Epipolar]:
    """
    Match details of two clean views and measure how far they are off their epipolar lines.

    :param rig: as calibrated.
    :param views: left and right.
    :param plane: of the road, left optical frame.
    :param config: how well details can be believed.
    :return: None where the background has too few details.
    """
    left, right = _matches(rig, views, plane)
    if len(left) < LEAST_DETAILS:
        return None
    residual, slope = off_lines(rig, left, right)
    drift = np.zeros(3)
    for _ in range(_ROUNDS):
        off = residual - slope @ drift
        spread = max(robust_std(off), config.detail_std_px)
        weight = 1 / (1 + (off / (_CAUCHY * spread))**2)
        normal = (slope.T * weight) @ slope / spread**2 + np.eye(3) / _UNKNOWN_RAD**2
        drift = np.linalg.solve(normal, (slope.T * weight) @ residual / spread**2)
    share = min(config.independent_details / float(weight.sum()), 1.0)
    return Epipolar(robust_std(residual), len(left), drift,
                    share * (slope.T * weight) @ slope / spread**2)


def off_lines(rig: StereoRig, left_px: Array, right_px: Array) -> tuple[Array, Array]:
    """
    Return distances (n,) in raw px of right pixels from the epipolar lines of left ones.

    :return: the distances, and (n, 3) by how much a rotation of 1 rad would have made them.
    """
    def distance(rotated: StereoRig) -> Array:
        line = rotated.epipolar_lines_right(left_px)
        line = line / np.linalg.norm(line[:, :2], axis=-1, keepdims=True)
        return np.asarray(np.sum(line * rotated.right.rays(right_px), axis=-1) * rig.right.K[0, 0])
    slopes = []
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = _STEP_RAD
        slopes.append((distance(rig.drifted(-step)) - distance(rig.drifted(step)))
                      / (2 * _STEP_RAD))
    return distance(rig), np.stack(slopes, axis=-1)


def _matches(rig: StereoRig, views: tuple[Background, Background], plane: Plane
             ) -> tuple[Array, Array]:
    """Return the raw pixels (n, 2) of details in both views."""
    height, width = views[0].image.shape
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    carried = _carry(rig, np.stack([u, v], axis=-1), plane)
    warped = views[1].spline(carried)
    known = np.isfinite(warped)
    here = _flattened(views[0].image)
    there = _flattened(np.where(known, warped, views[0].image).astype(np.float32))
    mask = cv2.erode(known.astype(np.uint8), np.ones((2 * _WINDOW_PX + 1,) * 2, np.uint8))
    corners = cv2.goodFeaturesToTrack(
        here, MOST_DETAILS, _CORNER_SHARE, _CORNERS_APART_PX, mask=mask, blockSize=_CORNER_PX)
    if corners is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    found, good = _tracked(here, there, np.asarray(corners, np.float32))
    back, good_back = _tracked(there, here, found)
    same = np.linalg.norm((back - corners).reshape(-1, 2), axis=-1) < _SAME_PX
    same &= good & good_back
    left = corners.reshape(-1, 2)[same].astype(np.float64)
    right = _carry(rig, found.reshape(-1, 2)[same].astype(np.float64), plane)
    residual = off_lines(rig, left, right)[0]
    near = np.isfinite(residual) & (np.abs(residual) < _MOST_PX)
    return left[near], right[near]


def _tracked(here: NDArray[np.uint8], there: NDArray[np.uint8], corners: NDArray[np.float32]
             ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return where corners (n, 1, 2) of one picture are in another, and which (n,) were found."""
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _MOST_STEPS, _ACCURACY_PX)
    found, good, _ = cv2.calcOpticalFlowPyrLK(
        here, there, corners, np.zeros_like(corners), winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=_LEVELS, criteria=criteria)
    return np.asarray(found, np.float32), np.asarray(good).ravel() == 1


def _carry(rig: StereoRig, uv_px: Array, plane: Plane) -> Array:
    """Return left pixels (..., 2) in the right view over the road, or infinity above it."""
    rays, distance = rig.left.rays(uv_px), plane.distance_m
    toward = rays @ plane.normal
    depth = np.where(toward / distance > 1 / _FURTHEST_M, distance / np.where(
        toward == 0, 1.0, toward), _FAR_M)
    points = rig.to_right(rays * depth[..., None])
    z = points[..., 2:]
    return rig.right.distort(points[..., :2] / np.where(z > _NEAREST_M, z, np.nan))


def _flattened(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return an image without its slow changes, the rest spread over 8 bits."""
    slow = cv2.GaussianBlur(image, (0, 0), _BLUR_PX)
    return np.asarray(np.clip(128 + _GAIN * (image - slow), 0, 255).astype(np.uint8))
