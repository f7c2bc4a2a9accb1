# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Blur of light in images that encode it, by hand and against OpenCV."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.vision.encoding import blurred, light_blurred

RNG = np.random.default_rng(3)
EDGE = np.repeat(np.array([[0.0] * 20 + [200.0] * 20], np.float32), 30, axis=0)
SIGMA = [1.0, 1.5]


def test_middle_of_a_blurred_edge_has_half_the_light():
    """By hand: half the light of 200 is 200 (1/2)^(1/2.2) = 145.9, not 100."""
    image = np.repeat(np.array([[0.0] * 20 + [200.0] * 21], np.float32), 30, axis=0)
    image[:, 20] = 200 * 0.5 ** (1 / 2.2)
    found = light_blurred(image, [1.0, 2.0], 2.2)
    assert found[15, 20] == pytest.approx(145.9, abs=0.1)
    assert blurred(EDGE, [1.0, 2.0])[15, 19:21].mean() == pytest.approx(100.0, abs=0.1)


@pytest.mark.parametrize('white', [255, 4095, 65535])
def test_blur_of_light_is_that_of_opencv(white):
    image = np.asarray(white * RNG.uniform(0, 1, (30, 40)), np.float32)
    light = cv2.GaussianBlur((image / white).astype(np.float64) ** 2.2, (11, 7), sigmaX=1.5,
                             sigmaY=1.0, borderType=cv2.BORDER_REPLICATE)
    found = light_blurred(image, SIGMA, 2.2)
    np.testing.assert_allclose(found, white * light ** (1 / 2.2), atol=1e-4 * white)
    assert found.dtype == np.float32


def test_cameras_that_write_light_need_no_conversion():
    image = np.asarray(RNG.uniform(0, 255, (30, 40)), np.float32)
    np.testing.assert_array_equal(light_blurred(image, SIGMA, 1.0), blurred(image, SIGMA))


@pytest.mark.parametrize('gamma', [1.0, 2.2, 4.0])
def test_even_grey_stays_as_it_is(gamma):
    """From black to full scale."""
    for grey in (0.0, 1.0, 128.0, 255.0):
        image = np.full((20, 20), grey, np.float32)
        np.testing.assert_allclose(
            light_blurred(image, SIGMA, gamma), image, rtol=1e-4, atol=1e-3)
