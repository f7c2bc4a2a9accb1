# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The difference of the blur of two views, from their spectra."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.vision.relative_blur import equally_sharp, relative_blur

HEIGHT, WIDTH, APART = 400, 640, 60


def scene(rng, sharpness=1.0):
    """Return a wide scene whose details have all sizes, as those of streets have."""
    shape = HEIGHT, WIDTH + APART
    f = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    f[0, 0] = np.inf
    waves = np.fft.rfft2(rng.normal(size=shape)) / f ** sharpness
    values = np.fft.irfft2(waves, shape)
    return 110 + 30 * values / values.std()


def seen(image, rng, blur_px=0.0, noise=1.0):
    """Return what a camera shows of an image."""
    if blur_px:
        image = cv2.GaussianBlur(image, (0, 0), blur_px)
    return np.clip(np.round(image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)


def views(seed, blurs_px, **how):
    """Return two views of a scene from places apart, each with a blur."""
    rng = np.random.default_rng(seed)
    wide = scene(rng)
    return [seen(wide[:, at:at + WIDTH], rng, blur_px, **how)
            for at, blur_px in zip((0, APART), blurs_px)]


@pytest.mark.parametrize('blurs_px', [(0, 0), (0, 0.7), (0, 1.5), (2.5, 0), (1.0, 2.0)])
@pytest.mark.parametrize('seed', [1, 2])
def test_difference_of_squares_is_found(seed, blurs_px):
    found = relative_blur(*views(seed, blurs_px))
    first, second = blurs_px
    assert found.px2 == pytest.approx(second ** 2 - first ** 2, rel=0.1, abs=0.1)
    assert found.std_px2 < 0.3


def test_views_in_the_other_order_have_the_opposite_difference():
    first, second = views(3, (0, 1.5))
    assert relative_blur(second, first).px2 == pytest.approx(-relative_blur(first, second).px2)


def test_contrast_exposure_and_bits_do_not_matter():
    first, second = views(4, (0, 1.2), noise=0.0)
    as_seen = relative_blur(first, second).px2
    darker = 0.5 * second.astype(float) + 20
    assert relative_blur(first, darker).px2 == pytest.approx(as_seen)
    many_bits = [view.astype(np.uint16) * 256 for view in (first, second)]
    assert relative_blur(*many_bits).px2 == pytest.approx(as_seen)


def test_noise_of_one_camera_is_no_sharpness():
    rng = np.random.default_rng(5)
    first, second = views(5, (0, 0))
    noisy = np.clip(first + rng.normal(0, 6.0, first.shape), 0, 255)
    assert relative_blur(noisy, second).px2 == pytest.approx(0.0, abs=0.15)


def test_scale_of_a_nearer_view_is_no_blur():
    """The details of a scene that is nearer are larger, in a ratio that no line in f^2 has."""
    first, second = views(6, (0, 0))
    nearer = cv2.resize(second, None, fx=1.1, fy=1.1)[:HEIGHT, :WIDTH]
    assert abs(relative_blur(first, nearer).px2) < 0.3


@pytest.mark.parametrize('view', [
    np.full((HEIGHT, WIDTH), 90, np.uint8),
    np.random.default_rng(7).normal(90, 2, (HEIGHT, WIDTH)).astype(np.uint8),
    np.random.default_rng(8).integers(0, 255, (100, WIDTH)).astype(np.uint8),
], ids=['blank', 'noise only', 'too small'])
def test_views_without_details_tell_nothing(view):
    assert relative_blur(view, view) is None


@pytest.mark.parametrize('blurs_px', [(0, 1.5), (1.5, 0)])
def test_equally_sharp_views_differ_in_noise_only(blurs_px):
    rng = np.random.default_rng(9)
    wide = scene(rng)[:, :WIDTH]
    first, second = (seen(wide, rng, blur_px, 0.0) for blur_px in blurs_px)
    same = equally_sharp(first, second, blurs_px[1] ** 2 - blurs_px[0] ** 2)
    assert np.abs(first.astype(float) - second).std() > 3.0
    assert np.abs(same[0].astype(float) - same[1]).std() < 0.5


def test_hardly_different_views_stay_as_they_are():
    first, second = views(10, (0, 0))
    same = equally_sharp(first, second, 0.3)
    assert same[0] is first and same[1] is second
