# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Moving planes: homographies against moved points, and hand-worked cases."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.ray_plane import back_project
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.reference import planes as plane

K = np.array([[1500.0, 0.0, 511.5], [0.0, 1500.0, 383.5], [0.0, 0.0, 1.0]])


def make_rig(d=()):
    """Return a rig that is not parallel."""
    left = Camera(name='left', width_px=1024, height_px=768, K=K, D=d, model='plumb_bob')
    right = Camera(name='right', width_px=1024, height_px=768, K=K, D=d, model='plumb_bob')
    return StereoRig(left, right, cv2.Rodrigues(np.array([0.01, -0.03, 0.005]))[0],
                     np.array([-0.5, 0.01, 0.02]))


def make_scene(rng, particles=5):
    """Return particles' planes, the four corners on each, and motions."""
    normals = np.array([0.05, 0.1, -1.0]) + rng.normal(0, 0.1, (particles, 3))
    n, d = plane.plane_through(np.array([-2.0, 1.0, 50.0]), normals)
    rays = np.array([[-0.06, 0.0, 1], [-0.02, 0.0, 1], [-0.02, 0.04, 1], [-0.06, 0.04, 1]])
    corners = back_project(rays, n[:, None, :], d[:, None])
    rotation = np.stack([cv2.Rodrigues(r)[0] for r in rng.normal(0, 0.05, (particles, 3))])
    return n, d, corners, rotation, rng.normal([0.5, 0.1, -4], 0.5, (particles, 3))


@pytest.mark.parametrize('lens', [(), (-0.2, 0.1, 1e-3, -1e-3)], ids=['ideal', 'distorted'])
def test_quads_follow_the_points_of_the_plane(lens):
    """Eq. 5, 8 and 11 in both raw views give the projections of the moved points."""
    rig = make_rig(lens)
    n, d, corners, rotation, translation = make_scene(np.random.default_rng(4))
    before = rig.project(corners)[:2]
    moved = corners @ np.swapaxes(rotation, -1, -2) + translation[:, None]
    wanted = rig.project(moved)[:2]
    got = plane.propagate_quads(rig, before, (n, d), (rotation, translation))
    np.testing.assert_allclose(got[0], wanted[0], atol=1e-6)
    np.testing.assert_allclose(got[1], wanted[1], atol=1e-6)
    n1, d1 = plane.moved_plane(n, d, rotation, translation)  # eq. 10
    np.testing.assert_allclose(np.sum(moved * n1[:, None], -1), np.tile(d1[:, None], 4))
    np.testing.assert_allclose(
        plane.carry_to_right(rig, wanted[0], n1, d1), wanted[1], atol=1e-6)


def test_pixel_homographies_equal_opencv():
    """Eq. 5 and 15 in pixels against cv2.getPerspectiveTransform of the four corners."""
    rig = make_rig()
    n, d, corners, rotation, translation = make_scene(np.random.default_rng(5), 3)
    moved = corners @ np.swapaxes(rotation, -1, -2) + translation[:, None]
    left, right = rig.project(corners)[:2]
    later = rig.left.project(moved)[0]
    motion = plane.motion_homography(rig.left, (n, d), rotation, translation)
    cross = plane.cross_homography(rig, n, d)
    for i in range(3):
        for h, a, b in ((motion[i], left[i], later[i]), (cross[i], left[i], right[i])):
            wanted = cv2.getPerspectiveTransform(a.astype(np.float32), b.astype(np.float32))
            corner = np.array([[500.0, 400.0]])
            np.testing.assert_allclose(
                plane.map_points(h, corner), plane.map_points(wanted, corner), atol=0.02)


def test_hand_worked():
    """A plane facing the camera at 50 m that comes 10 m nearer grows by 50/40."""
    rig = make_rig()
    h = plane.motion_homography(
        rig.left, (np.array([0.0, 0, 1]), 50.0), np.eye(3), np.array([0.0, 0, -10]))
    uv = plane.map_points(h, np.array([[511.5 + 40, 383.5 - 20]]))
    np.testing.assert_allclose(uv, [[511.5 + 50, 383.5 - 25]])


def test_motion_in_right_equals_eq_8():
    """The same as the 4x4 product T dT T^-1."""
    rig = make_rig()
    rotation, translation = cv2.Rodrigues(np.array([0.1, 0.2, -0.1]))[0], np.array([1.0, 2, 3])
    t, dt = np.eye(4), np.eye(4)
    t[:3, :3], t[:3, 3] = rig.R, rig.t
    dt[:3, :3], dt[:3, 3] = rotation, translation
    wanted = t @ dt @ np.linalg.inv(t)
    got = plane.motion_in_right(rig, rotation, translation)
    np.testing.assert_allclose(got[0], wanted[:3, :3], atol=1e-12)
    np.testing.assert_allclose(got[1], wanted[:3, 3], atol=1e-12)


def test_points_behind_the_camera_are_nan():
    """A homography that sends a point behind the camera gives no pixel."""
    behind = plane.map_points(np.diag([1.0, 1, -1]), np.array([[1.0, 2]]))
    assert np.isnan(behind).all()
