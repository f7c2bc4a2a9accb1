# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Cross-sections rendered with exact pixel coverage are recovered."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from stereo_speed.site.refine.section_model import BAND, detect, EDGE, fit_sections, Shape, tuned

PX_PER_M = 40.0


def sections(kind, places_m, rng, *, width_m=0.15, sides=(80.0, 80.0), paint=180.0, noise=0.0,
             blur_px=0.6):
    """Return (n, k) cross-sections of blurred edges averaged over pixels, sampled at 0.5 px."""
    x = np.tile(np.arange(-24, 25) * 0.5 / PX_PER_M, (len(places_m), 1))
    fine = np.linspace(-0.5, 0.5, 41) / PX_PER_M  # the pixel's width
    z = x[..., None] + fine - np.asarray(places_m)[:, None, None]
    blur = blur_px / PX_PER_M
    right, left = sides  # x grows to the left
    if kind == EDGE:
        grey = right + (left - right) * ndtr(z / blur)
    else:
        grey = right + (paint - right) * ndtr((z + width_m / 2) / blur) \
            + (left - paint) * ndtr((z - width_m / 2) / blur)
    return x, grey.mean(axis=-1) + noise * rng.standard_normal(x.shape)


@pytest.mark.parametrize('kind, sides, sign', [
    (BAND, (80.0, 80.0), 1), (BAND, (80.0, 95.0), 1), (BAND, (200.0, 215.0), -1),
    (EDGE, (60.0, 90.0), 1), (EDGE, (90.0, 60.0), -1)],
    ids=['band', 'band between two greys', 'dark band', 'edge', 'falling edge'])
def test_places_without_noise(kind, sides, sign):
    """The middle is right to a hundredth of a pixel at any phase; uneven sides cost little."""
    places = np.linspace(-0.02, 0.02, 17)
    x, grey = sections(kind, places, np.random.default_rng(0), sides=sides,
                       paint=120.0 if sign < 0 else 180.0)
    shape = Shape(kind, 0.15 if kind == BAND else 0.0, 0.66, sign)
    found = fit_sections(shape, x, grey, np.full(17, PX_PER_M), np.zeros(17), 1.0)
    assert np.abs(found.across_m - places).max() * PX_PER_M < 0.012
    assert (found.contrast > 20).all()


@pytest.mark.parametrize('width_m', [0.15, 0.04], ids=['wide', 'thinner than two pixels'])
def test_claimed_scatter_is_the_scatter(width_m):
    rng = np.random.default_rng(1)
    places = rng.uniform(-0.01, 0.01, 400)
    x, grey = sections(BAND, places, rng, width_m=width_m, noise=3.0)
    found = fit_sections(Shape(BAND, width_m, 0.66, 1), x, grey, np.full(400, PX_PER_M),
                         np.zeros(400), 3.0)
    score = (found.across_m - places) / found.std_m
    assert 0.85 < score.std() < 1.15 and abs(score.mean()) < 0.15


@pytest.mark.parametrize('width_px', [0.3, 0.5, 1.0])
def test_edge_near_a_narrow_band_is_in_the_uncertainty(width_px):
    """
    A grass edge anywhere within the samples displaces a band by about the claimed error.

    Its height is a tenth of the band's brightness: the claim is to first order.
    """
    apart_px = np.linspace(0, 4, 41)
    scale, start = np.full(len(apart_px), PX_PER_M), np.zeros(len(apart_px))
    x, grey = sections(BAND, start, np.random.default_rng(5), width_m=width_px / PX_PER_M)
    x, beyond = sections(EDGE, (width_px / 2 + apart_px) / PX_PER_M, np.random.default_rng(5),
                         sides=(0.0, 10.0))
    shape = Shape(BAND, width_px / PX_PER_M, 0.66, 1)
    found = fit_sections(shape, x, grey + beyond, scale, start, 1.0)
    claimed_px = found.uneven * shape.displaced_px(scale)
    off_px = found.across_m * PX_PER_M
    assert 0.5 < np.sqrt(np.mean(np.square(off_px)) / np.mean(np.square(claimed_px))) < 2
    even = fit_sections(shape, x, grey, scale, start, 1.0)
    assert np.max(even.uneven * shape.displaced_px(scale)) < 1e-3


def test_width_and_blur_are_found():
    rng = np.random.default_rng(2)
    x, grey = sections(BAND, rng.uniform(-0.01, 0.01, 40), rng, width_m=0.12, noise=1.0)
    shape = tuned(Shape(BAND, 0.15, 0.9, 1), x, grey, np.full(40, PX_PER_M), np.zeros(40), 1.0)
    assert shape.width_m == pytest.approx(0.12, abs=0.003)
    # the pixel adds to the blur of the lens: 0.6 and 0.29 px
    assert shape.blur_px == pytest.approx(np.hypot(0.6, 0.29), abs=0.06)


def test_edge_is_no_band():
    """The model determines what a cross-section shows, and an edge shows no band."""
    rng = np.random.default_rng(3)
    scale = np.full(1, PX_PER_M)
    for kind, width in ((BAND, 0.15), (EDGE, 0.0)):
        x, grey = sections(kind, [0.03], rng, sides=(80.0, 80.0 if kind == BAND else 160.0))
        light, dark = detect(x, grey, scale, width)
        assert x[0, np.argmax(light)] == pytest.approx(0.03, abs=0.6 / PX_PER_M)
        assert light.max() > 70 and dark[0, np.argmax(light)] < 0
        if kind == EDGE:
            assert detect(x, grey, scale, 0.15)[0].max() < 5
