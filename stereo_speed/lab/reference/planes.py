# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Planes, their motion, and the homographies they induce (Zhu 2012, eq. 5-8, 10, 11, 15).

A plane is ``n^T P = d`` with unit normal n. A point of it seen at depth Z is ``P = Z x`` with x
its ray at depth 1, so ``1 = n^T P / d`` and the motion ``P' = dR P + dt`` is, for points of the
plane, linear: ``P' = (dR + dt n^T / d) P``. Hence eq. 5 reads ``H = K (dR + dt n^T / d) K^-1``
and eq. 15 ``H_c = K_r (R + t n^T / d) K_l^-1``. The paper prints ``- t^T n`` for ``t n^T`` in
both, and ``- dt^T dR`` in eq. 10: its signs are those of ``n^T P + d = 0``, although its text
says ``n^T P = d``, and ``t^T n`` would be a scalar. With ``n^T P = d`` eq. 10 becomes
``n' = dR n``, ``d' = d + dt^T n'``, as ``n'^T P' = n^T P + n'^T dt``.

All functions work on stacks: leading axes broadcast. Homographies hold for undistorted pixels;
:func:`propagate_quads` takes raw ones through the lens and back.
"""
from __future__ import annotations

import numpy as np

from ...core.records import Array
from ...geometry.camera import Camera
from ...geometry.rig import StereoRig


def plane_through(point_m: Array, normal: Array) -> tuple[Array, Array]:
    """
    Return the plane (n, d) through a point.

    :param point_m: (..., 3).
    :param normal: (..., 3) any length.
    """
    normal = np.asarray(normal, dtype=np.float64)
    n = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return n, np.sum(n * point_m, axis=-1)


def moved_plane(n: Array, d: Array, rotation: Array, translation: Array) -> tuple[Array, Array]:
    """
    Move a plane by ``P' = rotation P + translation`` (eq. 10).

    :param n: (..., 3) unit normals.
    :param d: (...,) m.
    :param rotation: (..., 3, 3).
    :param translation: (..., 3) m.
    """
    moved = _times(rotation, n)
    return moved, d + np.sum(translation * moved, axis=-1)


def in_right(rig: StereoRig, n: Array, d: Array) -> tuple[Array, Array]:
    """
    Express a plane of the left camera's frame in the right one's (eq. 7).

    :param n: (..., 3) unit normals.
    :param d: (...,) m.
    """
    return moved_plane(n, d, rig.R, rig.t)


def motion_in_right(
        rig: StereoRig, rotation: Array, translation: Array) -> tuple[Array, Array]:
    """
    Express a motion of the left camera's frame in the right one's (eq. 8).

    ``T [dR dt] T^-1`` gives ``R dR R^T`` and ``R dt + t - R dR R^T t``.

    :param rotation: (..., 3, 3).
    :param translation: (..., 3) m.
    """
    rotation_r = rig.R @ rotation @ rig.R.T
    return rotation_r, _times(rig.R, translation) + rig.t - _times(rotation_r, rig.t)


def plane_homography(
        n: Array, d: Array, rotation: Array, translation: Array) -> Array:
    """
    Return (..., 3, 3) ``rotation + translation n^T / d``, between normalised coordinates.

    :param n: (..., 3) unit normals.
    :param d: (...,) m, not 0: a plane through the camera's centre has no homography.
    :param rotation: (..., 3, 3).
    :param translation: (..., 3) m.
    """
    d = np.asarray(d, dtype=np.float64)[..., None, None]
    return rotation + np.asarray(translation)[..., :, None] * np.asarray(n)[..., None, :] / d


def motion_homography(
        camera: Camera, plane: tuple[Array, Array], rotation: Array, translation: Array) -> Array:
    """
    Return the homography of a moving plane in one view, undistorted pixels (eq. 5).

    :param plane: n (..., 3) and d (...,) in this camera's frame, before the motion.
    :param rotation: (..., 3, 3) in this camera's frame.
    :param translation: (..., 3) m, in this camera's frame.
    """
    h = plane_homography(*plane, rotation, translation)
    return camera.K @ h @ np.linalg.inv(camera.K)


def cross_homography(rig: StereoRig, n: Array, d: Array) -> Array:
    """
    Return the homography from the left to the right view, undistorted pixels (eq. 15).

    :param n: (..., 3) unit normals.
    :param d: (...,) m.
    """
    return rig.right.K @ plane_homography(n, d, rig.R, rig.t) @ np.linalg.inv(rig.left.K)


def map_points(h: Array, xy: Array) -> Array:
    """
    Map points by homographies (eq. 11); NaN where they end up behind the camera.

    :param h: (..., 3, 3).
    :param xy: (..., m, 2).
    """
    out = xy @ np.swapaxes(h[..., :2], -1, -2) + h[..., None, :, 2]
    w = np.where(out[..., 2:] > 0, out[..., 2:], np.nan)
    return out[..., :2] / w


def propagate_quads(
        rig: StereoRig, quads_px: tuple[Array, Array], plane: tuple[Array, Array],
        motion: tuple[Array, Array]) -> tuple[Array, Array]:
    """
    Move the quads of a moving plane in both raw views, each by its own homography (eq. 11).

    :param quads_px: left and right (..., 4, 2), raw pixels before the motion.
    :param plane: n (..., 3) and d (...,) in the left camera's frame, before the motion.
    :param motion: rotation (..., 3, 3) and translation (..., 3) in the left camera's frame.
    """
    left = map_points(plane_homography(*plane, *motion), rig.left.undistort(quads_px[0]))
    h_right = plane_homography(*in_right(rig, *plane), *motion_in_right(rig, *motion))
    right = map_points(h_right, rig.right.undistort(quads_px[1]))
    return rig.left.distort(left), rig.right.distort(right)


def carry_to_right(rig: StereoRig, uv_left: Array, n: Array, d: Array) -> Array:
    """
    Carry raw pixels of a plane from the left view into the right raw view (eq. 15).

    :param uv_left: (..., m, 2).
    :param n: (..., 3) unit normals.
    :param d: (...,) m.
    """
    h = plane_homography(n, d, rig.R, rig.t)
    return rig.right.distort(map_points(h, rig.left.undistort(uv_left)))


def _times(matrix: Array, vectors: Array) -> Array:
    """Multiply stacks of (3, 3) and (3,)."""
    return (np.asarray(matrix) @ np.asarray(vectors)[..., None])[..., 0]
