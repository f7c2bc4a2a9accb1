# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A start for the joint fit of a road: lines triangulated singly, then laid on a plane."""
from __future__ import annotations

from typing import Sequence

import numpy as np
from numpy.polynomial import legendre

from .curve_matching import image_spline, match_curves
from .model import RoadModel
from .path import CAMERA_UP, frame_of, unit
from ..core.records import Array
from ..geometry.ray_plane import back_project
from ..geometry.rig import StereoRig

Line = tuple[Array, Array]
_SAMPLES = 60  # along each image curve


def _surface(rig: StereoRig, lines: Sequence[Line]) -> tuple[Array, float]:
    """
    Fit a plane (n, d) to the matched points of all lines, each as its depth is certain.

    In the depth's inverse a plane is linear, ``1/Z = n . x / d``, and the scatter of a disparity
    is the same near and far; a prior keeps the plane's roll near the camera's, where one straight
    line says nothing of it.
    """
    rays, inverse, sine = [], [], []
    for left, right in lines:
        found = match_curves(rig, left, right, image_spline(left)(np.linspace(0, 1, _SAMPLES)))
        rays.append(rig.left.rays(found.left_px))
        inverse.append(1 / found.points_m[:, 2])
        sine.append(found.sine)
    x, y, weight = np.concatenate(rays), np.concatenate(inverse), np.concatenate(sine)
    if len(y) < 3:
        raise ValueError('the two views have fewer than 3 points in common')
    m = np.array([0.0, 1 / 2.0, 0.0])
    for _ in range(15):  # reweighted against mismatches
        off = np.abs(x @ m - y) * weight
        robust = weight / np.maximum(off, np.median(off) + 1e-9)**0.5
        roll = np.array([[1e-2 * np.max(robust), 0.0, 0.0]])
        m = np.linalg.lstsq(np.vstack([x * robust[:, None], roll]),
                            np.append(y * robust, 0.0), rcond=None)[0]
    return m / np.linalg.norm(m), 1 / float(np.linalg.norm(m))


def guess_road(
        rig: StereoRig, lines: Sequence[Line], turns: int) -> tuple[RoadModel, Array]:
    """
    Make a model about a guess, and the guess's parameters.

    :param lines: (left (n, 2), right (m, 2)) raw pixels of each line.
    :param turns: number of curvature coefficients.
    :raises ValueError: when the two views have too little in common.
    """
    n, d = _surface(rig, lines)
    up = n if n @ CAMERA_UP > 0 else -n
    on_road = []
    for left, right in lines:
        points = back_project(rig.left.rays(left), n, d)
        from_right = back_project(rig.right.rays(right) @ rig.R, n, d + n @ rig.R.T @ rig.t)
        from_right = from_right - rig.R.T @ rig.t
        on_road.append([p[np.isfinite(p).all(axis=-1)] for p in (points, from_right)])
    longest = max(on_road, key=lambda p: np.linalg.norm(p[0][-1] - p[0][0]) if len(p[0]) else 0.0)
    if len(longest[0]) < 2:
        raise ValueError('the picks do not meet one road surface')
    return _along(longest[0], on_road, turns, up)


def _along(line: Array, on_road: list, turns: int, up: Array) -> tuple[RoadModel, Array]:
    """Lay the reference line along one line's points (n, 3) on the surface."""
    chord = unit(line[-1] - line[0])
    frame = frame_of(chord, up)
    every = np.concatenate([p for pair in on_road for p in pair])
    flat = (line - line[0]) @ frame[:, :2]
    step = np.linalg.norm(np.diff(flat, axis=0), axis=-1)
    s = np.concatenate([[0.0], np.cumsum(step)])
    curve = _smooth(flat, s, turns)
    # the middle of the line, and a half length that reaches every pick of every line
    middle = s[-1] / 2
    slope = curve(middle, 1)
    tangent = unit(frame[:, :2] @ slope)
    centre = line[0] + frame[:, :2] @ curve(middle)
    frame = frame_of(tangent, up)
    reach = np.abs((every - centre) @ chord).max()
    half = max(s[-1] / 2, min(reach, 1.5 * s[-1]))
    heading = _heading(curve, s[-1], half, turns)
    offsets = [_offset(pair, (frame, centre)) for pair in on_road] if turns == 0 else [
        _offset_along(pair, line, frame) for pair in on_road]
    model = RoadModel(frame, centre, float(half), len(on_road), turns, 0)
    return model, np.concatenate([np.zeros(4), offsets, heading])


def _smooth(flat: Array, s: Array, turns: int):
    """Fit polynomials in arc length to points (n, 2); gives a callable (s, derivative)."""
    degree = min(turns + 1, len(s) - 1)
    fits = [legendre.Legendre.fit(s, flat[:, i], degree, domain=[0, s[-1]]) for i in (0, 1)]

    def curve(at: Array, derivative: int = 0) -> Array:
        return np.stack([f.deriv(derivative)(at) if derivative else f(at) for f in fits], axis=-1)

    return curve


def _heading(curve, length: float, half: float, turns: int) -> Array:
    """Fit the curvature coefficients (turns,) to the heading of a curve."""
    if turns == 0:
        return np.zeros(0)
    s = np.linspace(0, length, 50)
    slope = curve(s, 1)
    angle = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
    sigma = (s - length / 2) / half
    basis = np.stack([legendre.legval(sigma, legendre.legint(np.eye(turns)[i], lbnd=0))
                      for i in range(turns)], axis=-1)
    middle = np.arctan2(*curve(length / 2, 1)[::-1])
    return np.linalg.lstsq(basis, angle - middle, rcond=None)[0]


def _offset(pair: list, place: tuple[Array, Array]) -> float:
    """Give the mean offset of a line's points from a straight reference."""
    frame, centre = place
    return float(np.median((np.concatenate(pair) - centre) @ frame[:, 1]))


def _offset_along(pair: list, line: Array, frame: Array) -> float:
    """Give the median offset of a line's points from the nearest stretch of another line."""
    points, out = np.concatenate(pair), []
    for a, b in zip(line[:-1], line[1:]):
        t = unit(b - a)
        along = (points - a) @ t
        on = (along >= 0) & (along <= np.linalg.norm(b - a))
        out.append(((points - a) @ np.cross(frame[:, 2], t))[on])
    offsets = np.concatenate(out)
    return float(np.median(offsets)) if offsets.size else 0.0
