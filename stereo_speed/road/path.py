# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The protocol of a path and its two implementations, straight and curved.

A path gives position, tangent and frame at arc length ``s``, and the arc length of a point. The
frame is right-handed; its columns are T along travel, P to the left of travel and B up. Both
ends continue as straight lines, so that a vehicle may come from before the first pick and leave
after the last.
"""
from __future__ import annotations

from typing import Literal, Protocol, runtime_checkable

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from .spline_kernels import arc_lengths, frames, positions, unit
from ..core.records import Array

# Default up direction in the left optical frame.
CAMERA_UP: Array = np.array([0.0, -1.0, 0.0])


@runtime_checkable
class Path(Protocol):
    """A line in space that vehicles follow, by arc length in m, in the left optical frame."""

    @property
    def length_m(self) -> float:
        """Arc length between the two ends."""

    def position(self, s_m: Array) -> Array:
        """Return the points (..., 3) at arc lengths (...,)."""

    def tangent(self, s_m: Array) -> Array:
        """Return the unit directions of travel (..., 3) at arc lengths (...,)."""

    def frame(self, s_m: Array) -> Array:
        """Return the frames (..., 3, 3) at arc lengths (...,): columns T, P left, B up."""

    def arc_length(self, points_m: Array) -> Array:
        """Return the arc lengths (...,) of the nearest points of the path to points (..., 3)."""


def frame_of(tangent: Array, up: Array) -> Array:
    """
    Return frames (..., 3, 3) with columns T, P left, B up from tangents and rough up directions.

    :param tangent: (..., 3) unit vectors.
    :param up: (..., 3) or (3,), not parallel to the tangent; made orthogonal to it.
    """
    tangent = np.asarray(tangent, dtype=np.float64)
    left = unit(_cross(np.broadcast_to(up, tangent.shape), tangent))
    return np.stack([tangent, left, _cross(tangent, left)], axis=-1)


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product (..., 3); np.cross is too slow, as frames are computed often."""
    out = np.empty(a.shape)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return out


def chord_lengths(points: Array) -> Array:
    """
    Return the lengths (n,) of a polyline up to each of its points.

    :param points: (n, d).
    """
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=-1))])


def spline_through(x: Array, values: Array) -> CubicSpline:
    """
    Return the cubic spline through values (n, d) at places (n,), n >= 2.

    Up to three points allow no not-a-knot condition, so the ends are natural then.
    """
    ends: Literal['not-a-knot', 'natural'] = 'not-a-knot' if len(x) > 3 else 'natural'
    return CubicSpline(x, values, bc_type=ends)


def _everywhere(values: Array, shape: tuple[int, ...]) -> Array:
    """Return the same values repeated; np.broadcast_to is too slow, as this is called often."""
    out = np.empty(shape + values.shape)
    out[...] = values
    return out


class StraightPath:
    """
    A straight line.

    :param origin_m: (3,) the point at ``s = 0``.
    :param direction: (3,) direction of travel, any length.
    :param length_m: arc length of the far end, m.
    :param up: (3,) rough up direction.
    """

    def __init__(self, origin_m: Array, direction: Array, length_m: float,
                 up: Array = CAMERA_UP) -> None:
        self._origin_m = np.array(origin_m, dtype=np.float64)
        self._direction = unit(direction)
        self._frame = frame_of(self._direction, np.asarray(up, dtype=np.float64))
        self._length_m = float(length_m)

    @property
    def length_m(self) -> float:
        """Arc length between the two ends."""
        return self._length_m

    def position(self, s_m: Array) -> Array:
        """Return the points (..., 3) at arc lengths (...,)."""
        return self._origin_m + np.asarray(s_m, dtype=np.float64)[..., None] * self._direction

    def tangent(self, s_m: Array) -> Array:
        """Return the unit directions of travel (..., 3) at arc lengths (...,)."""
        return _everywhere(self._direction, np.shape(s_m))

    def frame(self, s_m: Array) -> Array:
        """Return the frames (..., 3, 3) at arc lengths (...,): columns T, P left, B up."""
        return _everywhere(self._frame, np.shape(s_m))

    def arc_length(self, points_m: Array) -> Array:
        """Return the arc lengths (...,) of the feet of points (..., 3)."""
        return (np.asarray(points_m, dtype=np.float64) - self._origin_m) @ self._direction


