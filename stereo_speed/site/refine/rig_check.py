# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Check of the rig by the background: epipolar residuals of many small details.

The right view is first warped into the left one over the road surface, and over infinity above
it, so that the compared patches look alike. Each detail must then lie on its epipolar line.
Relative tilt and roll of the cameras show clearly; a pan hardly moves anything off its epipolar
line and is left to the lines of the road.
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
from ...road.problem import pixels

MOST_DETAILS, LEAST_DETAILS = 1500, 60  # more take too long; fewer are not significant
_FAR_M = 1e5  # depth that stands for infinity
_FURTHEST_M = 250.0  # greatest depth of the road; everything above counts as infinitely far
_WINDOW_PX = 15  # window of a detail
_LEVELS = 3  # pyramid levels of the matching
_ACCURACY_PX, _MOST_STEPS = 0.002, 40  # termination criteria of the matching
# Parameters of goodFeaturesToTrack: quality level, least distance and block size.
_CORNER_SHARE, _CORNERS_APART_PX, _CORNER_PX = 0.02, 8.0, 7
_BLUR_PX, _GAIN = 12.0, 6.0  # scale of the slow changes to remove, and gain of the rest
_MOST_PX = 3.0  # distance from the epipolar line beyond which a match is wrong
_SAME_PX = 0.3  # largest round-trip error of a detail that is matched forth and back
_STEP_RAD = 1e-5  # step for finite differences by the rotation, about 1e-2 px
_UNKNOWN_RAD = np.radians(1.0)  # 1-sigma of angles that details do not show, such as a pan
_ROUNDS, _CAUCHY = 20, 2.0  # rounds of reweighting; sigmas at which a detail has half its weight


@dataclass(frozen=True, eq=False)
class Epipolar:
    """
    The rotation of the right camera by details of the background.

    :param residual_px: robust r.m.s. distance of details from their epipolar lines, for the rig as
        calibrated, px.
    :param details: number of details.
    :param drift_rad: (3,) best fitting pan, tilt and roll, rad.
    :param information: (3, 3) their inverse covariance, per rad^2.
    """

    residual_px: float
    details: int
    drift_rad: Array
    information: Array


def epipolar_check(rig: StereoRig, views: tuple[Background, Background], plane: Plane,
                   config: RefineConfig = RefineConfig()) -> Optional[Epipolar]:
    """
    Match details of two backgrounds and fit a rotation to their distances from epipolar lines.

    :param rig: rig as calibrated.
    :param views: backgrounds of the left and the right view.
    :param plane: plane of the road, left optical frame.
    :param config: gives the 1-sigma and the independent number of details.
    :return: None if the background has too few details.
    """
    left, right = _matches(rig, views, plane)
    if len(left) < LEAST_DETAILS:
        return None
    residual, slope = epipolar_distances(rig, left, right)
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


def epipolar_distances(rig: StereoRig, left_px: Array, right_px: Array) -> tuple[Array, Array]:
    """
    Return the distances of right pixels from the epipolar lines of left ones, and their slopes.

    :return: the distances (n,) in raw px, and the distances (n, 3) that a rotation of the right
        camera causes, px per rad of pan, tilt and roll.
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
    """Return the raw pixels (n, 2) of matched details in both views."""
    height, width = views[0].image.shape
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    carried = _to_right_view(rig, np.stack([u, v], axis=-1), plane)
    warped = views[1].spline(carried)
    known = np.isfinite(warped)
    left_grey = _flattened(views[0].image)
    right_grey = _flattened(np.where(known, warped, views[0].image).astype(np.float32))
    mask = cv2.erode(known.astype(np.uint8), np.ones((2 * _WINDOW_PX + 1,) * 2, np.uint8))
    corners = cv2.goodFeaturesToTrack(
        left_grey, MOST_DETAILS, _CORNER_SHARE, _CORNERS_APART_PX, mask=mask, blockSize=_CORNER_PX)
    if corners is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    found, good = _tracked(left_grey, right_grey, np.asarray(corners, np.float32))
    back, good_back = _tracked(right_grey, left_grey, found)
    consistent = np.linalg.norm((back - corners).reshape(-1, 2), axis=-1) < _SAME_PX
    consistent &= good & good_back
    left = corners.reshape(-1, 2)[consistent].astype(np.float64)
    right = _to_right_view(rig, found.reshape(-1, 2)[consistent].astype(np.float64), plane)
    residual = epipolar_distances(rig, left, right)[0]
    near = np.isfinite(residual) & (np.abs(residual) < _MOST_PX)
    return left[near], right[near]


def _tracked(first: NDArray[np.uint8], second: NDArray[np.uint8], corners: NDArray[np.float32]
             ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return corners (n, 1, 2) of one image tracked to another, and which (n,) were found."""
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _MOST_STEPS, _ACCURACY_PX)
    found, good, _ = cv2.calcOpticalFlowPyrLK(
        first, second, corners, np.zeros_like(corners), winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=_LEVELS, criteria=criteria)
    return np.asarray(found, np.float32), np.asarray(good).ravel() == 1


def _to_right_view(rig: StereoRig, uv_px: Array, plane: Plane) -> Array:
    """Return left pixels (..., 2) mapped to the right view over the road, or over infinity."""
    rays, distance = rig.left.rays(uv_px), plane.distance_m
    toward = rays @ plane.normal
    depth = np.where(toward / distance > 1 / _FURTHEST_M, distance / np.where(
        toward == 0, 1.0, toward), _FAR_M)
    return pixels(rig.right, rig.to_right(rays * depth[..., None]))


def _flattened(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return an image without its slow changes, with the rest amplified into 8 bits."""
    slow = cv2.GaussianBlur(image, (0, 0), _BLUR_PX)
    return np.asarray(np.clip(128 + _GAIN * (image - slow), 0, 255).astype(np.uint8))
