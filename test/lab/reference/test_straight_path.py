# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Straight lines from two views: eq. 19-24."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.reference import straight_path as straight
from stereo_speed.lab.reference.planes import map_points, motion_homography

K = np.array([[1500.0, 0.0, 511.5], [0.0, 1480.0, 383.5], [0.0, 0.0, 1.0]])
START, TRAVEL = np.array([-4.0, 2.0, 70.0]), np.array([0.08, 0.02, -1.0])


def make_rig(d=(-0.2, 0.1, 1e-3, -1e-3), r=(0.004, -0.02, 0.003)):
    """Return a rig with distortion whose cameras are not parallel."""
    cameras = [Camera(name=n, width_px=1024, height_px=768, K=K, D=d, model='plumb_bob')
               for n in ('left', 'right')]
    return StereoRig(*cameras, cv2.Rodrigues(np.array(r, dtype=float))[0],
                     np.array([-0.5, 0.006, 0.01]))


def make_picks(rig):
    """Project points of the line, different ones in each view."""
    a, b = np.linspace(0, 50, 9)[:, None], np.linspace(2, 48, 7)[:, None]
    return rig.project(START + a * TRAVEL)[0], rig.project(START + b * TRAVEL)[1]


def test_line_is_recovered_exactly():
    """Noise-free picks through distortion give the line, its start and its direction."""
    rig = make_rig()
    path = straight.straight_path(rig, *make_picks(rig))
    np.testing.assert_allclose(path.position(0.0), START, atol=1e-6)
    np.testing.assert_allclose(
        path.tangent(0.0), TRAVEL / np.linalg.norm(TRAVEL), atol=1e-8)
    assert path.length_m == pytest.approx(50 * np.linalg.norm(TRAVEL), abs=1e-6)


def test_direction_follows_the_order_of_the_picks():
    """Picks in the other order give the other direction."""
    rig = make_rig()
    left, right = make_picks(rig)
    path = straight.straight_path(rig, left[::-1], right[::-1])
    np.testing.assert_allclose(path.tangent(0.0), -TRAVEL / np.linalg.norm(TRAVEL), atol=1e-8)


def test_plucker_hand_worked():
    """The line through (1, 2, z) along z seen by parallel unit cameras half a metre apart."""
    camera = Camera(name='unit', width_px=9, height_px=9, K=np.eye(3), D=(), model='plumb_bob')
    rig = StereoRig(camera, camera, np.eye(3), np.array([-0.5, 0, 0]))
    line_left, line_right = np.array([2.0, -1, 0]), np.array([2.0, -0.5, 0])  # 2u = v, 4u = v
    plucker = straight.plucker_line(rig, line_left, line_right)
    np.testing.assert_allclose(plucker, -plucker.T)
    np.testing.assert_allclose(np.abs(straight.direction(plucker)), [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(straight.nearest_to_origin(plucker), [1, 2, 0], atol=1e-12)


def test_line_in_the_epipolar_plane_has_no_direction():
    """Both views have the same information, and the planes coincide."""
    rig = make_rig(d=(), r=(0, 0, 0))
    rig = StereoRig(rig.left, rig.right, rig.R, np.array([-0.5, 0, 0]))
    flat = np.array([0.0, 1.0, -400.0])
    assert np.isnan(straight.direction(straight.plucker_line(rig, flat, flat))).all()


def test_moved_pixels_equal_the_projections_and_the_homography():
    """Eq. 22 and 23 agree with moved points and with eq. 5."""
    rig = make_rig(d=())
    points = np.array([[-2.0, 1.0, 40.0], [1.0, 0.5, 40.0]])
    step = 3.3 * TRAVEL
    uv, later = rig.left.project(points)[0], rig.left.project(points + step)[0]
    np.testing.assert_allclose(
        straight.moved_pixels(rig.left, uv, points[:, 2], step), later, atol=1e-9)
    plane = np.array([0.0, 0, 1]), 40.0
    np.testing.assert_allclose(
        map_points(motion_homography(rig.left, plane, np.eye(3), step), uv), later, atol=1e-9)