class SplinePath:
    """
    A smooth curve through points: a cubic spline, parametrised by its own arc length.

    :param points_m: (n, 3) points in order along travel, n >= 2, no two successive ones equal.
    :param up: (3,) or (n, 3) rough up directions at the points.
    :param spacing_m: largest spacing of the knots of the spline over arc length, m.
    """

    def __init__(self, points_m: Array, up: Array = CAMERA_UP,
                 spacing_m: float = 0.5) -> None:
        points_m = np.asarray(points_m, dtype=np.float64)
        chord = chord_lengths(points_m)
        raw = spline_through(chord, points_m)
        fine = np.unique(np.concatenate([chord, np.linspace(
            0.0, chord[-1], max(8, int(np.ceil(4 * chord[-1] / spacing_m))))]))
        s = np.concatenate([[0.0], np.cumsum(_lengths(raw, fine))])
        self._length_m = float(s[-1])
        count = max(5, int(np.ceil(self._length_m / spacing_m)) + 1)
        self._knots_m = np.linspace(0.0, self._length_m, count)
        # The map from arc length to chord parameter, with its exact slope at every node.
        slope = 1 / np.linalg.norm(raw(fine, 1), axis=-1)
        chords = CubicHermiteSpline(s, fine, slope)(self._knots_m)
        curve = CubicSpline(self._knots_m, raw(chords))
        self._step_m = self._length_m / (count - 1)
        self._coefficients = np.ascontiguousarray(curve.c)
        self._ends = unit(curve([0.0, self._length_m], 1))
        self._ups = self._up_coefficients(up, chord, chords)

    def _up_coefficients(self, up: Array, chord: Array, chords: Array) -> Array:
        """Return the coefficients (4, pieces, 3) of the rough up directions over arc length."""
        up = np.asarray(up, dtype=np.float64)
        if up.ndim == 1:
            same = np.zeros_like(self._coefficients)
            same[3] = unit(up)
            return same
        spline = CubicSpline(self._knots_m, unit(spline_through(chord, up)(chords)))
        return np.ascontiguousarray(spline.c)

    @property
    def length_m(self) -> float:
        """Arc length between the two ends."""
        return self._length_m

    def position(self, s_m: Array) -> Array:
        """Return the points (..., 3) at arc lengths (...,)."""
        s_m = np.asarray(s_m, dtype=np.float64)
        flat = positions(self._coefficients, self._step_m, self._ends, s_m.ravel())
        return np.asarray(flat.reshape(*s_m.shape, 3))

    def tangent(self, s_m: Array) -> Array:
        """Return the unit directions of travel (..., 3) at arc lengths (...,)."""
        return np.asarray(self.frame(s_m)[..., 0])

    def frame(self, s_m: Array) -> Array:
        """Return the frames (..., 3, 3) at arc lengths (...,): columns T, P left, B up."""
        s_m = np.asarray(s_m, dtype=np.float64)
        flat = frames(self._coefficients, self._ups, self._step_m, s_m.ravel())
        return np.asarray(flat.reshape(*s_m.shape, 3, 3))

    def arc_length(self, points_m: Array) -> Array:
        """Return the arc lengths (...,) of the nearest points of the path to points (..., 3)."""
        points_m = np.asarray(points_m, dtype=np.float64)
        flat = arc_lengths(self._coefficients, self._step_m, self._ends,
                           np.ascontiguousarray(points_m.reshape(-1, 3)))
        return np.asarray(flat.reshape(points_m.shape[:-1]))


def _lengths(curve: CubicSpline, nodes: Array) -> Array:
    """Return the arc lengths (n - 1,) between nodes (n,), by three-point Gauss quadrature."""
    half, middle = np.diff(nodes) / 2, (nodes[1:] + nodes[:-1]) / 2
    x = np.sqrt(0.6)
    speeds = [np.linalg.norm(curve(middle + k * half, 1), axis=-1) for k in (-x, 0.0, x)]
    return np.asarray(half * (5 * speeds[0] + 8 * speeds[1] + 5 * speeds[2]) / 9)
