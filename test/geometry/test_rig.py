# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Rigs against OpenCV and against their own projections."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.core.errors import CalibrationError
from stereo_speed.core.records import RigMotion
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import angles_of, of_camera, StereoRig

K = np.array([[1500.0, 0.0, 511.5], [0.0, 1500.0, 383.5], [0.0, 0.0, 1.0]])


def make_rig(r=(0.01, -0.03, 0.005), t=(-0.5, 0.01, 0.02), d=(-0.2, 0.1, 1e-3, -1e-3)):
    """Make a rig with converging cameras and distortion."""
    left = Camera(name='left', width_px=1024, height_px=768, K=K, D=d, model='plumb_bob')
    right = Camera(name='right', width_px=1024, height_px=768, K=K, D=d, model='plumb_bob')
    return StereoRig(left, right, cv2.Rodrigues(np.array(r, dtype=float))[0], np.array(t))


def test_triangulation_recovers_projected_points():
    """Noise-free pixels give the original points."""
    rig = make_rig()
    points = np.random.default_rng(2).uniform([-5, -3, 15], [5, 3, 80], (4, 25, 3))
    left, right, _, _ = rig.project(points)
    np.testing.assert_allclose(rig.triangulate(left, right), points, rtol=1e-7)


def test_noisy_triangulation_is_no_worse_than_opencv():
    """Reprojection errors are at most those of cv2.triangulatePoints, pair by pair."""
    rng = np.random.default_rng(3)
    rig = make_rig(d=())
    points = rng.uniform([-5, -3, 15], [5, 3, 60], (200, 3))
    left, right = (uv + rng.normal(0, 0.5, uv.shape) for uv in rig.project(points)[:2])
    m_left, m_right = K @ np.eye(3, 4), K @ np.column_stack([rig.R, rig.t])
    theirs = cv2.triangulatePoints(m_left, m_right, left.T, right.T)
    theirs = (theirs[:3] / theirs[3]).T

    def cost(p):
        a, b, _, _ = rig.project(p)
        return np.sum((a - left)**2 + (b - right)**2, axis=-1)

    ours = rig.triangulate(left, right)
    assert np.all(cost(ours) <= cost(theirs) + 1e-6)
    np.testing.assert_allclose(ours, theirs, rtol=1e-2)


def test_hand_worked_depth():
    """Focal length 1500 px, baseline 0.5 m, disparity 15 px: 50 m."""
    rig = make_rig(r=(0, 0, 0), t=(-0.5, 0, 0), d=())
    np.testing.assert_allclose(
        rig.triangulate(np.array([511.5, 383.5]), np.array([496.5, 383.5])), [0, 0, 50], atol=1e-9)
    assert rig.baseline_m == 0.5


def test_points_behind_or_at_infinity_are_nan():
    """Negative and zero disparity have no point."""
    rig = make_rig(r=(0, 0, 0), t=(-0.5, 0, 0), d=())
    left = np.array([[511.5, 383.5], [511.5, 383.5]])
    assert np.isnan(rig.triangulate(left, left + [[9, 0], [0, 0]])).all()


@pytest.mark.filterwarnings('error')
def test_rays_parallel_up_to_rounding_do_not_meet():
    """Their depth is infinite, and no warning is raised."""
    pixel = np.array([600.0, 383.5])
    assert np.isnan(make_rig(r=(0, 0, 0), t=(-0.5, 0, 0), d=()).triangulate(
        pixel, pixel - [1e-10, 0.0])).all()


def test_epipolar_lines_contain_the_other_view():
    """The other view's pixel lies on the epipolar line."""
    rig = make_rig()
    left, right, _, _ = rig.project(np.array([[1.0, 2, 30], [-3, 1, 50]]))
    on_right = np.sum(rig.epipolar_lines_right(left) * rig.right.rays(right), axis=-1)
    np.testing.assert_allclose(on_right, 0, atol=1e-12)


