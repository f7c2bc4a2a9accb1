# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
One observation of the front: its patch in both views at a pose, and how it changes with that.

Particles are sampled coarsely and fast; the refinement needs observations that are right to
hundredths of a pixel, so they go through the exact lens model and cubic B-splines.
"""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, NamedTuple, Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from .front import Front, plane_points
from .relief import relief_basis
from ..core.config import NoiseConfig
from ..core.records import Array, StereoPair
from ..geometry.rig import StereoRig
from ..vision.sampling import low_pass_crop, Patches

# Given corners are a pixel off, and what lies beyond the front's edges moves otherwise: only the
# inner share of the quad is sampled.
_INNER = 0.94
_STEP_M = 1e-4  # of the differences of the geometry: a curved way bends by far less over it
_BLUR_STEPS = 0.6  # low-pass of every observation, in grid steps, so that near and far compare
_BORDER_PX = 3  # image around the samples that the low-pass and the splines need


@dataclass(frozen=True, eq=False)
class Observation:
    """
    A linearised observation of the front in one pair; equal to itself alone.

    :param pose: (3,) s, a, b where it was taken, m.
    :param heading_rad: heading of the vehicle against the path it was taken with.
    :param relief: (M,) relief of the front it was taken with, m at the nodes.
    :param patches: (2, G) left and right patch, zero mean and unit variance.
    :param jacobian: (2, 3, G) derivatives of the patches by the pose, 1/m.
    :param relief_jacobian: (2, G) derivatives of each sample by its own relief, 1/m.
    :param outlines: (2, G) how each patch changes when the outlines of what is clipped in it move
        outwards, of unit length; 0 where nothing is.  The derivatives have no part along it.
    :param pixels: pixels the patch covers in the image, at most one a grid sample.
    :param shift_px: (2, 3) speed of the front's centre in each view by the pose, px/m.
    :param disparity_px: (3,) change of its disparity by the pose, px/m.
    :param right_m: how far it had gone along the path when the right view was exposed, m.
    :param skew_px: how far the front moves in the right view between the two stamps where these
        are not taken at their word, px.
    """

    pose: Array
    heading_rad: float
    relief: Array
    patches: Array
    jacobian: Array
    relief_jacobian: Array
    outlines: Array
    pixels: float
    shift_px: Array
    disparity_px: Array
    right_m: float
    skew_px: float


class _View(NamedTuple):
    """What one view adds to an observation, as documented there."""

    patch: Array
    jacobian: Array
    relief_jacobian: Array
    outline: Array


def normalised_change(jacobian: Array, patches: Array) -> Array:
    """
    Return the derivatives of patches that are kept at zero mean and unit variance.

    :param jacobian: (..., 3, G) derivatives of the grey values before, per their deviation.
    :param patches: (..., G).
    :return: (..., 3, G), without any part along a constant or the patch itself.
    """
    jacobian = jacobian - jacobian.mean(axis=-1, keepdims=True)
    along = jacobian @ patches[..., None] / patches.shape[-1]
    return np.asarray(jacobian - along * patches[..., None, :])


class ObservationSampler:
    """
    Makes observations of one front: fixed grid on its plane, any pose, any pair.

    :param rig: the cameras.
    :param front: the front.
    :param unit_xy: (G, 2) grid samples in the unit square.
    :param grid_shape: rows and columns of the grid.
    :param noise: what is clipped, and how far that reaches.
    """

    def __init__(self, rig: StereoRig, front: Front, unit_xy: Array,
                 grid_shape: tuple[int, int], noise: NoiseConfig = NoiseConfig()) -> None:
        self.rig, self.front, self.grid_shape, self.noise = rig, front, grid_shape, noise
        inner = 0.5 + _INNER * (unit_xy - 0.5)
        self._plane_m = np.concatenate([front.grid_m(inner), front.corners_m])
        self._count = len(unit_xy)
        self.relief_basis = relief_basis(unit_xy)

    def observe(self, pair: StereoPair, pose: Array, velocity_mps: Array, heading_rad: float,
                relief: Array) -> Optional[Observation]:
        """
        Return an observation with its derivatives; None where the front is not in both images.

        :param pose: (3,) s, a, b at the left stamp, m.
        :param velocity_mps: (3,) their rates, for the right view where it was exposed later.
        :param heading_rad: heading of the vehicle against the path.
        :param relief: (M,) relief of the front at its nodes, m.
        """
        n, lag = self._count, pair.right_lag_s
        poses = np.concatenate([pose[None], pose + _STEP_M * np.eye(3)])
        depth = np.concatenate([self.relief_basis @ relief, np.zeros(4)])
        points = plane_points(self.front.path, poses, self._plane_m, heading_rad, depth)
        later = points if lag == 0 else plane_points(
            self.front.path, poses + lag * velocity_mps, self._plane_m, heading_rad, depth)
        rig = self.rig.as_taken(pair.motion)
        left, in_left = rig.left.project(points)
        right, in_right = rig.right.project(rig.to_right(later))
        if not (in_left[0].all() and in_right[0].all()):
            return None
        motion = [(uv[1:] - uv[0]) / _STEP_M for uv in (left, right)]  # (3, M, 2)
        views = [self._patch(image, uv[0, :n], m[:, :n]) for image, uv, m in
                 zip((pair.left, pair.right), (left, right), motion)]
        centre = [m[:, :n].mean(axis=1) for m in motion]  # (3, 2)
        area = 0.5 * (_area(left[0, n:]) + _area(right[0, n:]))
        patches, jacobian, alone, outlines = (np.stack(part) for part in zip(*views))
        return Observation(
            pose=pose, heading_rad=heading_rad, relief=relief, patches=patches,
            jacobian=jacobian, relief_jacobian=alone, outlines=outlines,
            pixels=min(area, float(n)),
            shift_px=np.stack([np.linalg.norm(c, axis=1) for c in centre]),
            disparity_px=centre[0][:, 0] - centre[1][:, 0],
            right_m=lag * float(velocity_mps[0]),
            skew_px=float(np.linalg.norm(velocity_mps @ centre[1]) * abs(pair.stamp_error_s)))

    def _patch(self, image: NDArray[Any], uv: Array, motion: Array) -> _View:
        """
        Return the samples of one view, low-passed to the grid's spacing.

        :param uv: (G, 2) px.
        :param motion: (3, G, 2) their derivatives by the pose, px/m.
        """
        grid = uv.reshape(*self.grid_shape, 2)
        sigma = [_BLUR_STEPS * float(np.linalg.norm(np.diff(grid, axis=k), axis=-1).mean())
                 for k in (0, 1)]
        crop, origin = low_pass_crop(
            image, uv.min(axis=0) - _BORDER_PX, uv.max(axis=0) + _BORDER_PX, 1.0)
        smooth = _blurred(crop, sigma)
        at = (uv - origin).T[::-1]
        spline = ndimage.spline_filter(smooth, 3, np.float64)
        values = ndimage.map_coordinates(spline, at, order=3, mode='nearest', prefilter=False)
        u, v = np.ascontiguousarray(at[::-1], dtype=np.float32)[:, None]
        scale = max(float(values.std()), 1e-6)
        patch = (values - values.mean()) / scale
        slopes = [np.asarray(slope) for slope in np.gradient(smooth)]
        by_v, by_u = (cv2.remap(slope, u, v, cv2.INTER_LINEAR)[0] / scale for slope in slopes)
        jacobian = motion[..., 0] * by_u + motion[..., 1] * by_v  # (3, G)
        change = normalised_change(jacobian, patch)
        near = _clipped(crop, image.dtype, self.noise)
        if near is None:
            return _View(patch, change, jacobian[0], np.zeros_like(patch))
        moved = np.asarray(np.hypot(*slopes) * _blurred(near, sigma))
        outline = normalised_change(
            cv2.remap(moved, u, v, cv2.INTER_LINEAR).astype(np.float64), patch)[0]
        outline = outline / max(float(np.linalg.norm(outline)), 1e-9)
        return _View(patch, change - np.outer(change @ outline, outline), jacobian[0], outline)


def _blurred(image: Patches, sigma: Sequence[float]) -> Patches:
    """Return an image after a Gaussian low-pass, 1-sigma in px down and across."""
    size = [2 * math.ceil(3 * s) + 1 for s in sigma]
    return np.asarray(cv2.GaussianBlur(image, size[::-1], sigmaX=sigma[1], sigmaY=sigma[0],
                                       borderType=cv2.BORDER_REPLICATE))


def _clipped(crop: Patches, dtype: np.dtype[Any], noise: NoiseConfig) -> Optional[Patches]:
    """
    Return where an image is clipped or near that, as ones; None where nothing is.

    Light from a lamp spreads by some pixels in the lens, and much of that is clipped, too: as
    seen from afar, the lamp is the larger beside the front.
    """
    clipped = (crop >= noise.clipped_share * np.iinfo(dtype).max).astype(np.uint8)
    if not clipped.any():
        return None
    size = 2 * round(noise.clipped_reach_px) + 1
    return cv2.dilate(clipped, np.ones((size, size), np.uint8)).astype(np.float32)


def _area(quad: Array) -> float:
    x, y = quad[:, 0], quad[:, 1]
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)
