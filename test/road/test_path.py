# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Paths: straight lines, circles and the invariants of every path."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.road.path import Path, SplinePath, StraightPath

LINE = StraightPath(np.array([1.0, 2, 50]), np.array([0.0, 0, -3]), 40.0)


def circle(radius_m=41.0, turn=1.2, n=25, **kwargs):
    """Return a circular path towards the camera, bending to the left of travel (camera +x)."""
    a = np.linspace(0, turn, n)
    return SplinePath(np.stack(
        [radius_m * (1 - np.cos(a)), np.full(n, 2.0), 60 - radius_m * np.sin(a)], -1), **kwargs)


def test_straight_hand_worked():
    """Towards the camera: left of travel is camera right, up is camera -y."""
    np.testing.assert_allclose(LINE.position(10.0), [1, 2, 40])
    np.testing.assert_allclose(LINE.frame(3.0), [[0, 1, 0], [0, 0, -1], [-1, 0, 0]])
    np.testing.assert_allclose(LINE.arc_length(np.array([[5.0, 0, 45], [0, 0, 60]])), [5, -10])


def test_circle_against_its_closed_form():
    """Length, positions, tangents and arc lengths of a circle of 41 m."""
    path, a = circle(), np.linspace(0, 1.2, 200)
    assert path.length_m == pytest.approx(41 * 1.2, rel=2e-6)
    wanted = np.stack([41 * (1 - np.cos(a)), np.full(200, 2.0), 60 - 41 * np.sin(a)], -1)
    np.testing.assert_allclose(path.position(41 * a), wanted, atol=2e-4)
    np.testing.assert_allclose(
        path.tangent(41 * a), np.stack([np.sin(a), 0 * a, -np.cos(a)], -1), atol=2e-4)
    off = wanted + 3.5 * path.frame(41 * a)[..., 1]  # towards the centre
    np.testing.assert_allclose(path.arc_length(off), 41 * a, atol=1e-3)
    np.testing.assert_allclose(path.frame(41 * a)[:, :, 2], np.tile([0, -1.0, 0], (200, 1)),
                               atol=1e-9)


@pytest.mark.parametrize('path', [LINE, circle(), circle(n=3)],
                         ids=['straight', 'circle', 'three points'])
def test_path_properties_hold(path):
    """Arc length is arc length, frames are rotations, and arc_length inverts position."""
    assert isinstance(path, Path)
    s = np.linspace(-20, path.length_m + 20, 400).reshape(20, 20)
    points, h = path.position(s), 1e-4
    np.testing.assert_allclose(path.arc_length(points), s, atol=1e-6)
    speed = np.linalg.norm(path.position(s + h) - path.position(s - h), axis=-1) / (2 * h)
    np.testing.assert_allclose(speed, 1, atol=2e-5)
    frame = path.frame(s)
    np.testing.assert_allclose(
        frame @ np.swapaxes(frame, -1, -2), np.broadcast_to(np.eye(3), frame.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frame), 1)
    np.testing.assert_allclose(frame[..., 0], path.tangent(s))
    assert np.all(frame[..., 1, 2] < -0.5)  # B points up
    assert path.position(3.0).shape == (3,) and path.frame(3.0).shape == (3, 3)
    assert np.shape(path.arc_length(points[0, 0])) == ()
