# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The 3-D line of a straight path from its two image lines (Zhu 2012, eq. 19-24).

All pixels are undistorted, ``K (x, y, 1)``, so that straight lines remain straight. Signs
follow ``n^T P = d`` and motion ``P' = P + v k`` (see ``planes``). So the minus that eq. 22 and 23
print before ``v / (Z + v k_3)`` is a plus here, the second row has ``k_2`` instead of the printed
``k_1``, and eq. 24 reads ``d' = d + v n^T k``.
"""
from __future__ import annotations

import numpy as np

from ...core.records import Array
from ...geometry.camera import Camera
from ...geometry.rig import StereoRig
from ...road.path import CAMERA_UP, StraightPath


def undistorted_px(camera: Camera, uv_px: Array) -> Array:
    """
    Convert raw pixels to undistorted pixels of the same camera.

    :param uv_px: (..., 2).
    """
    return camera.undistort(uv_px) @ camera.K[:2, :2].T + camera.K[:2, 2]


def image_line(uv_px: Array) -> Array:
    """
    Fit a line (3,), ``l . (u, v, 1) = 0`` with unit normal, by total least squares.

    :param uv_px: (n, 2) undistorted pixels, n >= 2.
    """
    centre = uv_px.mean(axis=0)
    normal = np.linalg.svd(uv_px - centre, full_matrices=True)[2][1]
    return np.append(normal, -normal @ centre)


def plucker_line(rig: StereoRig, line_left: Array, line_right: Array) -> Array:
    """
    Return the Plücker matrix (4, 4) of the 3-D line seen as two image lines (eq. 19, 20).

    :param line_left: (3,) in undistorted pixels of the left view.
    :param line_right: (3,) in undistorted pixels of the right view.
    """
    q_left = (rig.left.K @ np.eye(3, 4)).T @ line_left
    q_right = (rig.right.K @ np.column_stack([rig.R, rig.t])).T @ line_right
    return np.outer(q_left, q_right) - np.outer(q_right, q_left)


def direction(plucker: Array) -> Array:
    """
    Return the unit direction of a line (eq. 21); NaN where the two planes coincide.

    :param plucker: (4, 4) from :func:`plucker_line`.
    """
    k = np.array([-plucker[1, 2], plucker[0, 2], -plucker[0, 1]])
    with np.errstate(invalid='ignore'):
        return np.asarray(k / np.linalg.norm(k))


def nearest_to_origin(plucker: Array) -> Array:
    """
    Return the point of a line that is nearest to the left camera's centre.

    With planes ``(a, a4)`` and ``(b, b4)`` the matrix holds ``m = a x b`` and ``w = a b4 - b a4``
    and the point is ``w x m / m^2``; the sign of the whole matrix cancels.

    :param plucker: (4, 4) from :func:`plucker_line`.
    """
    m = np.array([plucker[1, 2], -plucker[0, 2], plucker[0, 1]])
    return np.asarray(np.cross(plucker[:3, 3], m) / (m @ m))


def moved_pixels(camera: Camera, uv_px: Array, depth_m: Array, step: Array) -> Array:
    """
    Move the pixels of points that all move by ``v k`` (eq. 22, 23).

    :param uv_px: (..., 2) undistorted pixels.
    :param depth_m: (...,) depths of their points before the motion.
    :param step: (3,) ``v k`` in m.
    """
    rate = 1 / (depth_m + step[2])
    return np.asarray(uv_px + rate[..., None] * (
        camera.K[:2, :2] @ step[:2] + (camera.K[:2, 2] - uv_px) * step[2]))


def straight_path(
        rig: StereoRig, left_px: Array, right_px: Array, up: Array = CAMERA_UP) -> StraightPath:
    """
    Reconstruct one straight line from its picks in the two raw views, picked independently.

    It runs from the foot of the first left pick to that of the last.

    :param left_px: (n, 2) raw pixels in order along travel.
    :param right_px: (m, 2) raw pixels in order along travel.
    :param up: (3,), approximate up direction.
    """
    plucker = plucker_line(rig, image_line(undistorted_px(rig.left, left_px)),
                           image_line(undistorted_px(rig.right, right_px)))
    k, point = direction(plucker), nearest_to_origin(plucker)
    ends = foot_on_line(rig.left.rays(np.asarray(left_px)[[0, -1]]), point, k)
    if ends[1] < ends[0]:
        k, ends = -k, -ends
    return StraightPath(point + ends[0] * k, k, ends[1] - ends[0], up)


def foot_on_line(rays: Array, point_m: Array, k: Array) -> Array:
    """
    Return the lengths (...,) along a line from ``point_m`` to its points nearest to rays.

    :param rays: (..., 3) from the left camera's centre.
    :param point_m: (3,) on the line.
    :param k: (3,) unit direction of the line.
    """
    rr, rk = np.sum(rays * rays, axis=-1), rays @ k
    return np.asarray((rk * (rays @ point_m) - rr * (point_m @ k)) / (rr - rk * rk))
