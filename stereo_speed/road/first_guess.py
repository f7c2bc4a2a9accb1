# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""An initial guess for the joint fit of a road: lines triangulated one by one, then on a plane."""
from __future__ import annotations

from typing import NamedTuple, Optional, Sequence

import numpy as np
from numpy.polynomial import Legendre, legendre

from .curve_matching import CurveMatches, image_spline, match_curves
from .model import RoadModel, RoadShape
from .path import CAMERA_UP, frame_of
from .spline_kernels import unit
from ..core.records import Array
from ..geometry.ray_plane import back_project, Plane
from ..geometry.rig import StereoRig

Line = tuple[Array, Array]
_SAMPLES = 60  # samples of each image curve, so that long and short lines count alike
_ROUNDS = 15  # rounds of reweighting; mismatches have lost their weight after a few
_ROLL = 1e-2  # weight of the prior of no roll, as a share of a good match's
_FOLLOWED = 0.75  # least share of a line that its picks follow, relative to the best line
_LONGEST = 1.5  # largest half length of the road by its picks, in lengths of its longest line
_FARTHEST = 0.98  # quantile of the matched depths, as a few matches are far off
# Greatest depth of the road as a multiple of that quantile, which is 77 m for a line clicked from
# 10 to 90 m; farther away a plane does not represent the road.
_BEYOND = 1.5


class NoRoadError(ValueError):
    """Raised when the picks of the two views give no road to start from."""


class _Curve(NamedTuple):
    """A smooth plane curve over arc length, with one polynomial for each coordinate."""

    x: Legendre
    y: Legendre

    @classmethod
    def through(cls, flat: Array, s_m: Array, curvature_terms: int) -> _Curve:
        """Return a fit to points (n, 2) at arc lengths (n,), of a degree for so many terms."""
        degree = min(curvature_terms + 1, len(s_m) - 1)
        x, y = (Legendre.fit(s_m, column, degree, domain=[0, s_m[-1]]) for column in flat.T)
        return cls(x, y)

    def at(self, s_m: float) -> Array:
        """Return the point (2,) at an arc length."""
        return np.array([self.x(s_m), self.y(s_m)])

    def slope(self, s_m: Array) -> Array:
        """Return the derivatives (..., 2) at arc lengths (...,)."""
        return np.stack([self.x.deriv()(s_m), self.y.deriv()(s_m)], axis=-1)


class Hints(NamedTuple):
    """
    Hints for an initial guess.

    :param least_half_m: smallest half length of the road, m.
    :param plane_of: number of the line that determines the plane; None for all that their picks
        follow.
    """

    least_half_m: float = 0.0
    plane_of: Optional[int] = None


def guess_road(
        rig: StereoRig, lines: Sequence[Line], curvature_terms: int, hints: Hints = Hints()
) -> tuple[RoadModel, Array]:
    """
    Return a model about a guess, and the guess's parameters.

    :param lines: raw pixels (left (n, 2), right (m, 2)) of each line.
    :param curvature_terms: number of curvature coefficients.
    :param hints: see :class:`Hints`.
    :raises NoRoadError: the two views have too little in common, or a line of a straight road
        does not meet the surface of the others.
    """
    followed = _followed(lines) if curvature_terms else list(range(len(lines)))
    in_plane = followed if hints.plane_of is None else [hints.plane_of]
    matched = [_matched(rig, lines[i]) for i in in_plane]
    surface = _surface(rig, matched)
    most_m = _BEYOND * float(np.quantile(
        np.concatenate([found.points_m[:, 2] for found in matched]), _FARTHEST))
    on_road = [_on_road(rig, line, surface, most_m) for line in lines]
    longest = max((on_road[i][0] for i in followed),
                  key=lambda p: np.linalg.norm(p[-1] - p[0]) if len(p) else 0.0)
    all_meet = all(len(left) + len(right) for left, right in on_road)
    if len(longest) < 2 or not (all_meet or curvature_terms):  # a curved road guesses an offset
        raise NoRoadError('the picks do not meet one road surface')
    n = surface.normal
    return _along(longest, [np.concatenate(views) for views in on_road], curvature_terms,
                  n if n @ CAMERA_UP > 0 else -n, hints.least_half_m)


def _followed(lines: Sequence[Line]) -> list[int]:
    """
    Return the numbers of the lines that are covered by their picks.

    If little more than the ends of a line was found, a curve through its picks cuts across a bend.
    """
    shares = []
    for views in lines:
        steps = [np.linalg.norm(np.diff(view, axis=0), axis=-1) for view in views]
        shares.append(min(float((step.sum() - step.max()) / step.sum()) for step in steps))
    return [i for i, share in enumerate(shares) if share >= _FOLLOWED * max(shares)]


def _matched(rig: StereoRig, line: Line) -> CurveMatches:
    """Return points of a line that are matched between the views."""
    left, right = line
    return match_curves(rig, left, right, image_spline(left)(np.linspace(0, 1, _SAMPLES)))