def test_frames_round_trip():
    """The left camera's centre, and points transformed there and back."""
    rig, points = make_rig(), np.array([[1.0, 2, 30], [-3, 1, 50]])
    np.testing.assert_allclose((rig.to_right(points) - rig.t) @ rig.R, points)
    np.testing.assert_allclose(rig.to_right(np.zeros(3)), rig.t)
    np.testing.assert_allclose(rig.to_right(-rig.R.T @ rig.t), 0, atol=1e-15)


@pytest.mark.parametrize('kwargs, what', [
    ({'t': (0, 0, 0)}, 'baseline'), ({'t': (np.nan, 0, 0)}, 't')])
def test_refuses(kwargs, what):
    """Arguments that cannot be a rig are named."""
    with pytest.raises(CalibrationError, match=f'rig: {what}: found'):
        make_rig(**kwargs)


def test_refuses_a_matrix_that_is_no_rotation():
    """A reflection is no rotation."""
    rig = make_rig()
    with pytest.raises(CalibrationError, match='rig: R: found'):
        StereoRig(rig.left, rig.right, np.diag([1.0, 1, -1]), rig.t)


def test_pan_of_the_rig_moves_the_view_to_the_left():
    """Focal length 1500 px: a point straight ahead moves by 1500 tan(0.1 degrees) = 2.618 px."""
    rig = make_rig(r=(0, 0, 0), t=(-0.5, 0, 0), d=()).swayed((np.radians(0.1), 0, 0))
    uv, _ = rig.left.project(np.array([0.0, 0.0, 40.0]))
    np.testing.assert_allclose(uv, [511.5 - 2.61800, 383.5], atol=1e-4)


def test_swaying_rig_triangulates_points_at_their_true_positions():
    """Points are triangulated at their true positions, however the rig is rotated."""
    motion = RigMotion((0.01, -0.004, 0.02), (0.002, 0.001, -0.003))
    rig = make_rig().as_taken(motion)
    points = np.random.default_rng(2).uniform([-5, -3, 15], [5, 3, 80], (4, 25, 3))
    left, right, _, _ = rig.project(points)
    np.testing.assert_allclose(rig.triangulate(left, right), points, rtol=1e-7)
    np.testing.assert_allclose(rig.baseline_m, make_rig().baseline_m, rtol=1e-12)


def test_sway_is_a_rigid_rotation_of_both_cameras():
    """In the frame of its left camera a swaying rig is unchanged."""
    still, sway = make_rig(), (0.01, -0.004, 0.02)
    points = np.random.default_rng(2).uniform([-5, -3, 15], [5, 3, 80], (25, 3))
    there = still.swayed(sway).project(points)[:2]
    np.testing.assert_allclose(there, still.project(points @ of_camera(sway).T)[:2], atol=1e-9)


def test_second_sway_is_that_of_the_rig_as_it_stands():
    """Both sways about one axis are the sum of their angles; in general, the rig stays rigid."""
    rig = make_rig()
    twice = rig.swayed((0.01, 0, 0)).swayed((0.02, 0, 0))
    np.testing.assert_allclose(twice.R, rig.swayed((0.03, 0, 0)).R, atol=1e-12)
    tilted = rig.swayed((0.01, -0.004, 0.02)).swayed((-0.02, 0.01, 0.005))
    points = np.random.default_rng(2).uniform([-5, -3, 15], [5, 3, 80], (25, 3))
    there = tilted.project(points)[:2]
    np.testing.assert_allclose(there, rig.project(points @ tilted.left.rotation.T)[:2], atol=1e-9)


def test_unmoved_rig_is_unchanged():
    """No motion, and a zero motion, cost nothing and change nothing."""
    rig = make_rig()
    assert rig.as_taken(None) is rig and rig.as_taken(RigMotion()) is rig


@pytest.mark.parametrize('angles_rad', [
    (0.0, 0.0, 0.0), (0.02, 0.0, 0.0), (0.0, -0.03, 0.0), (0.1, -0.2, 0.3)])
def test_angles_of_a_rotation_are_those_it_was_made_of(angles_rad):
    np.testing.assert_allclose(angles_of(of_camera(angles_rad)), angles_rad, atol=1e-12)
