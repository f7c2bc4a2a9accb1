# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Robust scale."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import median_abs_deviation
from stereo_speed.estimation.robust import robust_std


def test_normal_deviations_have_their_std():
    """Of 40000, within four standard errors: 1.17 / sqrt(n) of it."""
    off = np.random.default_rng(0).normal(0, 3.0, 40000)
    assert robust_std(off) == pytest.approx(3.0, rel=4 * 1.17 / 200)
    assert robust_std(off) == pytest.approx(
        median_abs_deviation(off, scale='normal', center=lambda x, axis: 0.0), rel=1e-4)


def test_a_third_of_outliers_has_little_influence():
    off = np.random.default_rng(1).normal(0, 1.0, 3000)
    off[:1000] = 1e6
    assert robust_std(off) < 2.0
