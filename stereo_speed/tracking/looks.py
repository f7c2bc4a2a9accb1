# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
One look at the front: its patch in both views at a pose, and how it changes with the pose.

Particles are sampled coarsely and fast; the refinement needs looks that are right to hundredths
of a pixel, so they go through the exact lens model and cubic B-splines.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..geometry.camera import Camera
from ..geometry.rig import StereoRig
from ..records import Array, StereoPair
from .front import Front, plane_points
from .likelihood import crop_for

_POSE_STEP_PX = 0.4  # half width of the central differences, in pixels of image motion
_BLUR_STEPS = 0.6  # low-pass of every look, in grid steps, so that near and far looks compare


@dataclass(frozen=True, eq=False)
class Look:
    """
    A linearised look at the front in one pair.

    :param pose: (3,) s, a, b where it was taken, m.
    :param patches: (2, G) left and right patch, zero mean and unit variance.
    :param jacobian: (2, G, 3) derivatives of the patches by the pose, 1/m.
    :param pixels: pixels the patch covers in the image, at most one a grid sample.
    :param shift_px: (2, 3) speed of the front's centre in each view by the pose, px/m.
    :param disparity_px: (3,) change of its disparity by the pose, px/m.
    """

    pose: Array
    patches: Array
    jacobian: Array
    pixels: float
    shift_px: Array
    disparity_px: Array


class LookSampler:
    """Takes looks at one front: fixed grid on its plane, any pose, any pair."""

    def __init__(self, rig: StereoRig, front: Front, unit_xy: Array,
                 grid_shape: tuple[int, int]) -> None:
        self.rig, self.front = rig, front
        self.grid_m = front.grid_m(unit_xy)
        self.grid_shape = grid_shape

    def pixels_of(self, poses: Array) -> tuple[Array, Array]:
        """Grid samples in both raw views, (N, G, 2) px each; NaN behind the camera."""
        left, right, _, _ = self.rig.project(
            plane_points(self.front.path, poses, self.grid_m))
        return left, right

    def patches(self, pair: StereoPair, poses: Array) -> NDArray[np.float64]:
        """
        Sample both views for a few poses.

        :param poses: (N, 3).
        :return: (N, 2, G), each patch of zero mean and unit variance.
        """
        views = [self._sample(image, uv) for image, uv in
                 zip((pair.left, pair.right), self.pixels_of(poses))]
        return _standardise(np.stack(views, axis=1))

    def look(self, pair: StereoPair, pose: Array) -> Look | None:
        """Take a look with its derivatives; None where the front is not wholly seen."""
        left, right, in_left, in_right = self.rig.project(
            plane_points(self.front.path, pose[None], self.front.corners_m))
        if not (in_left.all() and in_right.all()):
            return None
        centres = self._centre_motion(pose)
        steps = _POSE_STEP_PX / np.maximum(np.abs(centres).max(axis=(0, 1)), 1e-9)
        poses = np.concatenate([pose[None], pose + np.diag(steps), pose - np.diag(steps)])
        patches = self.patches(pair, poses)
        jacobian = (patches[1:4] - patches[4:]) / (2 * steps[:, None, None])
        area = 0.5 * (_area(left[0]) + _area(right[0]))
        return Look(pose=pose, patches=patches[0], jacobian=np.moveaxis(jacobian, 0, -1),
                    pixels=min(area, float(len(self.grid_m))),
                    shift_px=np.linalg.norm(centres, axis=1),
                    disparity_px=centres[0, 0] - centres[1, 0])

    def _centre_motion(self, pose: Array) -> Array:
        """Derivatives of the centre's pixels by the pose, (2 views, 2 uv, 3)."""
        step = 1e-3
        poses = np.concatenate([pose + step * np.eye(3), pose - step * np.eye(3)])
        views = self.rig.project(plane_points(self.front.path, poses, np.zeros((1, 2))))[:2]
        return np.stack([(uv[:3, 0] - uv[3:, 0]).T / (2 * step) for uv in views])

    def _sample(self, image: NDArray[Any], uv: Array) -> Array:
        """Cubic B-spline samples (N, G) of an image low-passed to the grid's spacing."""
        flat = uv.reshape(-1, 2)
        rows, cols = self.grid_shape
        grid = uv[0].reshape(rows, cols, 2)
        step = np.linalg.norm(np.diff(grid, axis=1), axis=-1).mean(), \
            np.linalg.norm(np.diff(grid, axis=0), axis=-1).mean()
        crop, origin = crop_for(image, flat.min(axis=0) - 3, flat.max(axis=0) + 3, 1.0)
        sigma = [_BLUR_STEPS * step[1], _BLUR_STEPS * step[0]]
        smooth = ndimage.gaussian_filter(crop.astype(float), sigma, mode='nearest', truncate=3.0)
        spline = ndimage.spline_filter(smooth, order=3, mode='nearest')
        at = (flat - origin).T[::-1]
        values = ndimage.map_coordinates(spline, at, order=3, mode='nearest', prefilter=False)
        return values.reshape(uv.shape[:2])


def inside(camera: Camera, quad: Array) -> bool:
    """Whether all corners of a (4, 2) quad lie in the camera's image."""
    return bool(np.isfinite(quad).all() and camera.inside(quad).all())


def _area(quad: Array) -> float:
    x, y = quad[:, 0], quad[:, 1]
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)


def _standardise(patches: Array) -> Array:
    centred = patches - patches.mean(axis=-1, keepdims=True)
    return centred / np.maximum(centred.std(axis=-1, keepdims=True), 1e-6)
