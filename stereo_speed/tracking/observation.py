# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
One observation of the front: its patch in both views at a pose, and derivatives by the pose.

Particles are sampled coarsely and fast.  The refinement needs observations that are accurate to
hundredths of a pixel, so these use the exact lens model and cubic B-splines.
"""
from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
import math
from typing import Any, NamedTuple, Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .front import Front, plane_points
from .observation_kernels import normalised_change, Spread, spread, Views, views, without
from .relief import relief_basis
from .sharpness import grown_blurs_px
from ..core.records import Array, StereoPair
from ..core.right_of_way import give_way
from ..core.tracker_config import NoiseConfig
from ..geometry.rig import StereoRig
from ..vision.encoding import blurred, DARK_SHARE, light_blurred, to_grey, to_light
from ..vision.grey import white_level
from ..vision.sampling import low_pass_crop, Patches

# Inner share of the quad that is sampled: its corners are a pixel off, and the background beyond
# the front's edges moves differently.
_INNER = 0.94
_STEP_M = 1e-4  # step of numerical derivatives of the geometry; a curved path is straight over it
_STEPS: Array = _STEP_M * np.eye(4, 3, -1)  # no step, and one along each axis of a pose
_BLUR_STEPS = 0.6  # 1-sigma of the low-pass in grid steps, so that near and far are comparable
_BORDER_PX = 3  # border around the samples that the low-pass and the splines need
_NOTHING: Patches = np.zeros((0, 0), np.float32)  # mask of an image without clipped pixels
# Glare.  The darkest quarter of the places around lamps tells it from what is light by itself.
_RING_PX, _DARK_QUARTER = 1.5, 0.25
_SPOT_PX = 3  # least width and height of a lamp; smaller highlights do not light what is around
_LEVEL_RANGE = 0.2  # range of levels, of full scale, over which surroundings become glare
_GLARE_REACH = 2.0  # its width beyond the reach, in half widths of the clipped area
_DEEPER = math.sqrt(2)  # factor from one to the next distance from the edge of a clipped area
_LEAST_OUTLINE = 1e-6  # length of outlines below which a part of a front has none
_LEAST_CONTRAST = 1e-6  # standard deviation below which a part of a patch has none


@dataclass(frozen=True, eq=False)
class Observation:
    """
    A linearised observation of the front in one pair; instances compare by identity.

    :param pose: (3,) s, a, b at which it was taken, m.
    :param heading_rad: heading of the vehicle against the path at which it was taken.
    :param relief: (M,) relief of the front at the nodes with which it was taken, m.
    :param patches: (2, G) left and right patch, zero mean and unit variance.
    :param jacobian: (2, 3, G) derivatives of the patches by the pose, 1/m.
    :param relief_jacobian: (2, G) derivatives of each sample by its own relief, 1/m.
    :param outlines: (2, G) change of each patch when the outlines of clipped areas move outwards,
        scaled to unit length; 0 without clipped areas.  The derivatives are orthogonal to it.
    :param glare: (2, G) share of each sample that lies in the glare of clipped areas.
    :param by_blur: (2, G) change of each patch off clipped areas by Gaussian blur, per half the
        variance of the blur in steps of the grid.
    :param apart_jacobian: (3, G) derivatives of the left minus the right patch by the pose, 1/m.
        Both use the mean image gradient of the views: with separate gradients, their noise times
        the common motion of the views would look like a change of disparity.
    :param apart_relief: (G,) the same by the relief of each sample, 1/m.
    :param pixels: number of pixels that the patch covers, at most one per grid sample.
    :param shift_px: (2, 3) motion of the front's centre in each view per pose, px/m.
    :param disparity_px: (3,) change of its disparity per pose, px/m.
    :param velocity_mps: (3,) rates of the pose with which it was taken, m/s.
    :param lag_s: how much later the right view was exposed, s.
    :param skew_px: motion of the front in the right view during the difference of stamps that is
        taken for an error, px.
    """

    pose: Array
    heading_rad: float
    relief: Array
    patches: Array
    jacobian: Array
    relief_jacobian: Array
    outlines: Array
    glare: Array
    by_blur: Array
    apart_jacobian: Array
    apart_relief: Array
    pixels: float
    shift_px: Array
    disparity_px: Array
    velocity_mps: Array
    lag_s: float
    skew_px: float

    @property
    def right_m(self) -> float:
        """Return the distance along the path until the right view was exposed, m."""
        return self.lag_s * float(self.velocity_mps[0])

    @property
    def cross_ncc(self) -> float:
        """Return the correlation of its two patches."""
        return float(self.patches[0] @ self.patches[1] / self.patches.shape[1])

    def part(self, which: NDArray[np.bool_]) -> Observation:
        """
        Return the observation of a part of the front.

        Its grey values keep the mean and the scale of the whole front.

        :param which: (G,) its samples.
        """
        def of(values: Array) -> Array:
            return np.compress(which, values, axis=-1)  # contiguous, as kernels take it
        patches = of(self.patches)
        normalised = _standardised(patches)
        outlines = normalised_change(of(self.outlines)[:, None], normalised)[:, 0]
        outlines /= np.maximum(np.linalg.norm(outlines, axis=1, keepdims=True), _LEAST_OUTLINE)
        return replace(
            self, patches=patches, outlines=outlines,
            jacobian=without(normalised_change(of(self.jacobian), normalised), outlines),
            relief_jacobian=of(self.relief_jacobian), glare=of(self.glare),
            by_blur=normalised_change(of(self.by_blur)[:, None], normalised)[:, 0],
            apart_jacobian=normalised_change(
                of(self.apart_jacobian), _standardised(patches.mean(axis=0))),
            apart_relief=of(self.apart_relief), pixels=self.pixels * float(which.mean()))


class _Crop(NamedTuple):
    """
    The part of a view that the samples need, its light low-passed to their spacing.

    :param smooth: (h, w) grey levels.
    :param near: (h, w) mask of clipped areas and their outlines; (0, 0) if there are none.
    :param glare: (h, w) mask of their glare; (0, 0) if there are none.
    :param origin: (2,) column and row of the image where it begins.
    """

    smooth: Patches
    near: Patches
    glare: Patches
    origin: NDArray[np.float32]

    def glare_at(self, at: Array) -> Array:
        """Return the share of glare (G,) at columns and rows (2, G) of the image."""
        if not self.glare.size:
            return np.zeros(at.shape[1])
        u, v = (at - self.origin[:, None]).astype(np.float32)
        share = cv2.remap(self.glare, u[:, None], v[:, None], cv2.INTER_LINEAR,
                          borderMode=cv2.BORDER_REPLICATE)[:, 0]
        return np.clip(share.astype(np.float64), 0.0, 1.0)


class ObservationSampler:
    """
    Makes observations of one front, on a fixed grid of its plane, for any pose and pair.

    :param rig: the cameras.
    :param front: the front.
    :param unit_xy: (G, 2) grid samples in the unit square.
    :param grid_shape: rows and columns of the grid.
    :param noise: parameters; here, of clipped areas.

    ``blur_px`` is the 1-sigma of the blur of the left and the right view that makes the sharper
    one as blurred as the other, px: see :mod:`.sharpness`.  It was estimated when the front
    covered ``blurred_at_px`` pixels in a view, and acts on the light of which grey levels are the
    ``blur_gamma``-th root.
    """

    def __init__(self, rig: StereoRig, front: Front, unit_xy: Array,
                 grid_shape: tuple[int, int], noise: NoiseConfig = NoiseConfig()) -> None:
        self.rig, self.front, self.grid_shape, self.noise = rig, front, grid_shape, noise
        inner = 0.5 + _INNER * (unit_xy - 0.5)
        self._plane_m = np.concatenate([front.grid_m(inner), front.corners_m])
        self._count = len(unit_xy)
        self.blur_px: tuple[float, float] = (0.0, 0.0)
        self.blurred_at_px = math.inf
        self.blur_gamma = noise.gamma
        self.relief_basis = relief_basis(unit_xy)

    def less_blurred(self) -> list[ObservationSampler]:
        """
        Return two samplers, one that blurs evenly and one without blur, if this one blurs.

        Blur is only a model of a view out of focus; the differences between these samplers bound
        the error of the model.
        """
        if not any(self.blur_px):
            return []
        even, sharp = copy(self), copy(self)
        even.blurred_at_px, sharp.blur_px = math.inf, (0.0, 0.0)
        return [even, sharp]

    def observe(self, pair: StereoPair, pose: Array, velocity_mps: Array, heading_rad: float,
                relief: Array) -> Optional[Observation]:
        """
        Return an observation with its derivatives; None where the front is not in both images.

        :param pose: (3,) s, a, b at the left stamp, m.
        :param velocity_mps: (3,) their rates, m/s, for a right view that was exposed later.
        :param heading_rad: heading of the vehicle against the path.
        :param relief: (M,) relief of the front at its nodes, m.
        """
        give_way()
        n, lag = self._count, pair.right_lag_s
        poses = pose + _STEPS
        depth = np.zeros(n + 4)
        depth[:n] = self.relief_basis @ relief
        points = plane_points(self.front.path, poses, self._plane_m, heading_rad, depth)
        later = points if lag == 0 else plane_points(
            self.front.path, poses + lag * velocity_mps, self._plane_m, heading_rad, depth)
        left, right, in_left, in_right = self.rig.as_taken(pair.motion).project(points, later)
        if not (in_left[0].all() and in_right[0].all()):
            return None
        lie = Spread(*spread(left, right, *self.grid_shape, _STEP_M))
        covered_px = 0.5 * n * float(lie.apart.prod(axis=1).sum())
        whites = [white_level([image]) for image in (pair.left, pair.right)]
        crops = [self._cropped(
            image, white, bounds, (_BLUR_STEPS * apart).tolist(), float(blur_px))
                 for image, white, bounds, apart, blur_px in zip(
                     (pair.left, pair.right), whites, lie.bounds, lie.apart,
                     grown_blurs_px(self.blur_px, covered_px / self.blurred_at_px))]
        origins = np.array([crop.origin for crop in crops], dtype=np.float64)
        seen = Views(*views(crops[0].smooth, crops[0].near, crops[1].smooth, crops[1].near,
                            origins, lie.at, lie.motion, lie.apart, self.noise.gamma,
                            DARK_SHARE * max(whites)))
        glare = np.stack([crop.glare_at(at) for crop, at in zip(crops, lie.at)])
        per_m = np.hypot(lie.centre[..., 0], lie.centre[..., 1])
        return Observation(
            pose=pose, heading_rad=heading_rad, relief=relief, **seen._asdict(), glare=glare,
            pixels=min(0.5 * float(lie.area.sum()), float(n)), shift_px=per_m,
            disparity_px=lie.centre[0, :, 0] - lie.centre[1, :, 0],
            velocity_mps=velocity_mps, lag_s=lag,
            skew_px=float(np.linalg.norm(velocity_mps @ lie.centre[1]) * abs(pair.stamp_error_s)))

    def blurred_patches(self, pair: StereoPair, pose: Array, velocity_mps: Array,
                        blurs_px: Sequence[tuple[float, float]], gammas: Sequence[float]
                        ) -> Optional[tuple[Array, float]]:
        """
        Return the patches of both views with each of n trial blurs, on each of k roots of light.

        :param pose: (3,) as for :meth:`observe`.
        :param velocity_mps: (3,) as for :meth:`observe`.
        :param blurs_px: 1-sigmas of the left and the right view, px, of each trial.
        :param gammas: they act on the light of which grey levels are this root.
        :return: (k, n, 2, G) patches and the number of pixels that they cover in a view; None
            where the front is not in both images.
        """
        rig, where = self.rig.as_taken(pair.motion), self._plane_m[:self._count]
        poses = np.stack([pose, pose + pair.right_lag_s * velocity_mps])
        on_left, on_right = plane_points(self.front.path, poses, where)
        views = (*rig.left.project(on_left), *rig.right.project(rig.to_right(on_right)))
        if not (views[1].all() and views[3].all()):
            return None
        out, pixels = np.empty((len(gammas), len(blurs_px), 2, self._count)), 0.0
        for side, (image, uv) in enumerate(((pair.left, views[0]), (pair.right, views[2]))):
            grid = uv.reshape(*self.grid_shape, 2)
            apart = [float(np.linalg.norm(np.diff(grid, axis=k), axis=-1).mean()) for k in (0, 1)]
            pixels += 0.5 * self._count * apart[0] * apart[1]
            crop, origin = low_pass_crop(
                image, uv.min(axis=0) - _BORDER_PX, uv.max(axis=0) + _BORDER_PX, 1.0)
            at = (uv - origin).astype(np.float32)
            for patches, gamma in zip(out, gammas):
                light = to_light(crop, gamma)
                for patch, blurs in zip(patches[:, side], blurs_px):
                    smooth = to_grey(blurred(
                        light, [math.hypot(_BLUR_STEPS * a, blurs[side]) for a in apart]), gamma)
                    patch[:] = cv2.remap(smooth, at[:, :1], at[:, 1:], cv2.INTER_CUBIC)[:, 0]
        return out, pixels

    def _cropped(self, image: NDArray[Any], white: int, bounds: Array, low_pass: Sequence[float],
                 blur_px: float) -> _Crop:
        """
        Return the part of a view that the samples need, softened and low-passed to their spacing.

        :param white: grey level of full scale.
        :param bounds: (2, 2) least and greatest pixel of the samples.
        :param low_pass: 1-sigma of the low-pass down and across, px.
        :param blur_px: 1-sigma of the blur that makes it as soft as the other view, px.
        """
        crop, origin = low_pass_crop(image, bounds[0] - _BORDER_PX, bounds[1] + _BORDER_PX, 1.0)
        clipped = _clipped(crop, white, self.noise)
        soft = light_blurred(crop, (blur_px, blur_px), self.blur_gamma) if blur_px else crop
        smooth = light_blurred(soft, low_pass, self.noise.gamma)
        if clipped is None:
            return _Crop(smooth, _NOTHING, _NOTHING, origin)
        # Light from a lamp spreads by some pixels in the lens, and much of that is clipped too:
        # the further away the front, the larger the lamp relative to it.
        sigma = [math.hypot(one, blur_px) for one in low_pass]
        near = blurred(_dilated(clipped, self.noise.clipped_reach_px).astype(np.float32), sigma)
        # How much light is lost there is not known, so the low-pass averages grey levels.
        smooth += near * (blurred(soft, low_pass) - smooth)
        glare = _glare(crop, clipped, white, self.noise)
        return _Crop(smooth, near, _NOTHING if glare is None else blurred(glare, sigma), origin)


def _standardised(patches: Array) -> Array:
    """Return patches (..., G) with zero mean and unit variance, or 0 without contrast."""
    off = patches - patches.mean(axis=-1, keepdims=True)
    return np.asarray(off / np.maximum(off.std(axis=-1, keepdims=True), _LEAST_CONTRAST))


def _clipped(crop: Patches, white: int, noise: NoiseConfig) -> Optional[NDArray[np.uint8]]:
    """Return a mask of clipped pixels; None if there are none."""
    most = noise.clipped_share * white
    return (crop >= most).astype(np.uint8) if crop.max() >= most else None


def _glare(crop: Patches, clipped: NDArray[np.uint8], white: int, noise: NoiseConfig
           ) -> Optional[Patches]:
    """
    Return the share of each pixel that lies in the glare of clipped areas; None if there is none.

    Of strong lamps so much light spreads in a lens, or in rain on it, that the surroundings are
    bright on all sides, the farther out the larger the clipped area. Spots do not count.

    :param clipped: (h, w) mask of clipped pixels.
    """
    spot = np.ones((_SPOT_PX, _SPOT_PX), np.uint8)
    lamps = cv2.morphologyEx(clipped, cv2.MORPH_OPEN, spot)
    if not lamps.any():
        return None
    beyond_px = cv2.distanceTransform(1 - lamps, cv2.DIST_L2, cv2.DIST_MASK_5) \
        - noise.clipped_reach_px
    around = crop[(beyond_px > 0) & (beyond_px <= _RING_PX)]
    level = float(np.quantile(around, _DARK_QUARTER)) / white if around.size else 1.0
    share = min(max((level - noise.glare_level) / _LEVEL_RANGE + 0.5, 0.0), 1.0)
    if not share:
        return None
    depth_px = cv2.distanceTransform(
        np.pad(lamps, 1), cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1]
    out = np.zeros(lamps.shape, np.uint8)
    inside_px, deepest_px = 1.0, float(depth_px.max())
    while inside_px <= deepest_px and not out.all():
        core = (depth_px >= inside_px).astype(np.uint8)
        out |= _dilated(core, noise.clipped_reach_px + (1 + _GLARE_REACH) * inside_px)
        inside_px *= _DEEPER
    return np.float32(share) * out.astype(np.float32)


def _dilated(mask: NDArray[np.uint8], by_px: float) -> NDArray[np.uint8]:
    size = 2 * round(by_px) + 1
    return np.asarray(cv2.dilate(mask, np.ones((size, size), np.uint8)), np.uint8)
