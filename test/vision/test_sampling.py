# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Crops and samples of images, by hand and against OpenCV's warp."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.vision.haar import PartGrid
from stereo_speed.vision.sampling import crop, low_pass_crop, quad_grid, sample_quads

GRID = PartGrid()
IMAGE = np.arange(12 * 20, dtype=np.uint8).reshape(12, 20)


@pytest.mark.parametrize('low, high, margin, columns, rows', [
    ((5.4, 4.0), (8.2, 6.0), 1, (4, 11), (3, 8)),
    ((0.5, 0.5), (2.0, 2.0), 3, (0, 6), (0, 6)),  # cut off at the border
    ((90.0, 90.0), (95.0, 95.0), 0, (18, 20), (10, 12)),  # outside: the nearest 2 x 2 pixels
])
def test_crop_contains_the_points_and_their_margin(low, high, margin, columns, rows):
    part, origin = crop(IMAGE, np.array(low), np.array(high), margin)
    np.testing.assert_array_equal(part, IMAGE[slice(*rows), slice(*columns)])
    assert origin.tolist() == [columns[0], rows[0]]


def test_low_pass_removes_only_what_would_alias():
    rng = np.random.default_rng(0)
    noise = rng.normal(100, 20, (80, 80))
    fine, _ = low_pass_crop(noise, np.full(2, 30.0), np.full(2, 50.0), 1.0)
    np.testing.assert_array_equal(fine, noise[26:55, 26:55].astype(np.float32))
    coarse, origin = low_pass_crop(noise, np.full(2, 30.0), np.full(2, 50.0), 5.0)
    # White noise after a Gaussian of s = 2 px has the variance 1 / (4 pi s^2).
    inner = coarse[6:-6, 6:-6]
    assert origin.tolist() == [20.0, 20.0]
    assert inner.std() == pytest.approx(20 / np.sqrt(4 * np.pi * 4), rel=0.35)


def test_quad_grid_equals_opencvs_perspective_transform():
    rng = np.random.default_rng(0)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    quads = (100 * square + rng.uniform(-15, 15, (20, 4, 2))).astype(np.float32)
    unit = rng.uniform(0, 1, (30, 2))
    got = quad_grid(quads.astype(float), unit)
    for quad, mapped in zip(quads, got.swapaxes(0, 1)):
        H = cv2.getPerspectiveTransform(square, quad)
        want = cv2.perspectiveTransform(unit[None].astype(np.float64), H)[0]
        np.testing.assert_allclose(mapped.T, want, atol=1e-3)


def test_samples_equal_opencvs_perspective_warp():
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.uniform(0, 255, (120, 160)).astype(np.float32), (0, 0), 2)
    rows, cols = GRID.shape
    quad = np.array([[30.2, 40.1], [68.7, 42.0], [69.9, 57.5], [31.0, 58.3]], np.float32)
    corners = np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]], np.float32) - 0.5
    H = cv2.getPerspectiveTransform(corners, quad)
    want = cv2.warpPerspective(image, H, (cols, rows), flags=cv2.INTER_LINEAR | 16)
    got = sample_quads(image, quad[None].astype(float), GRID).reshape(rows, cols)
    # Both quantise positions to 1/32 px.
    assert np.abs(got - want).max() < 0.04 * np.ptp(image)
    assert np.abs(got - want).mean() < 0.005 * np.ptp(image)


def test_many_quads_are_sampled_like_single_ones():
    image = cv2.GaussianBlur(
        np.random.default_rng(1).uniform(0, 255, (90, 120)).astype(np.float32), (0, 0), 2)
    quad = np.array([[20.0, 20], [60, 21], [61, 40], [19, 39]])
    quads = quad + np.random.default_rng(2).uniform(-5, 20, (150, 1, 2))
    together = sample_quads(image, quads, GRID)
    for k in (0, 70, 149):
        np.testing.assert_allclose(together[k], sample_quads(image, quads[k:k + 1], GRID)[0],
                                   atol=0.06 * np.ptp(image))
