# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Histograms and outline gradients of quadrilaterals."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import stats

from stereo_speed.lab.baselines.cues import (
    bhattacharyya, BINS, histograms, outline_gradient)
from stereo_speed.vision.haar import PartGrid

QUAD = np.array([[40.0, 30], [79, 30], [79, 59], [40, 59]])


@pytest.fixture(scope='module')
def box():
    """Draw a dark box on a bright ground."""
    image = np.full((100, 120), 200, np.uint8)
    image[30:60, 40:80] = 40
    return image


def test_histogram_by_hand(box):
    found = histograms(box, np.stack([QUAD, QUAD - [40, 30]]), PartGrid(10, 4))
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    assert found[0, 40 * BINS // 256] == pytest.approx(1.0)
    assert found[1, 200 * BINS // 256] == pytest.approx(1.0)
    assert bhattacharyya(found, found[0]) == pytest.approx([1.0, 0.0])


def test_outline_weighs_less_than_the_middle(box):
    half = QUAD + [20.0, 0]  # its left half lies in the box: by symmetry each counts the same
    wide = QUAD + np.array([[-10.0, -8], [10, -8], [10, 8], [-10, 8]])
    dark, bright = (histograms(box, np.stack([half, wide]), PartGrid(10, 4))[:, k * BINS // 256]
                    for k in (40, 200))
    assert dark[0] == pytest.approx(bright[0], abs=0.01)
    share = 40 * 30 / (60 * 46)  # of the area that is dark
    assert dark[1] / (dark[1] + bright[1]) > share + 0.05


def test_white_is_in_the_last_bin():
    found = histograms(np.full((60, 60), 255, np.uint8), QUAD[None] / 2, PartGrid(10, 4))
    assert found[0, -1] == pytest.approx(1.0)


def test_gradient_is_strongest_on_the_outline(box):
    shifts = np.arange(-6, 7)
    quads = QUAD - 0.5 + shifts[:, None, None] * np.array([1.0, 0.0])
    quads[:, 1:3] += 1.0  # the edge lies half a pixel outside the outermost centres
    found = outline_gradient(box, quads)
    assert shifts[np.argmax(found)] == 0 and found.max() > 3 * found[0] / 2
    assert outline_gradient(box, QUAD[None] * 0.2 + 2).max() < 1e-3


def test_coefficient_by_hand():
    p, q, r = np.array([[0.5, 0.5, 0, 0], [0.5, 0, 0.5, 0], [0, 0, 0, 1.0]])
    assert bhattacharyya(p, p) == pytest.approx(1)
    assert bhattacharyya(p, q) == pytest.approx(0.5)
    assert bhattacharyya(p, r) == 0
    np.testing.assert_allclose(bhattacharyya(np.stack([p, q, r]), p), [1, 0.5, 0])
    assert bhattacharyya(np.array([0.8, 0.2]), np.array([0.2, 0.8])) == pytest.approx(0.8)


def test_coefficient_is_one_minus_opencvs_squared_distance():
    rng = np.random.default_rng(0)
    first, second = rng.dirichlet(np.full(32, 0.3), (2, 40))
    distance = [cv2.compareHist(p.astype(np.float32), q.astype(np.float32),
                                cv2.HISTCMP_BHATTACHARYYA) for p, q in zip(first, second)]
    np.testing.assert_allclose(bhattacharyya(first, second), 1 - np.square(distance), atol=1e-5)


def test_coefficient_of_two_gaussians():
    """With equal widths it is exp(-gap^2 / 8 std^2)."""
    edges = np.linspace(-12, 15, 2000)
    p, q = (np.diff(stats.norm(mean, 1.5).cdf(edges)) for mean in (0.0, 2.0))
    assert bhattacharyya(p, q) == pytest.approx(np.exp(-2.0 ** 2 / (8 * 1.5 ** 2)), abs=1e-5)
