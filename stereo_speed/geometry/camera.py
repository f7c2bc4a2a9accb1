# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""One camera: rays in, raw pixels out, and back."""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
import math

import numpy as np

from .distortion import Distortion, equidistant, invert, largest_radius, polynomial
from ..core.errors import CalibrationError
from ..core.records import Array

# Numbers of coefficients that each model takes; fewer than it can have are zeros.
MODELS = {
    'plumb_bob': (0, 4, 5), 'rational_polynomial': (0, 4, 5, 8, 12, 14), 'equidistant': (0, 4)}

_NEAREST_M = 1e-6  # nearer than this to the camera's plane counts as behind it


@dataclass(frozen=True, eq=False)
class Camera:
    """
    A calibrated camera of one of the models of ``sensor_msgs/CameraInfo``.

    :param name: for messages, such as ``left``.
    :param width_px: image width.
    :param height_px: image height.
    :param K: (3, 3) intrinsic matrix of the raw image.
    :param D: (n,) distortion coefficients in OpenCV's order.
    :param model: ``plumb_bob``, ``rational_polynomial`` or ``equidistant``.
    """

    name: str
    width_px: int
    height_px: int
    K: Array
    D: Array
    model: str

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
        """Refuse what cannot be a camera."""
        if self.model not in MODELS:
            raise CalibrationError(
                self.name, 'distortion_model', repr(self.model), 'one of ' + ', '.join(MODELS))
        if self.D.size not in MODELS[self.model]:
            wanted = ' or '.join(str(n) for n in MODELS[self.model])
            raise CalibrationError(
                self.name, 'D', f'{self.D.size} coefficients', f'{wanted} for {self.model}')
        for key in ('K', 'D'):
            if not np.all(np.isfinite(getattr(self, key))):
                raise CalibrationError(
                    self.name, key, getattr(self, key).ravel().tolist(), 'finite numbers')
        if not (self.K[0, 0] > 0 and self.K[1, 1] > 0 and self.K[2, 2] == 1):
            raise CalibrationError(
                self.name, 'K', self.K.ravel().tolist(), 'focal lengths > 0 and K[8] = 1')
        if not (self.width_px > 0 and self.height_px > 0):
            raise CalibrationError(
                self.name, 'size', f'{self.width_px}x{self.height_px}', 'an image size > 0')

    @cached_property
    def _lens(self) -> Distortion | None:
        """Give the distortion in normalised coordinates; None where there is none."""
        if self.model == 'equidistant':
            return partial(equidistant, coefficients=np.pad(self.D, (0, 4 - self.D.size)))
        if not np.any(self.D):
            return None
        return partial(polynomial, coefficients=np.pad(self.D, (0, 14 - self.D.size)))

    @cached_property
    def _limit(self) -> float:
        """Tangent of the widest ray for which the lens model holds."""
        return math.inf if self._lens is None else largest_radius(self._lens)

    def distort(self, xy: Array) -> Array:
        """
        Turn undistorted normalised coordinates into raw pixels.

        :param xy: (..., 2) coordinates at depth 1.
        """
        xy = np.asarray(xy, dtype=np.float64)
        if self._lens is not None:
            xy = self._lens(xy)
        k = self.K
        u = k[0, 0] * xy[..., 0] + k[0, 1] * xy[..., 1] + k[0, 2]
        return np.stack([u, k[1, 1] * xy[..., 1] + k[1, 2]], axis=-1)

    def undistort(self, uv_px: Array) -> Array:
        """
        Turn raw pixels into undistorted normalised coordinates; NaN where there is no such ray.

        :param uv_px: (..., 2).
        """
        uv_px, k = np.asarray(uv_px, dtype=np.float64), self.K
        y = (uv_px[..., 1] - k[1, 2]) / k[1, 1]
        xy = np.stack([(uv_px[..., 0] - k[0, 2] - k[0, 1] * y) / k[0, 0], y], axis=-1)
        return xy if self._lens is None else invert(self._lens, xy, self._limit)

    def rays(self, uv_px: Array) -> Array:
        """
        Give the rays of raw pixels, scaled to depth 1.

        :param uv_px: (..., 2).
        """
        xy = self.undistort(uv_px)
        return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)

    def project(self, points_m: Array) -> tuple[Array, np.ndarray]:
        """
        Project points; say which are in front of the camera and inside the image.

        Points behind the camera get NaN. Rays wider than the lens model holds for are never
        valid: its polynomial may fold them back into the image.

        :param points_m: (..., 3) in this camera's frame.
        """
        points_m = np.asarray(points_m, dtype=np.float64)
        front = points_m[..., 2] > _NEAREST_M
        z = np.where(front, points_m[..., 2], np.nan)
        xy = points_m[..., :2] / z[..., None]
        uv_px = self.distort(xy)
        valid = front & self.inside(uv_px)
        if math.isfinite(self._limit):
            valid &= np.hypot(xy[..., 0], xy[..., 1]) <= self._limit
        return uv_px, valid

    def inside(self, uv_px: Array) -> np.ndarray:
        """
        Say which pixels lie in the image; its edge is half a pixel beyond the outer centres.

        :param uv_px: (..., 2).
        """
        u, v = uv_px[..., 0], uv_px[..., 1]
        with np.errstate(invalid='ignore'):
            return ((u >= -0.5) & (u <= self.width_px - 0.5)
                    & (v >= -0.5) & (v <= self.height_px - 0.5))
