# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Cameras against OpenCV and hand-worked cases."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.core.errors import CalibrationError
from stereo_speed.geometry.camera import Camera

K = np.array([[1500.0, 0.0, 511.5], [0.0, 1490.0, 383.5], [0.0, 0.0, 1.0]])
LENSES = {
    'ideal': ('plumb_bob', []),
    'plumb_bob': ('plumb_bob', [-0.21, 0.12, 1e-3, -7e-4, 0.03]),
    'rational': ('rational_polynomial', [0.3, -0.1, 5e-4, 2e-4, 0.02, 0.55, -0.05, 0.01]),
    'prism': ('rational_polynomial', [-0.2, 0.1, 1e-3, 1e-3, 0, 0, 0, 0, 2e-3, 1e-3, -1e-3, 2e-3]),
    'tilted': ('rational_polynomial', [-0.2, 0.1, 1e-3, 1e-3, 0, 0, 0, 0, 0, 0, 0, 0, .02, -.03]),
    'fisheye': ('equidistant', [0.03, -0.01, 0.004, -0.001]),
}


def make(model, d):
    """Return a camera with a lens."""
    return Camera(name='left', width_px=1024, height_px=768, K=K, D=d, model=model)


@pytest.mark.parametrize('lens', LENSES)
def test_projection_equals_opencv(lens):
    """Pixels equal those of cv2.projectPoints and cv2.fisheye.projectPoints."""
    model, d = LENSES[lens]
    rng = np.random.default_rng(1)
    points = rng.uniform([-3, -2, 10], [3, 2, 40], (50, 3))
    project = cv2.fisheye.projectPoints if model == 'equidistant' else cv2.projectPoints
    zero, d = np.zeros((3, 1)), np.array(d, dtype=float)
    if model == 'equidistant':
        wanted = project(points[:, None], zero, zero, K, d)[0]
    else:
        wanted = project(points, zero, zero, K, d if d.size else None)[0]
    uv, valid = make(model, d).project(points)
    np.testing.assert_allclose(uv, wanted.reshape(-1, 2), atol=1e-8)
    assert valid.all()


@pytest.mark.parametrize('lens', LENSES)
def test_undistort_inverts_distort_over_the_image(lens):
    """Every pixel of a grid over the image is recovered to 1e-7 px."""
    camera = make(*LENSES[lens])
    uv = np.stack(np.meshgrid(np.linspace(0, 1023, 23), np.linspace(0, 767, 17)), axis=-1)
    np.testing.assert_allclose(camera.distort(camera.undistort(uv)), uv, atol=1e-7)
    assert camera.rays(uv).shape == (17, 23, 3)


def test_hand_worked():
    """A point 2 m right, 1 m down at 10 m, without distortion."""
    uv, valid = make('plumb_bob', []).project(np.array([2.0, 1.0, 10.0]))
    np.testing.assert_allclose(uv, [811.5, 532.5])
    assert valid


def test_size_of_a_pixel_grows_with_the_depth():
    np.testing.assert_allclose(make('plumb_bob', []).metres_per_px(30.0), [0.02, 30 / 1490])


def test_behind_and_outside():
    """Points behind are NaN and invalid; points outside the image keep their pixel, invalid."""
    uv, valid = make('plumb_bob', []).project(
        np.array([[0.0, 0, -5], [0, 0, 0], [9, 0, 10], [0, 0, 5]]))
    assert valid.tolist() == [False, False, False, True]
    assert np.isnan(uv[:2]).all() and np.isfinite(uv[2:]).all()


def test_folded_rays_are_not_valid():
    """With strong barrel distortion a ray at 63 degrees must not project into the image."""
    camera = make('plumb_bob', [-0.3, 0.0, 0.0, 0.0])
    uv, valid = camera.project(np.array([1.82, 0.0, 1.0]))
    assert camera.inside(uv) and not valid


def test_pixels_without_a_ray_are_nan():
    """Barrel distortion has a largest radius; no ray leads to pixels beyond it."""
    camera = make('plumb_bob', [-0.5, 0.0, 0.0, 0.0])
    far = np.array([511.5 + 1500 * 0.7, 383.5])  # x (1 - x^2 / 2) peaks at 0.544
    assert np.isnan(camera.undistort(far)).all()
    assert np.isfinite(camera.undistort(np.array([511.5 + 1500 * 0.5, 383.5]))).all()


@pytest.mark.parametrize('change, what', [
    ({'K': np.zeros((3, 3))}, 'K'), ({'K': K * np.nan}, 'K'), ({'D': [0.1]}, 'D'),
    ({'D': [0.1, np.inf, 0, 0]}, 'D'), ({'model': 'brown'}, 'distortion_model'),
    ({'width_px': 0}, 'size'), ({'K': [1, 2]}, 'K')])
def test_refuses(change, what):
    """Arguments that cannot be a camera are named."""
    good = {'name': 'left', 'width_px': 1024, 'height_px': 768, 'K': K, 'D': [],
            'model': 'plumb_bob'}
    with pytest.raises(CalibrationError, match=f'left: {what}: found .* wanted'):
        Camera(**{**good, **change})
