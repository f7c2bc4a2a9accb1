# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Lens models: distortion in normalised image coordinates, and its inverse.

A new camera model is one class here and an entry in ``LENSES``. Coefficients are in OpenCV's
order. All methods take and return (..., 2) arrays.
"""
from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
import math
from typing import ClassVar, Mapping

import numpy as np

from ..core.records import Array

_TOLERANCE = 1e-12  # residual in normalised coordinates at which Newton's method stops
_CONVERGED = 1e-10  # largest residual of a solution in normalised coordinates
_ITERATIONS = 20  # most Newton steps; it needs about five where there is a solution
_STEP = 1e-6  # step of the central differences for the Jacobian
_FAR = 100.0  # tangent of the angle of the widest ray that is considered
_NEAR_AXIS = 1e-12  # radius below which rays are not scaled, as the ratio would be 0 / 0


class Lens(ABC):
    """
    A lens model.

    :param coefficients: (n,) coefficients, with n one of ``sizes``; missing ones are zeros.
    """

    sizes: ClassVar[tuple[int, ...]]  # numbers of coefficients that a calibration may have
    size: ClassVar[int]  # number of coefficients of the formula
    zeros_are_ideal: ClassVar[bool]  # whether a lens without coefficients is a pinhole

    def __init__(self, coefficients: Array) -> None:
        self.coefficients = np.pad(coefficients, (0, self.size - coefficients.size))
        self.ideal = self.zeros_are_ideal and not np.any(coefficients)

    @abstractmethod
    def formula(self, xy: Array) -> Array:
        """Return the distorted coordinates of undistorted ones."""

    def distort(self, xy: Array) -> Array:
        """Return the distorted coordinates of undistorted ones, unchanged for an ideal lens."""
        return xy if self.ideal else self.formula(xy)

    @cached_property
    def limit(self) -> float:
        """
        Return the radius (tangent of the angle) up to which distorted radii increase.

        Beyond it a lens polynomial folds back: rays from far outside the view would land inside
        the image, and the inverse would not be unique.
        """
        if self.ideal:
            return math.inf
        radii = np.tan(np.linspace(0.0, math.atan(_FAR), 4000))
        points = np.stack([radii, np.zeros_like(radii)], axis=-1)
        grows = np.ones(radii.size - 1, dtype=bool)
        for axis in (1, -1):  # both directions, as tangential terms make the two sides differ
            grows &= np.diff(self.formula(axis * points)[:, 0] * axis) > 0
        folded = np.nonzero(~grows)[0]
        return float(radii[folded[0]]) if folded.size else math.inf

    def undistort(self, xy: Array) -> Array:
        """Return the inverse by Newton's method; NaN if it diverges or lies beyond the limit."""
        if self.ideal:
            return xy
        x = self._first_guess(xy)
        ex, ey = np.array([_STEP, 0.0]), np.array([0.0, _STEP])
        with np.errstate(all='ignore'):
            for _ in range(_ITERATIONS):
                error = self.formula(x) - xy
                if not np.any(np.abs(error) > _TOLERANCE):
                    break
                jx = (self.formula(x + ex) - self.formula(x - ex)) / (2 * _STEP)
                jy = (self.formula(x + ey) - self.formula(x - ey)) / (2 * _STEP)
                det = jx[..., 0] * jy[..., 1] - jx[..., 1] * jy[..., 0]
                x = x - np.stack([
                    jy[..., 1] * error[..., 0] - jy[..., 0] * error[..., 1],
                    jx[..., 0] * error[..., 1] - jx[..., 1] * error[..., 0]],
                    axis=-1) / det[..., None]
            bad = ~(np.abs(self.formula(x) - xy).max(axis=-1) < _CONVERGED)
            bad |= ~(np.hypot(x[..., 0], x[..., 1]) <= self.limit)
        return np.where(bad[..., None], np.nan, x)

    def _first_guess(self, xy: Array) -> Array:
        """Return the inverse of the radial part by a table, which suffices as a start."""
        top = math.atan(min(self.limit, _FAR))
        radii = np.tan(np.linspace(0.0, top, 512))
        table = self.formula(np.stack([radii, np.zeros_like(radii)], axis=-1))[:, 0]
        table = np.maximum.accumulate(table - table[0])
        r = np.hypot(xy[..., 0], xy[..., 1])
        return xy * _ratio(np.interp(r, table, radii), r)[..., None]


class RationalPolynomial(Lens):
    """``rational_polynomial``: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty."""

    sizes: ClassVar[tuple[int, ...]] = 0, 4, 5, 8, 12, 14
    size = 14
    zeros_are_ideal = True

    def formula(self, xy: Array) -> Array:
        """Return the distorted coordinates of undistorted ones."""
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y = self.coefficients
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if k4 or k5 or k6:
            radial = radial / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        if s1 or s2 or s3 or s4:
            xd, yd = xd + r2 * (s1 + r2 * s2), yd + r2 * (s3 + r2 * s4)
        out = np.stack([xd, yd], axis=-1)
        return _tilted(out, tau_x, tau_y) if tau_x or tau_y else out


class PlumbBob(RationalPolynomial):
    """``plumb_bob``: k1 k2 p1 p2 k3, the first five of the rational polynomial."""

    sizes = 0, 4, 5


class Equidistant(Lens):
    """
    ``equidistant``, a fisheye: ``theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)``.

    The undistorted radius is ``r = tan(theta)``.
    """

    sizes = 0, 4
    size = 4
    zeros_are_ideal = False

    def formula(self, xy: Array) -> Array:
        """Return the distorted coordinates of undistorted ones."""
        k1, k2, k3, k4 = self.coefficients
        r = np.hypot(xy[..., 0], xy[..., 1])
        theta = np.arctan(r)
        t2 = theta * theta
        theta_d = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        return np.asarray(xy * _ratio(theta_d, r)[..., None])


LENSES: Mapping[str, type[Lens]] = {
    'plumb_bob': PlumbBob, 'rational_polynomial': RationalPolynomial, 'equidistant': Equidistant}


def _ratio(scaled: Array, r: Array) -> Array:
    """Return the ratio of two radii (...,), 1 on the axis."""
    return np.where(r > _NEAR_AXIS, scaled / np.where(r > _NEAR_AXIS, r, 1.0), 1.0)


def _tilted(xy: Array, tau_x: float, tau_y: float) -> Array:
    """Return coordinates on a sensor tilted by two angles, rad, as in OpenCV's tilted model."""
    rotation = np.array([
        [math.cos(tau_y), 0.0, -math.sin(tau_y)], [0.0, 1.0, 0.0],
        [math.sin(tau_y), 0.0, math.cos(tau_y)]]) @ np.array([
            [1.0, 0.0, 0.0], [0.0, math.cos(tau_x), math.sin(tau_x)],
            [0.0, -math.sin(tau_x), math.cos(tau_x)]])
    r33 = rotation[2, 2]
    onto = np.array([[r33, 0.0, -rotation[0, 2]], [0.0, r33, -rotation[1, 2]], [0.0, 0.0, 1.0]])
    tilt = onto @ rotation
    homogeneous = xy @ tilt[:, :2].T + tilt[:, 2]
    return np.asarray(homogeneous[..., :2] / homogeneous[..., 2:])
