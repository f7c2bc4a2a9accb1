# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The points of a space curve from its two image curves (Zhu 2012, Section IV-C).

The two views are picked independently: each point of the left curve is matched with the point
where its epipolar line crosses the right curve. The precision of that point depends on the angle
of the crossing.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from .path import chord_lengths, spline_through
from ..core.records import Array
from ..geometry.rig import StereoRig

_SAMPLES = 400  # samples of the right image curve, which is taken as straight between them
# Least sine of the angle between epipolar line and curve; depth error grows with its inverse.
_MIN_SINE = 0.06


@dataclass(frozen=True, eq=False)
class CurveMatches:
    """
    Points of one image curve matched across the views.

    :param left_px: (n, 2) raw pixels.
    :param right_px: (n, 2) raw pixels.
    :param sine: (n,) sine of the angle between the epipolar line and the right curve.
    :param points_m: (n, 3) triangulated points, left optical frame, m.
    """

    left_px: Array
    right_px: Array
    sine: Array
    points_m: Array


def image_spline(uv_px: Array) -> CubicSpline:
    """
    Return a spline through picks, parametrised from 0 to 1 by chord length.

    :param uv_px: (n, 2) raw pixels, n >= 2.
    """
    chord = chord_lengths(uv_px)
    return spline_through(chord / chord[-1], uv_px)


def match_curves(
        rig: StereoRig, left_px: Array, right_px: Array,
        at: Optional[Array] = None) -> CurveMatches:
    """
    Return the matches of a left image curve with a right one along epipolar lines.

    :param left_px: (n, 2) raw picks in order.
    :param right_px: (m, 2) raw picks in order.
    :param at: (k, 2) raw pixels of the left curve to match; None matches the picks.
    """
    left_px = np.asarray(left_px if at is None else at, dtype=np.float64)
    curve = image_spline(np.asarray(right_px, dtype=np.float64))
    t = np.linspace(0.0, 1.0, _SAMPLES)
    right_rays = rig.right.rays(curve(t))
    lines = rig.epipolar_lines_right(left_px)
    lines /= np.linalg.norm(lines[:, :2], axis=-1, keepdims=True)
    value = lines @ right_rays.T  # (k, samples), 0 where the epipolar line crosses the curve
    rows, columns = np.nonzero(value[:, :-1] * value[:, 1:] <= 0)
    before, after = value[rows, columns], value[rows, columns + 1]
    with np.errstate(divide='ignore', invalid='ignore'):
        crossing = t[columns] + np.where(before != after, before / (before - after), 0.0) / (
            _SAMPLES - 1)
    along = np.diff(right_rays[:, :2], axis=0)[columns]
    sine = np.abs(after - before) / np.linalg.norm(along, axis=-1)
    matched = curve(crossing)
    points = rig.triangulate(left_px[rows], matched)
    good = np.isfinite(points).all(axis=-1) & (sine > _MIN_SINE)
    kept = _one_each(rows[good], crossing[good], len(left_px))
    chosen = np.nonzero(good)[0][kept]
    return CurveMatches(left_px[rows[chosen]], matched[chosen], sine[chosen], points[chosen])


def _one_each(rows: NDArray[np.intp], crossing: Array, count: int) -> list[int]:
    """Return one crossing per row; of several, the one at the same share of the curve."""
    kept = []
    for row in range(count):
        candidates = np.nonzero(rows == row)[0]
        if candidates.size:
            share = row / max(count - 1, 1)
            kept.append(int(candidates[np.argmin(np.abs(crossing[candidates] - share))]))
    return kept
