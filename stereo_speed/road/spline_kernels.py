# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Points and frames of splines with evenly spaced knots: the kernels of ``SplinePath``.

A tracker asks for one or a few places at a time, but so often that the overhead of calls
dominates.  Splines are given by the coefficients (4, pieces, 3) of scipy's ``CubicSpline``, the
highest power first, and the step between their knots; the first knot is 0.
"""
from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import PPoly

from ..core.compiled import inlined, kernel
from ..core.records import Array

_STEPS = 8  # most Newton steps for the nearest point
_SETTLED_M = 1e-10  # step at which Newton's method has converged
_LEAST_BEND = 0.2  # lower bound of 1 - offset * bend, which is 0 at the centre of the bend


def _curve(c: Array, step: float) -> PPoly:
    return PPoly(c, step * np.arange(c.shape[1] + 1))


def unit(vectors: Array) -> Array:
    """
    Return vectors scaled to length 1.

    :param vectors: (..., 3).
    """
    vectors = np.asarray(vectors, dtype=np.float64)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


@inlined
def _piece(c, step, s):  # type: ignore
    """Return the index of the spline piece at an arc length, and the arc length within it."""
    k = min(max(int(np.floor(s / step)), 0), c.shape[1] - 1)
    return k, s - k * step


def plain_positions(c: Array, step: float, ends: Array, s_m: Array) -> Array:
    """
    Return points (n, 3) of a spline at arc lengths (n,); beyond its ends it continues straight.

    :param ends: (2, 3) unit directions at the two ends.
    """
    on = np.clip(s_m, 0.0, step * c.shape[1])
    beyond = s_m - on
    direction = np.where((beyond < 0)[:, None], ends[0], ends[1])
    return np.asarray(_curve(c, step)(on) + beyond[:, None] * direction)


@kernel(plain_positions, '(f8[:,:,::1], f8, f8[:,::1], f8[::1])')
def positions(c: Any, step: float, ends: Any, s_m: Any) -> Any:
    """Return points; arguments as :func:`plain_positions`."""
    length = step * c.shape[1]
    out = np.empty((len(s_m), 3))
    for i in range(len(s_m)):
        on = min(max(s_m[i], 0.0), length)
        k, t = _piece(c, step, on)
        end = 0 if s_m[i] < 0 else 1
        for d in range(3):
            out[i, d] = (((c[0, k, d] * t + c[1, k, d]) * t + c[2, k, d]) * t + c[3, k, d]
                         + (s_m[i] - on) * ends[end, d])
    return out


def plain_frames(c: Array, up: Array, step: float, s_m: Array) -> Array:
    """
    Return frames (n, 3, 3) of a spline at arc lengths (n,): columns T, P left, B up.

    :param up: (4, pieces, 3) coefficients of the rough up directions.
    """
    on = np.clip(s_m, 0.0, step * c.shape[1])
    tangent = unit(_curve(c, step)(on, 1))
    left = unit(np.cross(_curve(up, step)(on), tangent))
    return np.stack([tangent, left, np.cross(tangent, left)], axis=-1)


@kernel(plain_frames, '(f8[:,:,::1], f8[:,:,::1], f8, f8[::1])')
def frames(c: Any, up: Any, step: float, s_m: Any) -> Any:
    """Return frames; arguments as :func:`plain_frames`."""
    length = step * c.shape[1]
    out = np.empty((len(s_m), 3, 3))
    a, u = np.empty(3), np.empty(3)
    for i in range(len(s_m)):
        k, t = _piece(c, step, min(max(s_m[i], 0.0), length))
        for d in range(3):
            a[d] = (3 * c[0, k, d] * t + 2 * c[1, k, d]) * t + c[2, k, d]
            u[d] = ((up[0, k, d] * t + up[1, k, d]) * t + up[2, k, d]) * t + up[3, k, d]
        size = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
        for d in range(3):
            a[d] /= size
        p0 = u[1] * a[2] - u[2] * a[1]
        p1 = u[2] * a[0] - u[0] * a[2]
        p2 = u[0] * a[1] - u[1] * a[0]
        size = np.sqrt(p0 * p0 + p1 * p1 + p2 * p2)
        p0, p1, p2 = p0 / size, p1 / size, p2 / size
        for d in range(3):
            out[i, d, 0] = a[d]
        out[i, 0, 1], out[i, 1, 1], out[i, 2, 1] = p0, p1, p2
        out[i, 0, 2] = a[1] * p2 - a[2] * p1
        out[i, 1, 2] = a[2] * p0 - a[0] * p2
        out[i, 2, 2] = a[0] * p1 - a[1] * p0
    return out


def plain_arc_lengths(c: Array, step: float, ends: Array, points_m: Array) -> Array:
    """
    Return the arc lengths (n,) of the nearest points of a spline to points (n, 3).

    :param ends: (2, 3) unit directions at the two ends.
    """
    curve = _curve(c, step)
    knots_m = step * np.arange(c.shape[1] + 1)
    knots, length = curve(knots_m), knots_m[-1]
    # This is |p - k|^2 without |p|^2, which is the same for all knots.
    nearest = np.argmin(np.sum(knots * knots, axis=-1) - 2 * points_m @ knots.T, axis=-1)
    s: Array = knots_m[nearest]
    for _ in range(_STEPS):
        on = np.clip(s, 0.0, length)
        offset = points_m - plain_positions(c, step, ends, s)
        bend = np.where((s == on)[:, None], curve(on, 2), 0.0)
        move = np.sum(offset * unit(curve(on, 1)), axis=-1) / np.maximum(
            1 - np.sum(offset * bend, axis=-1), _LEAST_BEND)
        s = s + move
        if not np.any(np.abs(move) > _SETTLED_M):
            break
    return s


@kernel(plain_arc_lengths, '(f8[:,:,::1], f8, f8[:,::1], f8[:,::1])')
def arc_lengths(c: Any, step: float, ends: Any, points_m: Any) -> Any:
    """Return arc lengths; arguments as :func:`plain_arc_lengths`."""
    pieces = c.shape[1]
    length = step * pieces
    out = np.empty(len(points_m))
    for i in range(len(points_m)):
        x, y, z = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        s, least = 0.0, np.inf
        for k in range(pieces + 1):
            if k < pieces:
                a, b, e = c[3, k, 0], c[3, k, 1], c[3, k, 2]
            else:
                j = pieces - 1
                a = ((c[0, j, 0] * step + c[1, j, 0]) * step + c[2, j, 0]) * step + c[3, j, 0]
                b = ((c[0, j, 1] * step + c[1, j, 1]) * step + c[2, j, 1]) * step + c[3, j, 1]
                e = ((c[0, j, 2] * step + c[1, j, 2]) * step + c[2, j, 2]) * step + c[3, j, 2]
            square = (x - a) ** 2 + (y - b) ** 2 + (z - e) ** 2
            if square < least:
                least, s = square, k * step
        for _ in range(_STEPS):
            on = min(max(s, 0.0), length)
            k, t = _piece(c, step, on)
            end = 0 if s < on else 1
            along = across = size = 0.0
            for d in range(3):
                offset = points_m[i, d] - (
                    ((c[0, k, d] * t + c[1, k, d]) * t + c[2, k, d]) * t + c[3, k, d]
                    + (s - on) * ends[end, d])
                slope = (3 * c[0, k, d] * t + 2 * c[1, k, d]) * t + c[2, k, d]
                size += slope * slope
                along += offset * slope
                if s == on:
                    across += offset * (6 * c[0, k, d] * t + 2 * c[1, k, d])
            move = along / np.sqrt(size) / max(1 - across, _LEAST_BEND)
            s += move
            if not abs(move) > _SETTLED_M:
                break
        out[i] = s
    return out
