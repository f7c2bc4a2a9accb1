# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Optimal triangulation against brute force and exact points."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.baselines.hartley_sturm import fundamental, triangulate


def make_rig(turn=(0.02, -0.03, 0.01), d=()):
    rotation = cv2.Rodrigues(np.array(turn, dtype=float))[0]
    k = np.array([[1800.0, 0, 511.5], [0, 1790.0, 383.5], [0, 0, 1]])
    left = Camera('left', 1024, 768, k, np.array(d, float), 'plumb_bob')
    right = Camera('right', 1024, 768, k + np.diag([15.0, 14.0, 0]), np.array(d, float),
                   'plumb_bob')
    return StereoRig(left, right, rotation, rotation @ [-0.5, 0.01, 0.02])


def noisy(rig, std_px, count=30):
    rng = np.random.default_rng(3)
    points = rng.uniform([-2, -1.5, 15], [2, 1.5, 25], (count, 3))
    left, right, _, _ = rig.project(points)
    return (points, left + std_px * rng.standard_normal(left.shape),
            right + std_px * rng.standard_normal(right.shape))


@pytest.mark.parametrize('turn', [(0, 0, 0), (0.02, -0.03, 0.01), (0.0, -0.4, 0.0)])
def test_exact_matches_are_unchanged_and_give_their_points(turn):
    rig = make_rig(turn, (-0.2, 0.1, 1e-4, -2e-4, 0))
    points, left, right = noisy(rig, 0.0)
    np.testing.assert_allclose(triangulate(rig, left, right), points, rtol=1e-7)


@pytest.mark.parametrize('std_px', [0.5, 10.0])
def test_corrected_pixels_are_as_near_as_by_brute_force(std_px):
    rig = make_rig()
    points, left, right = noisy(rig, std_px)
    found = triangulate(rig, left, right)
    for k, point in enumerate(points):
        def residual(p, k=k):
            uv = rig.project(p[None])
            return np.concatenate([uv[0][0] - left[k], uv[1][0] - right[k]])
        best = least_squares(residual, point, xtol=1e-14, ftol=1e-14, x_scale=[0.1, 0.1, 10])
        assert np.sum(residual(found[k]) ** 2) <= 2 * best.cost * (1 + 1e-6) + 1e-9


def test_corrected_matches_satisfy_the_epipolar_constraint():
    rig = make_rig()
    _, left, right = noisy(rig, 0.0)
    one = np.ones((len(left), 1))
    rest = np.hstack([right, one]) @ fundamental(rig) * np.hstack([left, one])
    assert np.abs(rest.sum(axis=1)).max() < 1e-12


def test_pixel_without_a_ray_does_not_affect_the_others():
    rig = make_rig()
    points, left, right = noisy(rig, 0.0)
    right[3] = np.nan
    found = triangulate(rig, left, right)
    assert np.isnan(found[3]).all()
    np.testing.assert_allclose(np.delete(found, 3, 0), np.delete(points, 3, 0), rtol=1e-7)
    assert np.isnan(triangulate(rig, left, np.full_like(right, np.nan))).all()
    assert triangulate(rig, left[:0], right[:0]).shape == (0, 3)


def test_points_behind_the_rig_are_invalid():
    rig = make_rig((0, 0, 0))
    uv = np.array([[500.0, 300.0]])
    assert np.isnan(triangulate(rig, uv, uv + [20, 0])).all()  # rays that part
    assert np.isnan(triangulate(rig, uv, uv)).all()  # parallel rays
