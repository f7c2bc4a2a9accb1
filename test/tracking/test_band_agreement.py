# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""How well bands of a front agree: by hand, and against closed forms."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.tracking.band_agreement import (
    all_but_one, BANDS, error_scale, jackknife_variance, PartSpeed)


@pytest.mark.parametrize('grid_shape', [(16, 40), (8, 20), (12, 32), (10, 3)])
def test_each_sample_is_left_out_once_with_its_row(grid_shape):
    rows, columns = grid_shape
    left_out = ~np.array(all_but_one(grid_shape))
    assert left_out.shape == (BANDS, rows * columns) and (left_out.sum(axis=0) == 1).all()
    band = left_out.argmax(axis=0).reshape(grid_shape)
    assert (band == band[:, :1]).all() and (np.diff(band[:, 0]) >= 0).all()
    sizes = left_out.sum(axis=1)
    assert np.ptp(sizes) <= columns


def test_jackknife_of_a_mean_is_its_standard_error():
    """The closed form: the sample variance over n."""
    values = np.random.default_rng(3).normal(20.0, 2.0, 9)
    without_each = (values.sum() - values) / 8
    assert jackknife_variance(without_each) == pytest.approx(np.var(values, ddof=1) / 9)


def speeds_of(means, variance):
    return [PartSpeed(mean, variance) for mean in means]


def test_scale_by_hand():
    """Speeds of 20 +- 0.1 have a jackknife variance of 3 x 0.01."""
    means = [19.9, 20.1, 19.9, 20.1]
    # the fit explains 0.01 of it
    assert error_scale(0.01, speeds_of(means, 0.01), 0.5) == pytest.approx(1 + 0.5 * 2)
    assert error_scale(0.01, speeds_of(means, 0.01), 1.0) == pytest.approx(3)
    assert error_scale(0.01, speeds_of(means, 0.01), 0.0) == 1
    # Without a band that has half of what there is to see, the variance is twice that: by 0.01
    # more for two of them, which explains 3 / 4 x 0.02.
    halves = [PartSpeed(*pair) for pair in zip(means, [0.02, 0.02, 0.01, 0.01])]
    assert error_scale(0.01, halves, 1.0) == pytest.approx(1 + 1.5)
    # bands that agree prove nothing
    assert error_scale(0.01, speeds_of([20.0] * 4, 0.01), 0.5) == 1


def test_jackknife_of_independent_bands_is_what_the_fit_explains():
    """Speeds are means of bands of variance 4; a mean of three of them varies by 4 / 3."""
    bands = np.random.default_rng(5).normal(0.0, 2.0, (4000, BANDS))
    without_each = (bands.sum(axis=1, keepdims=True) - bands) / (BANDS - 1)
    mean = np.mean([jackknife_variance(means) for means in without_each])
    # chi-squared with 3 degrees of freedom
    assert mean == pytest.approx(4 / BANDS, abs=4 * np.sqrt(2 / 3 / 4000))
    # Of a jackknife variance of 1, the fit explains all, and nothing beyond it.
    spread = np.array([-1, 1, -1, 1]) / np.sqrt(3)
    for factor, scale in ((1.0, 1.0), (2.0, 4.0), (0.5, 1.0)):
        means = 20.0 + factor * spread
        assert error_scale(4 / BANDS, speeds_of(means, 4 / 3), 1.0) == pytest.approx(scale)
