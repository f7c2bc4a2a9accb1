# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The vehicle's front: a plane across the road's path, and its projection into both views.

A pose is (s, a, b): arc length along the path, offset to the left of travel and offset above the
path, all in m.  The front's plane passes through C(s) and holds the path's normal P and binormal
B, so its normal is the tangent T (2012, Section IV-B).  A point of the front has fixed
coordinates (x, y) on that plane, and lies at C(s) + (a + x) P(s) + (b + y) B(s).

A vehicle that changes lanes points in the direction of its motion: the plane of its front is
rotated about B by the heading psi of that motion, and the point lies at
C(s) + a P + x (cos psi P - sin psi T) + (b + y) B.
"""
from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from .observation_kernels import points
from ..core.records import Array
from ..geometry.camera import Camera
from ..geometry.rig import StereoRig
from ..road.path import Path
from ..vision.sampling import quad_grid


def plane_points(path: Path, poses: Array, plane_xy_m: Array, heading_rad: float = 0.0,
                 relief_m: Array | float = 0.0) -> Array:
    """
    Return points of the front for many poses.

    :param poses: (N, 3) s, a, b in m.
    :param plane_xy_m: (M, 2) coordinates on the plane along P and B, m.
    :param heading_rad: psi, heading of the vehicle against the path, positive to the left.
    :param relief_m: (M,) how far the points stand out of the plane, positive forward, m.
    :return: (N, M, 3), left optical frame, m.
    """
    s_m = poses[:, 0]
    frame = path.frame(s_m)
    x, y = plane_xy_m.T
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    on_vehicle = np.empty((len(x), 3))
    on_vehicle[:, 0], on_vehicle[:, 1] = cos * relief_m - sin * x, sin * relief_m + cos * x
    on_vehicle[:, 2] = y
    beside = np.ascontiguousarray(poses[:, 1:])
    return np.asarray(points(path.position(s_m), frame, beside, on_vehicle))


def rotated(frame: Array, heading_rad: float) -> Array:
    """Return a path's frame (3, 3), columns T, P, B, rotated about B by a heading to the left."""
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    return np.asarray(frame @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]))


def onto_cross_plane(path: Path, camera: Camera, s_m: float, uv_px: Array) -> Array:
    """
    Return the intersections of left rays with the plane across the path at ``s_m``.

    :param uv_px: (M, 2) raw pixels of the left camera.
    :return: (M, 2) coordinates along P and B measured from the path, m.
    """
    rays = camera.rays(uv_px)
    origin, frame = path.position(np.array(s_m)), path.frame(np.array(s_m))
    depth = (origin @ frame[:, 0]) / (rays @ frame[:, 0])
    return np.asarray((rays * depth[:, None] - origin) @ frame[:, 1:])


@dataclass(frozen=True, eq=False)
class Front:
    """
    One vehicle's front on its lane's path.

    :param path: the lane's path.
    :param corners_m: (4, 2) corners on the plane about the front's centre, m, clockwise as seen
        in the image from its top left.
    """

    path: Path
    corners_m: Array

    @property
    def width_m(self) -> float:
        """Return the greatest width of the front, m."""
        return float(np.ptp(self.corners_m[:, 0]))

    def corners(self, rig: StereoRig, poses: Array, heading_rad: float = 0.0,
                right_poses: Array | None = None) -> tuple[Array, Array]:
        """
        Return the projected corners of the front: the 2-D sub-states of both views (eq. 11).

        The plane moves rigidly, so these quads equal those of the homographies of eq. 5 and 8;
        projecting in 3-D is also right for distorted lenses.

        :param poses: (N, 3) s, a, b, m.
        :param heading_rad: heading of the vehicle against the path.
        :param right_poses: (N, 3) poses in the right view, if that was exposed at another time.
        :return: (N, 4, 2) left and right raw pixels, NaN behind the camera.
        """
        points = plane_points(self.path, poses, self.corners_m, heading_rad)
        left, right, _, _ = rig.project(points)
        if right_poses is not None:
            right = rig.project(
                plane_points(self.path, right_poses, self.corners_m, heading_rad))[1]
        return left, right

    def grid_m(self, unit_xy: Array) -> Array:
        """Return grid samples on the plane about the front's centre, (G, 2) m."""
        return np.asarray(quad_grid(self.corners_m[None], unit_xy)[:, 0].T)

    def centre(self, pose: Array) -> Array:
        """Return the centre of the front for one pose, (3,), left optical frame, m."""
        return np.asarray(plane_points(self.path, pose[None], np.zeros((1, 2)))[0, 0])

    def ground_speed(self, pose: Array, speed_mps: float, lateral_mps: float = 0.0) -> float:
        """
        Return the speed over ground of the front, m/s.

        Beside the path on a bend, the front travels on another radius than the path.  During a
        lane change it also travels across the path.

        :param pose: (3,) s, a, b, m.
        :param speed_mps: speed along the path.
        :param lateral_mps: rate of the offset from the path.
        """
        along = speed_mps * float(self.path_scale(pose[None])[0])
        return math.copysign(math.hypot(along, lateral_mps), speed_mps)

    def path_scale(self, poses: Array) -> Array:
        """
        Return the metres (N,) travelled on the road per metre of the path: 1 - kappa a on a bend.

        The scale is taken on the road, because over a crest the front above it travels further
        than the wheels.
        """
        step = np.array([0.05, 0.0, 0.0])
        on_road = poses * np.array([1.0, 1.0, 0.0])
        both = plane_points(self.path, np.concatenate([on_road + step, on_road - step]),
                            np.zeros((1, 2)))[:, 0]
        way = np.linalg.norm(both[:len(poses)] - both[len(poses):], axis=1)
        return np.asarray(way / (2 * step[0]))
