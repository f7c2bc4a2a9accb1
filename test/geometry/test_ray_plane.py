# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Intersections of rays and planes."""
from __future__ import annotations

import numpy as np
from stereo_speed.geometry.ray_plane import back_project


def test_rays_that_miss_are_nan():
    """Parallel to the plane, or meeting it behind the camera."""
    rays = np.array([[0.0, 0, 1], [0, -0.1, 1], [0, 0.1, 1]])
    points = back_project(rays, np.array([0.0, 1, 0]), 2.0)  # the road 2 m below
    assert np.isnan(points[:2]).all()
    np.testing.assert_allclose(points[2], [0, 2, 20])


def test_points_are_on_plane_and_ray():
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(5, 1, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    rays = np.concatenate([rng.uniform(-0.3, 0.3, (5, 7, 2)), np.ones((5, 7, 1))], axis=-1)
    points = back_project(rays, normals, np.full((5, 1), 3.0))
    met = np.isfinite(points).all(axis=-1)
    assert met.any() and not met.all()
    np.testing.assert_allclose(np.sum(points * normals, axis=-1)[met], 3.0)
    np.testing.assert_allclose((points / points[..., 2:])[met], rays[met])
    assert (points[met][:, 2] > 0).all()
