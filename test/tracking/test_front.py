# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The front on its path: by hand, against OpenCV, and on a circle in closed form."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.path import SplinePath, StraightPath
from stereo_speed.tracking.front import Front, onto_cross_plane, plane_points


@pytest.fixture()
def rig():
    K = np.array([[1000.0, 0, 512], [0, 1000.0, 384], [0, 0, 1]])
    left, right = (Camera(name=side, width_px=1024, height_px=768, K=K, D=np.zeros(5),
                          model='plumb_bob') for side in ('left', 'right'))
    return StereoRig(left=left, right=right, R=np.eye(3), t=np.array([-0.5, 0, 0]),
                     frame_id='left')


@pytest.fixture()
def oncoming():
    """Return a straight path from 60 m ahead towards the camera, 2 m below it."""
    return StraightPath(np.array([0.0, 2.0, 60.0]), np.array([0.0, 0.0, -1.0]), 50.0)


def test_oncoming_front_points_by_hand(oncoming):
    # Travel is towards the camera, so left of travel is right in the image (+x), up is -y.
    got = plane_points(oncoming, np.array([[10.0, 0.5, 0.8]]), np.array([[0.0, 0.0], [1.0, 0.3]]))
    np.testing.assert_allclose(got[0], [[0.5, 1.2, 50.0], [1.5, 0.9, 50.0]], atol=1e-12)


def test_onto_cross_planeion_undoes_projection(rig, oncoming):
    plane_xy = np.array([[-0.9, 0.4], [0.9, 0.4], [0.9, -0.4]])
    points = plane_points(oncoming, np.array([[20.0, 0.3, 0.7]]), plane_xy)[0]
    uv, _ = rig.left.project(points)
    np.testing.assert_allclose(onto_cross_plane(oncoming, rig.left, 20.0, uv),
                               plane_xy + [0.3, 0.7], atol=1e-9)


def test_quads_follow_the_plane_induced_homographies(rig, oncoming):
    """Corners projected in 3-D move as eq. 5, 8 and 11 predict, in both views."""
    front = Front(oncoming, np.array([[-0.9, 0.4], [0.9, 0.4], [0.9, -0.4], [-0.9, -0.4]]))
    before = front.corners(rig, np.array([[10.0, 0.0, 0.8]]))
    after = front.corners(rig, np.array([[14.0, 0.1, 0.8]]))
    motion = np.array([0.1, 0.0, -4.0])  # 4 m along travel, 0.1 m to its left
    normal, K = np.array([0.0, 0.0, -1.0]), rig.left.K
    for camera_offset, was, now in zip((0.0, -0.5), before, after):
        distance = normal @ np.array([camera_offset, 0.0, 50.0])
        H = K @ (np.eye(3) + np.outer(motion, normal) / distance) @ np.linalg.inv(K)
        mapped = np.column_stack([was[0], np.ones(4)]) @ H.T
        np.testing.assert_allclose(mapped[:, :2] / mapped[:, 2:], now[0], atol=1e-9)


@pytest.mark.parametrize('offset_m', [-0.5, 0.0, 0.5])
def test_ground_speed_on_a_circle_grows_with_the_radius(offset_m):
    radius = 41.0
    angle = np.linspace(0, 1.2, 60)
    # A left-hand bend as the driver sees it, seen from above (x right, z forward).
    points = np.column_stack([-radius * (1 - np.cos(angle)), np.zeros(60),
                              radius * np.sin(angle)])
    front = Front(SplinePath(points), np.zeros((4, 2)))
    got = front.ground_speed(np.array([20.0, offset_m, 0.5]), 10.0)
    assert got == pytest.approx(10.0 * (1 - offset_m / radius), rel=1e-4)


@pytest.mark.parametrize('height_m', [0.0, 0.6, 2.0])
@pytest.mark.parametrize('up', [1.0, -1.0], ids=['crest', 'sag'])
def test_ground_speed_over_a_crest_is_that_of_the_wheels(height_m, up):
    """A point above the road moves (1 + h / R) times as far over a crest of radius R."""
    radius, angle = 500.0, np.linspace(-0.1, 0.1, 60)
    points = np.column_stack([np.zeros(60), up * radius * (1 - np.cos(angle)),
                              40 - radius * np.sin(angle)])
    front = Front(SplinePath(points), np.zeros((4, 2)))
    there, back = (front.centre(np.array([s, 0.3, height_m])) for s in (50.0, 49.0))
    assert np.linalg.norm(there - back) == pytest.approx(1 + up * height_m / radius, rel=1e-4)
    got = front.ground_speed(np.array([50.0, 0.3, height_m]), 10.0)
    assert got == pytest.approx(10.0, rel=1e-5)