def _surface(rig: StereoRig, matched: Sequence[CurveMatches]) -> Plane:
    """
    Return a plane fitted to the matched points of all lines, weighted by their certainty.

    A plane is linear in inverse depth, ``1/Z = n . x / d``, where the scatter is that of the
    disparity, the same near and far. A prior keeps the plane's roll near the camera's, because
    a single straight line does not determine it.
    """
    rays = [rig.left.rays(found.left_px) for found in matched]
    inverse, sine = [1 / found.points_m[:, 2] for found in matched], [f.sine for f in matched]
    x, y, weight = np.concatenate(rays), np.concatenate(inverse), np.concatenate(sine)
    if len(y) < 3:
        raise NoRoadError('the two views have fewer than 3 points in common')
    m = np.array([0.0, 1 / 2.0, 0.0])  # level, 2 m below the camera
    for _ in range(_ROUNDS):
        off = np.abs(x @ m - y) * weight
        robust = weight / np.maximum(off, np.median(off) + 1e-9)**0.5
        roll = np.array([[_ROLL * np.max(robust), 0.0, 0.0]])
        m = np.linalg.lstsq(np.vstack([x * robust[:, None], roll]),
                            np.append(y * robust, 0.0), rcond=None)[0]
    return Plane(m / np.linalg.norm(m), 1 / float(np.linalg.norm(m)))


def _on_road(rig: StereoRig, line: Line, surface: Plane, most_m: float) -> tuple[Array, Array]:
    """
    Return the points (n, 3), (m, 3) where the rays of the picks of both views meet the surface.

    If the road climbs out of a sag, the plane of its near part lies below its far part and meets
    the rays of that part at arbitrary distances. Points are therefore limited in depth.

    :param most_m: greatest depth of a point, m.
    """
    # The centre of the right camera is -eye_m.
    n, d, eye_m = surface.normal, surface.distance_m, rig.R.T @ rig.t
    left = back_project(rig.left.rays(line[0]), n, d)
    right = back_project(rig.right.rays(line[1]) @ rig.R, n, d + float(n @ eye_m))
    return _within(left, most_m), _within(right, most_m) - eye_m


def _within(points_m: Array, most_m: float) -> Array:
    """
    Return the points where rays meet a surface, limited in depth.

    :param points_m: (n, 3) points relative to the origin of the rays, m; NaN for a ray that
        misses the surface.
    :param most_m: greatest depth, m.
    :return: (m, 3) points without NaN; deeper ones are moved nearer along their rays.
    """
    met = points_m[np.isfinite(points_m).all(axis=-1)]
    return np.asarray(met * np.minimum(1.0, most_m / np.maximum(met[:, 2:], 1e-9)))


def _along(line: Array, on_road: list[Array], curvature_terms: int, up: Array,
           least_half_m: float) -> tuple[RoadModel, Array]:
    """
    Return a model, and its parameters, whose reference line follows points of one line.

    :param line: (n, 3) points of that line on the surface, m.
    :param on_road: (m, 3) points of each line on the surface, m.
    """
    chord = unit(line[-1] - line[0])
    frame = frame_of(chord, up)
    flat = (line - line[0]) @ frame[:, :2]
    step = np.linalg.norm(np.diff(flat, axis=0), axis=-1)
    s = np.concatenate([[0.0], np.cumsum(step)])
    curve = _Curve.through(flat, s, curvature_terms)
    # The road is centred on the middle of the line, and long enough to reach all picks.
    middle = s[-1] / 2
    tangent = unit(frame[:, :2] @ curve.slope(middle))
    centre = line[0] + frame[:, :2] @ curve.at(middle)
    frame = frame_of(tangent, up)
    reach = np.abs((np.concatenate(on_road) - centre) @ chord).max()
    half = max(s[-1] / 2, min(reach, _LONGEST * s[-1]), least_half_m)
    offsets = [_offset(points, frame, centre) if curvature_terms == 0 else
               _offset_along(points, line, frame) for points in on_road]
    model = RoadModel(
        frame, centre, float(half), len(on_road), RoadShape(curvature_terms))
    return model, np.concatenate([
        np.zeros(4), offsets, _curvature(curve, float(s[-1]), float(half), curvature_terms)])


def _curvature(curve: _Curve, length_m: float, half_m: float, terms: int) -> Array:
    """Return the curvature coefficients (terms,) that fit the heading of a curve."""
    if terms == 0:
        return np.zeros(0)
    s = np.linspace(0, length_m, 50)
    slope = curve.slope(s)
    angle = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
    sigma = (s - length_m / 2) / half_m
    basis = np.stack([legendre.legval(sigma, legendre.legint(np.eye(terms)[i], lbnd=0))
                      for i in range(terms)], axis=-1)
    x, y = curve.slope(np.array(length_m / 2))
    return np.asarray(np.linalg.lstsq(basis, angle - np.arctan2(y, x), rcond=None)[0])


def _offset(points: Array, frame: Array, centre: Array) -> float:
    """Return the median offset of a line's points from a straight reference line, m."""
    return float(np.median((points - centre) @ frame[:, 1]))


def _offset_along(points: Array, line: Array, frame: Array) -> float:
    """Return the median offset of a line's points from the segments beside them, m."""
    out = []
    for a, b in zip(line[:-1], line[1:]):
        t = unit(b - a)
        along = (points - a) @ t
        on = (along >= 0) & (along <= np.linalg.norm(b - a))
        out.append(((points - a) @ np.cross(frame[:, 2], t))[on])
    offsets = np.concatenate(out)
    return float(np.median(offsets)) if offsets.size else 0.0
