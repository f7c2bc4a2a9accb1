# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Epipolar residuals of details: geometry against brute force, rotations found in images."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.ray_plane import Plane
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.site.refine.empty_road import Background
from stereo_speed.site.refine.rig_check import epipolar_check, off_lines


WALL = Plane(np.array([0.0, 0.0, 1.0]), 30.0)


@pytest.fixture
def rig():
    """Return a rig whose cameras are not quite parallel."""
    k = np.array([[900.0, 0.0, 319.5], [0.0, 900.0, 239.5], [0.0, 0.0, 1.0]])
    cameras = [Camera(n, 640, 480, k, np.zeros(0), 'plumb_bob') for n in ('left', 'right')]
    return StereoRig(*cameras, Rotation.from_rotvec([0.003, -0.01, 0.004]).as_matrix(),
                     np.array([-0.5, 0.004, 0.01]))


def test_points_seen_by_a_drifted_rig(rig):
    """Their residuals are those predicted by the slopes."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-8, -3, 15], [8, 3, 80], (200, 3))
    drift = np.radians([0.03, 0.02, -0.05])
    left, right, _, _ = rig.drifted(drift).project(points)
    residual, slope = off_lines(rig, left, right)
    assert np.abs(residual - slope @ drift).max() < 2e-3 and np.abs(residual).max() > 0.2
    exact = off_lines(rig, *rig.project(points)[:2])[0]
    assert np.abs(exact).max() < 1e-9


def textured(rig, plane_d, rng):
    """Render a textured wall in both views, by its exact homography."""
    texture = cv2.GaussianBlur(rng.standard_normal((900, 1200)).astype(np.float32), (0, 0), 2.0)
    texture = 110 + 40 * texture / texture.std()
    from_left = np.array([[1.0, 0, 250], [0, 1.0, 200], [0, 0, 1]])
    n = np.array([0.0, 0.0, 1.0])
    k = rig.left.K
    to_right = k @ (rig.R + np.outer(rig.t, n) / plane_d) @ np.linalg.inv(k)
    views = []
    for h in (from_left, from_left @ np.linalg.inv(to_right)):
        views.append(cv2.warpPerspective(texture, h, (640, 480),
                                         flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP))
    return Background(views[0], 1.0, 9), Background(views[1], 1.0, 9)


def test_tilt_and_roll_in_images(rig):
    drift = np.radians([0.0, 0.03, -0.05])
    images = textured(rig.drifted(drift), 30.0, np.random.default_rng(1))
    found = epipolar_check(rig, images, WALL)
    std = np.sqrt(np.diag(np.linalg.inv(found.information)))
    assert found.details > 300 and found.residual_px > 0.2
    assert np.all(np.abs(found.drift_rad - drift)[1:] < 3 * std[1:])
    assert np.degrees(std[1]) < 0.002 and np.degrees(std[2]) < 0.02
    # epipolar lines hardly constrain a pan
    assert std[0] > 5 * std[1]


def test_nothing_to_match(rig):
    blank = Background(np.full((480, 640), 90, np.float32), 1.0, 1)
    assert epipolar_check(rig, (blank, blank), WALL) is None
