# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Lens models: their invariants, and closed forms."""
from __future__ import annotations

import math

import numpy as np
import pytest
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.distortion import LENSES, PlumbBob, RationalPolynomial

COEFFICIENTS = {
    'plumb_bob': [-0.21, 0.12, 1e-3, -7e-4, 0.03],
    'rational_polynomial': [0.3, -0.1, 5e-4, 2e-4, 0.02, 0.55, -0.05, 0.01],
    'equidistant': [0.03, -0.01, 0.004, -0.001]}


@pytest.mark.parametrize('name', LENSES)
def test_every_model_keeps_the_protocol(name):
    """Missing coefficients are zeros, the axis is fixed, and the inverse is an inverse."""
    lens = LENSES[name](np.array(COEFFICIENTS[name]))
    assert lens.coefficients.shape == (lens.size,) and not lens.ideal
    assert max(lens.sizes) <= lens.size and 0 in lens.sizes
    xy = np.random.default_rng(0).uniform(-0.4, 0.4, (50, 3, 2))
    there = lens.distort(xy)
    assert there.shape == xy.shape and lens.limit > 0.5
    np.testing.assert_allclose(lens.undistort(there), xy, atol=1e-9)
    np.testing.assert_allclose(lens.distort(np.zeros(2)), 0, atol=1e-12)


def test_limit_of_barrel_distortion():
    """With k1 alone x (1 + k1 x^2) is greatest at 1 / sqrt(-3 k1)."""
    for k1 in (-0.3, -0.05):
        limit = PlumbBob(np.array([k1, 0.0, 0.0, 0.0])).limit
        assert limit == pytest.approx(1 / math.sqrt(-3 * k1), rel=5e-3)
    assert PlumbBob(np.array([0.1, 0.0, 0.0, 0.0])).limit == math.inf


def test_equidistant_without_coefficients_is_the_angle():
    lens = LENSES['equidistant'](np.zeros(0))
    x = np.array([0.0, 0.5, 1.0, 3.0])
    np.testing.assert_allclose(lens.distort(np.stack([x, 0 * x], -1))[:, 0], np.arctan(x))
    np.testing.assert_allclose(lens.undistort(np.array([math.pi / 4, 0.0])), [1.0, 0.0], atol=1e-9)
    assert not lens.ideal


def test_without_coefficients_a_polynomial_lens_changes_nothing():
    lens, xy = RationalPolynomial(np.zeros(0)), np.array([[1e9, -3.0], [np.nan, 0.0]])
    assert lens.ideal and lens.limit == math.inf
    assert lens.distort(xy) is xy and lens.undistort(xy) is xy


def test_rational_polynomial_includes_plumb_bob():
    xy = np.random.default_rng(1).uniform(-0.5, 0.5, (20, 2))
    d = np.array(COEFFICIENTS['plumb_bob'])
    np.testing.assert_array_equal(PlumbBob(d).distort(xy), RationalPolynomial(d).distort(xy))


def test_camera_takes_its_lens_by_name():
    k = np.array([[900.0, 0, 320], [0, 900, 240], [0, 0, 1]])
    for name, d in COEFFICIENTS.items():
        camera = Camera('left', 640, 480, k, d, name)
        assert type(camera.lens) is LENSES[name]
        np.testing.assert_allclose(camera.distort(np.array([0.1, 0.2])),
                                   [900, 900] * camera.lens.distort(np.array([0.1, 0.2]))
                                   + [320, 240])
