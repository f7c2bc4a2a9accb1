# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Batched correlations against brute force."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.detection.patch_kernels import (
    cut, mirrored, plain_correlate as correlate, plain_level)
from stereo_speed.detection.patches import level_rows, slide


@pytest.fixture
def patches():
    return np.random.default_rng(3).normal(100, 20, (3, 4, 15)).astype(np.float32)


def test_correlation_equals_numpy(patches):
    other = patches + np.random.default_rng(4).normal(0, 10, patches.shape).astype(np.float32)
    a, b = (v - v.mean(axis=(1, 2), keepdims=True) for v in (patches, other))
    wanted = [np.corrcoef(p.ravel(), q.ravel())[0, 1] for p, q in zip(patches, other)]
    assert correlate(a, b) == pytest.approx(wanted, abs=1e-5)


def test_patches_without_contrast_do_not_correlate():
    faint = 0.1 * np.random.default_rng(5).standard_normal((1, 4, 9)).astype(np.float32)
    assert correlate(faint, faint)[0] < 0.05


def test_sliding_equals_correlating_each_window(patches):
    patch = patches[0, :, 3:10]
    scores = slide(patch, patches)
    assert scores.shape == (3, 9)
    for n in range(3):
        for k in range(9):
            wanted = np.corrcoef(patch.ravel(), patches[n, :, k:k + 7].ravel())[0, 1]
            assert scores[n, k] == pytest.approx(wanted, abs=1e-5)
    assert scores[0, 3] == pytest.approx(1.0, abs=1e-5)


def test_mirrored_equals_the_product_with_the_flipped_window(patches):
    found, most = mirrored(patches, 7)
    for n in range(3):
        for k in range(9):
            window = level_rows(patches[n:n + 1, :, k:k + 7].astype(np.float64))[0]
            assert found[n, k] == pytest.approx((window * window[:, ::-1]).sum(), rel=1e-3, abs=5)
            assert most[n, k] == pytest.approx((window ** 2).sum(), rel=1e-3)


def test_symmetric_window_reaches_the_maximum():
    half = np.random.default_rng(6).normal(0, 10, (1, 3, 4)).astype(np.float32)
    found, most = mirrored(np.concatenate([half, half[..., ::-1][..., 1:]], axis=2), 7)
    assert found[0, 0] == pytest.approx(most[0, 0], rel=1e-5)


def test_masked_columns_do_not_count(patches):
    mask = np.zeros((3, 15), bool)
    mask[:, 4:11] = True
    levelled = plain_level(patches, mask)
    assert not levelled[..., ~mask[0]].any()
    assert levelled[..., 4:11] == pytest.approx(level_rows(patches[..., 4:11]), abs=1e-3)


def test_columns_are_cut_out_patch_by_patch(patches):
    pieces = cut(patches, np.array([0, 4, 8]), 6)
    assert np.array_equal(pieces[1], patches[1, :, 4:10])
