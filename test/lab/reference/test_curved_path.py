# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Space curves from two views, and motion along them: eq. 25-27."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.reference.curved_path import chord_step, curved_path, motion_along
from stereo_speed.road.path import SplinePath, StraightPath

K = np.array([[1500.0, 0.0, 511.5], [0.0, 1500.0, 383.5], [0.0, 0.0, 1.0]])


def make_rig():
    """Return a parallel rig."""
    camera = Camera(name='c', width_px=1024, height_px=768, K=K, D=(), model='plumb_bob')
    return StereoRig(camera, camera, np.eye(3), np.array([-0.5, 0, 0]))


def circle(a):
    """Return points of a circle of 60 m radius that comes nearer and downhill."""
    return np.stack([-6 + 60 * (1 - np.cos(a)), 1 + 4 * a, 60 - 60 * np.sin(a)], axis=-1)


def test_curve_from_two_views_picked_independently():
    """Noise-free picks reproduce the curve to a centimetre or two at 60 m."""
    rig = make_rig()
    left = rig.project(circle(np.linspace(0.0, 0.6, 40)))[0]
    right = rig.project(circle(np.linspace(-0.05, 0.65, 47)))[1]
    path = curved_path(rig, left, right)
    wanted = circle(np.linspace(0.05, 0.55, 30))
    gap = wanted - path.position(path.arc_length(wanted))
    assert np.linalg.norm(gap, axis=-1).max() < 0.02


@pytest.mark.parametrize('path', [
    StraightPath(np.array([0.0, 0, 60]), np.array([0.0, 0, -1]), 50.0),
    SplinePath(circle(np.linspace(0, 0.8, 30)))], ids=['straight', 'circle'])
def test_chord_and_motion(path):
    """The chord has the requested length, and the motion maps frame and point."""
    s0 = np.array([0.0, 5.0, 12.0])
    s1 = chord_step(path, s0, 4.0)
    gap = np.linalg.norm(path.position(s1) - path.position(s0), axis=-1)
    np.testing.assert_allclose(gap, 4.0)
    assert np.all(s1 > s0) and np.all(s1 - s0 >= 4.0 - 1e-9)
    rotation, translation = motion_along(path, s0, s1)
    np.testing.assert_allclose(rotation @ path.frame(s0), path.frame(s1), atol=1e-12)
    moved = (rotation @ path.position(s0)[..., None])[..., 0] + translation
    np.testing.assert_allclose(moved, path.position(s1), atol=1e-9)
    np.testing.assert_allclose(chord_step(path, 3.0, 0.0), 3.0)
