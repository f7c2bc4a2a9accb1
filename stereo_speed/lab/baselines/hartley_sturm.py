# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Optimal triangulation of R. Hartley and P. Sturm, "Triangulation", CVIU 68(2), 1997.

Of all pairs of image points on corresponding epipolar lines it finds the one nearest to the
measured pair, by the sum of squared distances in both images: the maximum likelihood under equal
Gaussian errors.  Algorithm 12.1 of R. Hartley and A. Zisserman, "Multiple View Geometry", 2nd ed.
2004 (the 2012 paper's reference [27]).  Epipolar lines are a pencil of one parameter t, and the
stationary points of the distance are the roots of a polynomial of degree six.
"""
from __future__ import annotations

import numpy as np

from ...core.records import Array
from ...geometry.rig import StereoRig

_TINY = 1e-12


def fundamental(rig: StereoRig) -> Array:
    """(3, 3) F with ``x_right^T F x_left = 0`` in pixels freed of the lens distortion."""
    return np.linalg.inv(rig.right.K).T @ rig.essential @ np.linalg.inv(rig.left.K)


def correct_matches(f: Array, left: Array, right: Array) -> tuple[Array, Array]:
    """
    Move pairs of points the least, so that they fulfil the epipolar constraint.

    :param f: (3, 3) fundamental matrix.
    :param left: (n, 2) points of the left image.
    :param right: (n, 2) points of the right image, pair by pair.
    :return: the corrected points, (n, 2) each.
    """
    pairs = [_correct(f, a, b) for a, b in zip(np.asarray(left, float), np.asarray(right, float))]
    both = np.array(pairs).reshape(-1, 2, 2)
    return both[:, 0], both[:, 1]


def triangulate(rig: StereoRig, uv_left: Array, uv_right: Array) -> Array:
    """
    Find the points of matched raw pixels; NaN where their rays do not meet ahead.

    Errors are taken as equal in pixels freed of the distortion, the same as in raw ones wherever
    a lens hardly scales.

    :param uv_left: (n, 2) raw pixels.
    :param uv_right: (n, 2) raw pixels, pair by pair.
    :return: (n, 3), left optical frame, m.
    """
    left, right = (_pixels(camera.K, camera.undistort(uv)) for camera, uv in
                   ((rig.left, uv_left), (rig.right, uv_right)))
    good = np.isfinite(left).all(axis=1) & np.isfinite(right).all(axis=1)
    out = np.full((len(left), 3), np.nan)
    if good.any():
        fixed = correct_matches(fundamental(rig), left[good], right[good])
        rays = [_normalised(camera.K, x) for camera, x in zip((rig.left, rig.right), fixed)]
        out[good] = _meet(rig, *rays)
    return out


def _correct(f: Array, left: Array, right: Array) -> Array:
    """Correct one pair: both points as (2, 2)."""
    here, there = _shift(left), _shift(right)
    f = there.T @ f @ here
    e_l, e_r = _null(f), _null(f.T)
    r_l, r_r = _turn(e_l), _turn(e_r)
    f = r_r @ f @ r_l.T
    a, b, c, d = f[1, 1], f[1, 2], f[2, 1], f[2, 2]
    t = _best(a, b, c, d, e_l[2], e_r[2])
    if np.isinf(t):
        line_l, line_r = np.array([e_l[2], 0.0, -1.0]), np.array([-e_r[2] * c, a, c])
    else:
        line_l = np.array([t * e_l[2], 1.0, -t])
        line_r = np.array([-e_r[2] * (c * t + d), a * t + b, c * t + d])
    points = [shift @ (turn.T @ _foot(line)) for shift, turn, line in
              ((here, r_l, line_l), (there, r_r, line_r))]
    return np.array([p[:2] / p[2] for p in points])


def _best(a: float, b: float, c: float, d: float, f1: float, f2: float) -> float:
    """
    Give the t of least cost; inf where the line at infinity of the pencil is the best.

    g(t) = t ((at+b)^2 + f2^2 (ct+d)^2)^2 - (ad-bc) (1 + f1^2 t^2)^2 (at+b)(ct+d)
    """
    at_b, ct_d = np.array([a, b]), np.array([c, d])
    near = np.polyadd(np.polymul(at_b, at_b), f2 ** 2 * np.polymul(ct_d, ct_d))
    far = np.array([f1 ** 2, 0.0, 1.0])
    g = np.polysub(
        np.polymul([1.0, 0.0], np.polymul(near, near)),
        (a * d - b * c) * np.polymul(np.polymul(far, far), np.polymul(at_b, ct_d)))
    t = np.unique(np.real(np.roots(g)))
    with np.errstate(divide='ignore', invalid='ignore'):
        cost = t ** 2 / (1 + f1 ** 2 * t ** 2) + (c * t + d) ** 2 / (
            (a * t + b) ** 2 + f2 ** 2 * (c * t + d) ** 2)
        limit = 1 / f1 ** 2 if f1 else np.inf
        limit = limit + c ** 2 / (a ** 2 + f2 ** 2 * c ** 2)
    cost = np.where(np.isfinite(cost), cost, np.inf)
    return float(t[np.argmin(cost)]) if cost.size and cost.min() <= limit else np.inf


def _shift(point: Array) -> Array:
    """(3, 3) translation that carries the origin to a point."""
    out = np.eye(3)
    out[:2, 2] = point
    return out


def _null(f: Array) -> Array:
    """(3,) epipole e with f e = 0, scaled so that its first two numbers have length 1."""
    e: Array = np.linalg.svd(f)[2][-1]
    return e / max(float(np.hypot(e[0], e[1])), _TINY)


def _turn(e: Array) -> Array:
    """(3, 3) rotation that carries an epipole onto (1, 0, f)."""
    return np.array([[e[0], e[1], 0.0], [-e[1], e[0], 0.0], [0.0, 0.0, 1.0]])


def _foot(line: Array) -> Array:
    """(3,) point of a line nearest to the origin."""
    x, y, z = line
    return np.array([-x * z, -y * z, x * x + y * y])


def _pixels(k: Array, xy: Array) -> Array:
    return xy @ k[:2, :2].T + k[:2, 2]


def _normalised(k: Array, uv: Array) -> Array:
    xy = np.linalg.solve(k[:2, :2], (uv - k[:2, 2]).T).T
    return np.concatenate([xy, np.ones_like(xy[:, :1])], axis=1)


def _meet(rig: StereoRig, left: Array, right: Array) -> Array:
    """Meet corrected rays (n, 3), which do; NaN behind a camera."""
    toward = right @ rig.R
    centre = -rig.R.T @ rig.t
    cross = np.cross(left, toward)
    with np.errstate(divide='ignore', invalid='ignore'):
        size = np.sum(cross * cross, axis=1)
        a = np.sum(np.cross(centre, toward) * cross, axis=1) / size
        b = np.sum(np.cross(centre, left) * cross, axis=1) / size
        ahead = (a > 0) & (b > 0) & np.isfinite(a)
    return np.where(ahead[:, None], a[:, None] * left, np.nan)
