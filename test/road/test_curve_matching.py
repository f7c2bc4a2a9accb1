# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Image curves matched along epipolar lines."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.reference.curved_path import depth_std_m
from stereo_speed.road.curve_matching import image_spline, match_curves

K = np.array([[1500.0, 0.0, 511.5], [0.0, 1500.0, 383.5], [0.0, 0.0, 1.0]])


def make_rig():
    """Return a parallel rig."""
    camera = Camera(name='c', width_px=1024, height_px=768, K=K, D=(), model='plumb_bob')
    return StereoRig(camera, camera, np.eye(3), np.array([-0.5, 0, 0]))


def circle(a):
    """Return points of a circle of 60 m that approaches and descends."""
    return np.stack([-6 + 60 * (1 - np.cos(a)), 1 + 4 * a, 60 - 60 * np.sin(a)], axis=-1)


def test_exact_picks_give_the_points():
    """Matches of exact picks are the points of the curve, to a hundredth of a pixel."""
    rig, wanted = make_rig(), circle(np.linspace(0.0, 0.6, 40))
    exact = rig.project(circle(np.linspace(-0.05, 0.65, 400)))[1]
    found = match_curves(rig, rig.project(wanted)[0], exact)
    a_pixel_m = wanted[:, 2]**2 / (1500 * 0.5)
    assert np.all(np.abs(found.points_m - wanted)[:, 2] < 0.01 * a_pixel_m)
    assert np.all((found.sine > 0) & (found.sine <= 1))


def test_errors_of_matches_depend_on_the_sine_of_the_crossing():
    """Depth errors of noisy picks have the 1-sigma that follows from the crossing's sine."""
    rig, rng, true = make_rig(), np.random.default_rng(6), circle(np.linspace(0.0, 0.6, 200))
    left = rig.project(true)[0]
    exact = rig.project(circle(np.linspace(-0.05, 0.65, 400)))[1]
    scores = []
    for _ in range(20):
        found = match_curves(rig, left + rng.normal(0, 0.2, left.shape), exact)
        assert len(found.points_m) == len(true)
        scores.append((found.points_m - true)[:, 2] / depth_std_m(found, rig, 0.2))
    # chi-square of 4000 scores: 1 +- 0.011, and what the linearisation leaves out
    assert np.std(np.concatenate(scores)) == pytest.approx(1.0, abs=0.05)


def test_selected_places_of_the_left_curve_can_be_matched():
    rig = make_rig()
    views = [rig.project(circle(np.linspace(0.0, 0.6, n)))[i] for i, n in ((0, 20), (1, 25))]
    at = image_spline(views[0])(np.linspace(0.1, 0.9, 7))
    found = match_curves(rig, *views, at)
    np.testing.assert_allclose(found.left_px, at)
    np.testing.assert_allclose(rig.left.project(found.points_m)[0], at, atol=2e-3)


def test_lines_along_epipolar_lines_do_not_match():
    """A level line under a level baseline hardly crosses its epipolar lines."""
    flat = np.stack([np.linspace(100, 900, 10), np.full(10, 400.0)], axis=-1)
    assert len(match_curves(make_rig(), flat, flat - [10, 0]).points_m) == 0
