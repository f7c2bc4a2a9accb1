# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Lens distortion in normalised image coordinates, and its inverse.

Coefficients are in OpenCV's order. Every function takes and gives (..., 2) arrays.
"""
from __future__ import annotations

import math
from typing import Callable

import numpy as np

from ..core.records import Array

Distortion = Callable[[Array], Array]

_TOLERANCE = 1e-12  # of the residual in normalised coordinates
_STEP = 1e-6  # of the central differences of the Jacobian
_FAR = 100.0  # tan of the widest ray that is looked at


def polynomial(xy: Array, coefficients: Array) -> Array:
    """
    ``plumb_bob`` and ``rational_polynomial``: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty.

    :param xy: (..., 2) undistorted coordinates.
    :param coefficients: (14,).
    """
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y = coefficients
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


def _tilted(xy: Array, tau_x: float, tau_y: float) -> Array:
    """Project onto a sensor tilted by two angles in rad, as OpenCV's thin-prism model does."""
    rotation = np.array([
        [math.cos(tau_y), 0.0, -math.sin(tau_y)], [0.0, 1.0, 0.0],
        [math.sin(tau_y), 0.0, math.cos(tau_y)]]) @ np.array([
            [1.0, 0.0, 0.0], [0.0, math.cos(tau_x), math.sin(tau_x)],
            [0.0, -math.sin(tau_x), math.cos(tau_x)]])
    r33 = rotation[2, 2]
    onto = np.array([[r33, 0.0, -rotation[0, 2]], [0.0, r33, -rotation[1, 2]], [0.0, 0.0, 1.0]])
    tilt = onto @ rotation
    homogeneous = xy @ tilt[:, :2].T + tilt[:, 2]
    return homogeneous[..., :2] / homogeneous[..., 2:]


def equidistant(xy: Array, coefficients: Array) -> Array:
    """
    Fisheye: ``theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)``.

    :param xy: (..., 2) undistorted coordinates, ``r = tan(theta)``.
    :param coefficients: (4,).
    """
    k1, k2, k3, k4 = coefficients
    r = np.hypot(xy[..., 0], xy[..., 1])
    theta = np.arctan(r)
    t2 = theta * theta
    theta_d = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    scale = np.where(r > 1e-12, theta_d / np.where(r > 1e-12, r, 1.0), 1.0)
    return xy * scale[..., None]


def largest_radius(distort: Distortion) -> float:
    """
    Radius (tan of the angle) up to which distorted radii still grow.

    Beyond it a lens polynomial folds back: rays from far outside the view would land inside the
    image, and the inverse is no longer one to one.
    """
    radii = np.tan(np.linspace(0.0, math.atan(_FAR), 4000))
    points = np.stack([radii, np.zeros_like(radii)], axis=-1)
    grows = np.ones(radii.size - 1, dtype=bool)
    for axis in (1, -1):  # both ways: tangential terms make the two sides differ
        grows &= np.diff(distort(axis * points)[:, 0] * axis) > 0
    folded = np.nonzero(~grows)[0]
    return float(radii[folded[0]]) if folded.size else math.inf


def _first_guess(distort: Distortion, xy: Array, limit: float) -> Array:
    """Invert the radial part by a table; the sides differ little for the guess's purpose."""
    top = math.atan(min(limit, _FAR))
    radii = np.tan(np.linspace(0.0, top, 512))
    table = distort(np.stack([radii, np.zeros_like(radii)], axis=-1))[:, 0]
    table = np.maximum.accumulate(table - table[0])
    r = np.hypot(xy[..., 0], xy[..., 1])
    inverse = np.interp(r, table, radii)
    return xy * np.where(r > 1e-12, inverse / np.where(r > 1e-12, r, 1.0), 1.0)[..., None]


def invert(distort: Distortion, xy: Array, limit: float, iterations: int = 20) -> Array:
    """
    Undistort by Newton's method; NaN where it does not converge, or beyond ``limit``.

    :param xy: (..., 2) distorted coordinates.
    :param limit: largest radius of an undistorted ray, from :func:`largest_radius`.
    """
    x = _first_guess(distort, xy, limit)
    ex, ey = np.array([_STEP, 0.0]), np.array([0.0, _STEP])
    with np.errstate(all='ignore'):
        for _ in range(iterations):
            error = distort(x) - xy
            if not np.any(np.abs(error) > _TOLERANCE):
                break
            jx = (distort(x + ex) - distort(x - ex)) / (2 * _STEP)
            jy = (distort(x + ey) - distort(x - ey)) / (2 * _STEP)
            det = jx[..., 0] * jy[..., 1] - jx[..., 1] * jy[..., 0]
            step = np.stack([
                jy[..., 1] * error[..., 0] - jy[..., 0] * error[..., 1],
                jx[..., 0] * error[..., 1] - jx[..., 1] * error[..., 0]], axis=-1) / det[..., None]
            x = x - step
        bad = ~(np.abs(distort(x) - xy).max(axis=-1) < 1e-10)
        bad |= ~(np.hypot(x[..., 0], x[..., 1]) <= limit)
    return np.where(bad[..., None], np.nan, x)
