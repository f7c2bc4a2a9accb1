# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The Bhattacharyya coefficient by hand, against OpenCV and in its closed form for Gaussians."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import stats

from stereo_speed.vision.histograms import bhattacharyya


def test_coefficient_by_hand():
    p, q, r = np.array([[0.5, 0.5, 0, 0], [0.5, 0, 0.5, 0], [0, 0, 0, 1.0]])
    assert bhattacharyya(p, p) == pytest.approx(1)
    assert bhattacharyya(p, q) == pytest.approx(0.5)
    assert bhattacharyya(p, r) == 0
    np.testing.assert_allclose(bhattacharyya(np.stack([p, q, r]), p), [1, 0.5, 0])
    assert bhattacharyya(np.array([0.8, 0.2]), np.array([0.2, 0.8])) == pytest.approx(0.8)


def test_coefficient_is_one_minus_the_squared_distance_of_opencv():
    rng = np.random.default_rng(0)
    first, second = rng.dirichlet(np.full(32, 0.3), (2, 40))
    distance = [cv2.compareHist(p.astype(np.float32), q.astype(np.float32),
                                cv2.HISTCMP_BHATTACHARYYA) for p, q in zip(first, second)]
    np.testing.assert_allclose(bhattacharyya(first, second), 1 - np.square(distance), atol=1e-5)


def test_coefficient_of_two_gaussians():
    """Of equal width, it is exp(-gap^2 / 8 std^2)."""
    edges = np.linspace(-12, 15, 2000)
    p, q = (np.diff(stats.norm(mean, 1.5).cdf(edges)) for mean in (0.0, 2.0))
    assert bhattacharyya(p, q) == pytest.approx(np.exp(-2.0 ** 2 / (8 * 1.5 ** 2)), abs=1e-5)
