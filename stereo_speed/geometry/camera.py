# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A camera: projection of rays to raw pixels, and the inverse."""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from typing import Optional

import numpy as np
from numpy.typing import NDArray

from .distortion import Lens, LENSES
from .projection import NEAREST_M, projected, Projection
from ..core.errors import CalibrationError
from ..core.records import Array


_LARGEST = 1e6  # larger than any focal length in px and any coefficient of a lens
_LEAST_FOCAL_PX = 1.0  # with such a focal length, half a sphere would be two pixels wide


@dataclass(frozen=True, eq=False)
class Camera:
    """
    A calibrated camera of one of the models of ``sensor_msgs/CameraInfo``.

    :param name: name for messages, such as ``left``.
    :param width_px: image width, px.
    :param height_px: image height, px.
    :param K: (3, 3) intrinsic matrix of the raw image.
    :param D: (n,) distortion coefficients in OpenCV's order.
    :param model: name of the lens model, one of ``LENSES``.
    :param rotation: (3, 3) rotation from the frame of points and rays to the camera's optical
        frame, for a camera that sways; None if the two frames are the same.
    """

    name: str
    width_px: int
    height_px: int
    K: Array
    D: Array
    model: str
    rotation: Optional[Array] = None

    def __post_init__(self) -> None:
        for key, shape in (('K', (3, 3)), ('D', (-1,))):
            try:
                array = np.array(getattr(self, key), dtype=np.float64).reshape(shape)
            except (TypeError, ValueError):
                raise CalibrationError(self.name, key, getattr(self, key), 'numbers') from None
            array.setflags(write=False)
            object.__setattr__(self, key, array)
        self._check()

    def _check(self) -> None:
        """Refuse values that cannot be those of a camera."""
        if self.model not in LENSES:
            raise CalibrationError(
                self.name, 'distortion_model', repr(self.model), 'one of ' + ', '.join(LENSES))
        sizes = LENSES[self.model].sizes
        if self.D.size not in sizes:
            wanted = ' or '.join(str(n) for n in sizes)
            raise CalibrationError(
                self.name, 'D', f'{self.D.size} coefficients', f'{wanted} for {self.model}')
        for key in ('K', 'D'):
            if not np.all(np.abs(getattr(self, key)) <= _LARGEST):
                raise CalibrationError(
                    self.name, key, getattr(self, key).ravel().tolist(),
                    f'finite numbers up to {_LARGEST:g}')
        if not (min(self.K[0, 0], self.K[1, 1]) >= _LEAST_FOCAL_PX and self.K[2, 2] == 1):
            raise CalibrationError(
                self.name, 'K', self.K.ravel().tolist(),
                f'focal lengths > 0, {_LEAST_FOCAL_PX:g} px or more, and K[8] = 1')
        if not (self.width_px > 0 and self.height_px > 0):
            raise CalibrationError(
                self.name, 'size', f'{self.width_px}x{self.height_px}', 'an image size > 0')

    @cached_property
    def lens(self) -> Lens:
        """Return the lens, which distorts normalised coordinates."""
        return LENSES[self.model](self.D)

    @cached_property
    def projection(self) -> Projection:
        """Return the camera in the form that the projection kernel takes."""
        return Projection.of(self.lens, self.K, (self.width_px, self.height_px), self.rotation)

    def distort(self, xy: Array) -> Array:
        """
        Return the raw pixels of undistorted normalised coordinates.

        :param xy: (..., 2) coordinates at depth 1.
        """
        xy, k = self.lens.distort(np.asarray(xy, dtype=np.float64)), self.K
        u = k[0, 0] * xy[..., 0] + k[0, 1] * xy[..., 1] + k[0, 2]
        return np.stack([u, k[1, 1] * xy[..., 1] + k[1, 2]], axis=-1)

    def undistort(self, uv_px: Array) -> Array:
        """
        Return the undistorted normalised coordinates of raw pixels; NaN where there is no ray.

        :param uv_px: (..., 2) raw pixels.
        """
        uv_px, k = np.asarray(uv_px, dtype=np.float64), self.K
        y = (uv_px[..., 1] - k[1, 2]) / k[1, 1]
        x = (uv_px[..., 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
        return self.lens.undistort(np.stack([x, y], axis=-1))

    def rays(self, uv_px: Array) -> Array:
        """
        Return the rays of raw pixels, (..., 3), scaled to depth 1.

        :param uv_px: (..., 2) raw pixels.
        """
        xy = self.undistort(uv_px)
        rays = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        if self.rotation is None:
            return rays
        rays = rays @ self.rotation
        return np.asarray(rays / rays[..., 2:])

    def project(self, points_m: Array) -> tuple[Array, NDArray[np.bool_]]:
        """
        Return the pixels of points, and which of them are in front of the camera and in the image.

        Points behind the camera get NaN. Points beyond the radius where the lens model is valid
        are never valid, because its polynomial may fold them back into the image.

        :param points_m: (..., 3) points in this camera's frame or, if ``rotation`` is given, in
            the frame that it starts from, m.
        """
        points_m = np.asarray(points_m, dtype=np.float64)
        if self.projection.known:
            return projected(points_m, self.projection)
        if self.rotation is not None:
            points_m = points_m @ self.rotation.T
        front = points_m[..., 2] > NEAREST_M
        z = np.where(front, points_m[..., 2], np.nan)
        xy = points_m[..., :2] / z[..., None]
        uv_px = self.distort(xy)
        valid = front & self.inside(uv_px)
        if math.isfinite(self.lens.limit):
            valid &= np.hypot(xy[..., 0], xy[..., 1]) <= self.lens.limit
        return uv_px, valid

    def metres_per_px(self, depth_m: float) -> Array:
        """Return the size (2,) of a pixel across and down at a depth, m, without distortion."""
        return np.asarray(depth_m / self.K[[0, 1], [0, 1]])

    def holds(self, uv_px: Array) -> bool:
        """Return whether all pixels (..., 2) lie in the image."""
        return bool(self.inside(uv_px).all())

    def inside(self, uv_px: Array) -> NDArray[np.bool_]:
        """
        Return which pixels lie in the image, whose edge is half a pixel beyond the pixel centres.

        :param uv_px: (..., 2) raw pixels.
        """
        u, v = uv_px[..., 0], uv_px[..., 1]
        with np.errstate(invalid='ignore'):
            return ((u >= -0.5) & (u <= self.width_px - 0.5)
                    & (v >= -0.5) & (v <= self.height_px - 0.5))
