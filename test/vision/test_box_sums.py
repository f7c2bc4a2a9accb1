# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Sums over sliding windows against sums of slices."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.vision.box_sums import window_sums


@pytest.mark.parametrize('width', [1, 5, 15])
def test_every_window_is_the_sum_of_its_slice(width):
    values = np.random.default_rng(1).normal(100, 20, (3, 4, 15)).astype(np.float32)
    sums = window_sums(values, width)
    assert sums.shape == (3, 4, 16 - width)
    for k in range(sums.shape[-1]):
        wanted = values[..., k:k + width].astype(float).sum(axis=-1)
        assert sums[..., k] == pytest.approx(wanted, rel=1e-12)


def test_small_values_beside_large_ones_are_not_lost():
    values = np.full(1000, 1e7, np.float32)
    values[-3:] = 1.0
    assert window_sums(values, 3)[-1] == 3.0
