# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Interpolation of images between pixels."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.vision.spline_image import SplineImage


def test_pixels_are_kept_and_outside_is_nan():
    """All except those on the edge, where a spline knows only one side."""
    image = np.random.default_rng(0).uniform(0, 255, (9, 12))
    v, u = np.indices(image.shape)
    read = SplineImage(image, np.float64)(np.stack([u, v], axis=-1))
    np.testing.assert_allclose(read[1:-1, 1:-1], image[1:-1, 1:-1], atol=1e-9)
    assert np.isfinite(read).all()
    outside = np.array([[-0.1, 4.0], [11.1, 4.0], [3.0, -1.0], [3.0, 8.5], [np.nan, 2.0]])
    assert np.isnan(SplineImage(image)(outside)).all()


@pytest.mark.parametrize('dtype, limit', [(np.float32, 1e-3), (np.float64, 1e-7)])
def test_smooth_images_are_interpolated_accurately(dtype, limit):
    """Waves of 40 and 50 px, in the middle of an image: as good as a cubic spline."""
    v, u = np.indices((80, 100))

    def wave(at_u, at_v):
        return 100 + 50 * np.sin(2 * np.pi * at_u / 40) * np.cos(2 * np.pi * at_v / 50)
    at = np.random.default_rng(1).uniform([30, 30], [70, 50], (200, 2))
    off = SplineImage(wave(u, v), dtype)(at) - wave(at[:, 0], at[:, 1])
    step = 2 * np.pi / 40  # the spline's error is about f'''' h^4 / 384 for each axis
    assert np.abs(off).max() < limit + 2 * 50 * step**4 / 100
