# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Projection of points to raw pixels through a lens: the kernel of ``Camera.project``."""
from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .distortion import Equidistant, Lens, RationalPolynomial
from ..core.compiled import kernel
from ..core.records import Array

NEAREST_M = 1e-6  # depth up to which a point counts as behind the camera
_IDEAL, _RATIONAL, _EQUIDISTANT, _OTHER = range(4)
_NEAR_AXIS = 1e-12  # same as in ``distortion``


class Projection(NamedTuple):
    """
    A camera in the form that the kernel takes.

    :param kind: kind of the lens.
    :param coefficients: (14,) coefficients of the lens.
    :param limit: radius up to which the lens model is valid.
    :param focal: (3,) fx, fy and skew, px.
    :param centre: (2,) principal point, px.
    :param size: (2,) width and height of the image, px.
    :param rotation: (3, 3) rotation from the points' frame to the camera's.
    :param offset_m: (3,) origin of the points' frame in the camera's frame, m.
    """

    kind: int
    coefficients: Array
    limit: float
    focal: Array
    centre: Array
    size: Array
    rotation: Array
    offset_m: Array

    @classmethod
    def of(cls, lens: Lens, K: Array, size: tuple[int, int], rotation: Array | None
           ) -> Projection:
        """Return the projection of a camera with a given lens and intrinsic matrix."""
        kind = _OTHER
        if lens.ideal:
            kind = _IDEAL
        elif isinstance(lens, Equidistant):
            kind = _EQUIDISTANT
        elif isinstance(lens, RationalPolynomial) and not lens.coefficients[12:].any():
            kind = _RATIONAL
        coefficients = np.zeros(14)
        if kind in (_RATIONAL, _EQUIDISTANT):
            coefficients[:lens.size] = lens.coefficients
        return cls(kind, coefficients, lens.limit, np.array([K[0, 0], K[1, 1], K[0, 1]]),
                   np.array([K[0, 2], K[1, 2]]), np.array(size, dtype=np.float64),
                   np.eye(3) if rotation is None else np.ascontiguousarray(rotation), np.zeros(3))

    def seen_from(self, R: Array, t: Array) -> Projection:
        """
        Return the same camera for points in another frame.

        :param R: (3, 3) rotation from the new frame to the current one.
        :param t: (3,) origin of the new frame in the current one, m.
        """
        return self._replace(rotation=self.rotation @ R,
                             offset_m=self.rotation @ t + self.offset_m)

    @property
    def known(self) -> bool:
        """Return whether the kernel supports the lens; it does not support tilted sensors."""
        return self.kind != _OTHER


def raw_pixels(xy: Array, kind: int, k: Array, focal: Array, centre: Array) -> Array:
    """Return the raw pixels (..., 2) of undistorted coordinates, see :class:`Projection`."""
    if kind != _IDEAL:
        lens = Equidistant(k[:4]) if kind == _EQUIDISTANT else RationalPolynomial(k)
        xy = lens.distort(xy)
    return np.asarray(centre + np.stack(
        [focal[0] * xy[..., 0] + focal[2] * xy[..., 1], focal[1] * xy[..., 1]], axis=-1))


def _plain(points_m: Array, *camera: Any) -> tuple[Array, NDArray[np.bool_]]:
    """Return pixels (n, 2) of points (n, 3), NaN behind the camera, and a mask of valid ones."""
    kind, k, limit, focal, centre, size, rotation, offset_m = camera
    points_m = points_m @ rotation.T + offset_m
    front = points_m[:, 2] > NEAREST_M
    xy = points_m[:, :2] / np.where(front, points_m[:, 2], np.nan)[:, None]
    uv = raw_pixels(xy, kind, k, focal, centre)
    with np.errstate(invalid='ignore'):
        valid = front & ((uv >= -0.5) & (uv <= size - 0.5)).all(axis=1)
        if np.isfinite(limit):
            valid &= np.hypot(xy[:, 0], xy[:, 1]) <= limit
    return uv, valid


@kernel(_plain, '(f8[:,::1], i8, f8[::1], f8, f8[::1], f8[::1], f8[::1], f8[:,::1], f8[::1])')
def project(points_m: Any, kind: int, k: Any, limit: float, focal: Any, centre: Any, size: Any,
            rotation: Any, offset_m: Any) -> Any:
    """Return what :func:`_plain` returns."""
    n = len(points_m)
    uv, valid = np.empty((n, 2)), np.zeros(n, np.bool_)
    for i in range(n):
        p, q, r = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        z = rotation[2, 0] * p + rotation[2, 1] * q + rotation[2, 2] * r + offset_m[2]
        if not z > NEAREST_M:
            uv[i, 0] = uv[i, 1] = np.nan
            continue
        x = (rotation[0, 0] * p + rotation[0, 1] * q + rotation[0, 2] * r + offset_m[0]) / z
        y = (rotation[1, 0] * p + rotation[1, 1] * q + rotation[1, 2] * r + offset_m[1]) / z
        r2 = x * x + y * y
        a, b = x, y
        if kind == _RATIONAL:
            radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (
                1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
            a = (x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x)
                 + r2 * (k[8] + r2 * k[9]))
            b = (y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y
                 + r2 * (k[10] + r2 * k[11]))
        elif kind == _EQUIDISTANT:
            radius = np.sqrt(r2)
            if radius > _NEAR_AXIS:
                theta = np.arctan(radius)
                t2 = theta * theta
                theta *= 1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))
                a, b = x * theta / radius, y * theta / radius
        u = focal[0] * a + focal[2] * b + centre[0]
        v = focal[1] * b + centre[1]
        uv[i, 0], uv[i, 1] = u, v
        valid[i] = (u >= -0.5 and u <= size[0] - 0.5 and v >= -0.5 and v <= size[1] - 0.5
                    and r2 <= limit * limit)
    return uv, valid


def projected(points_m: Array, camera: Projection) -> tuple[Array, NDArray[np.bool_]]:
    """Return pixels (..., 2) of points (..., 3) in a known camera, and a mask of valid ones."""
    shape = points_m.shape[:-1]
    uv_px, valid = project(np.ascontiguousarray(points_m.reshape(-1, 3)), *camera)
    return uv_px.reshape(*shape, 2), valid.reshape(shape)
