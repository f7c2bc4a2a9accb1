# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""One camera's view of the simulated world: rays on dense grids, and exact pixel coverage."""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from ...core.records import Array
from ...geometry.camera import Camera
from ...geometry.rig import StereoRig

KNOT_PX = 16  # knot spacing of the spline of a distorted camera's rays; accurate to 1e-4 px
MARGIN_PX = 32.0


@dataclass(frozen=True, eq=False)
class View:
    """
    A camera in the world.

    :param camera: the camera.
    :param R: (3, 3), rotation from the left optical frame to the camera's.
    :param t: (3,), translation likewise, m.
    """

    camera: Camera
    R: Array
    t: Array

    @cached_property
    def centre_m(self) -> Array:
        """Return its centre in the left optical frame, m."""
        return -self.R.T @ self.t

    @cached_property
    def _splines(self) -> tuple[RectBivariateSpline, RectBivariateSpline]:
        c = self.camera
        u = np.arange(-MARGIN_PX, c.width_px + MARGIN_PX + KNOT_PX, KNOT_PX)
        v = np.arange(-MARGIN_PX, c.height_px + MARGIN_PX + KNOT_PX, KNOT_PX)
        xy = c.undistort(np.stack(np.meshgrid(u, v), axis=-1))
        return (RectBivariateSpline(v, u, xy[..., 0]), RectBivariateSpline(v, u, xy[..., 1]))

    def normalized(self, u_px: Array, v_px: Array) -> tuple[Array, Array]:
        """
        Return x and y at depth 1, (rows, columns) each, of a regular grid of raw pixels.

        :param u_px: (columns,) ascending.
        :param v_px: (rows,) ascending.
        """
        c = self.camera
        if not c.lens.ideal:
            x, y = (np.asarray(spline(v_px, u_px)) for spline in self._splines)
            return x, y
        y = ((v_px - c.K[1, 2]) / c.K[1, 1])[:, None] + 0.0 * u_px
        return (u_px - c.K[0, 2] - c.K[0, 1] * y) / c.K[0, 0], y

    def ray_grid(self, u_px: Array, v_px: Array) -> Array:
        """Return the rays (rows, columns, 3) of a regular grid in the left frame, at depth 1."""
        x, y = self.normalized(u_px, v_px)
        # Row vectors: (x, y, 1) R is the ray in the left frame.
        return np.asarray(x[..., None] * self.R[0] + y[..., None] * self.R[1] + self.R[2])

    def project(self, points_m: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return raw pixels (..., 2) of points of the left frame, and their validity."""
        return self.camera.project(np.asarray(points_m) @ self.R.T + self.t)


def rig_views(rig: StereoRig) -> tuple[View, View]:
    """Return the views of a rig's left and right camera."""
    return View(rig.left, np.eye(3), np.zeros(3)), View(rig.right, rig.R, rig.t)


def below(gap: Array, gx: Array, gy: Array) -> Array:
    """
    Return the share of a pixel where a quantity is below a level.

    The quantity is assumed linear over the pixel, a box of size 1 x 1. Its distribution is that of
    the sum of two uniform variables, so that the share is exact for a straight edge.

    :param gap: level minus the quantity at the pixel's centre.
    :param gx: its derivative to the right, per pixel.
    :param gy: its derivative downwards, per pixel.
    """
    gx, gy = np.abs(gx), np.abs(gy)
    a = np.maximum(np.maximum(gx, gy), 1e-9) / 2
    b = np.maximum(np.minimum(gx, gy) / 2, 0.01 * a)

    def ramp(x: Array) -> Array:
        return np.square(np.maximum(x, 0.0))
    total = ramp(gap + a + b) - ramp(gap + a - b) - ramp(gap - a + b) + ramp(gap - a - b)
    return np.clip(total / (8 * a * b), 0.0, 1.0)
