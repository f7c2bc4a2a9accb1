# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The detector's compiled kernels against plain numpy."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.detection import patch_kernels as kernels

pytest.importorskip('numba')
ROWS, HALF = 9, 20


@pytest.fixture(scope='module')
def both():
    rng = np.random.default_rng(3)
    half = rng.uniform(0, 255, (3, 2 * ROWS, HALF + 8))
    whole = np.concatenate([half, half[..., ::-1]], axis=2) + rng.normal(0, 9, (3, 2 * ROWS, 56))
    whole[2] = 7.0  # nothing to see
    return whole.astype(np.float32)


@pytest.fixture(scope='module')
def mask():
    columns = np.abs(np.arange(-HALF, HALF + 1))
    return columns <= np.array([[20], [9], [0]])


def agree(one, *args, rtol=1e-5, atol=1e-5):
    got, wanted = one.compiled()(*args), one.plain(*args)
    if not isinstance(got, tuple):
        got, wanted = (got,), (wanted,)
    assert len(got) == len(wanted)
    for a, b in zip(got, wanted):
        np.testing.assert_allclose(a, b, rtol=rtol, atol=atol)


def test_shifted_windows(both, mask):
    start = np.array([5, 8, 6])
    agree(kernels.shifted, both[:, :ROWS], both[:, ROWS:], start, mask, 4)


def test_symmetry(both, mask):
    agree(kernels.symmetry, np.ascontiguousarray(both[:, :ROWS, 7:48]), mask)


def test_mirrored_windows(both):
    agree(kernels.mirrored, both, 31, atol=60.0)  # single precision of sums of 1e7


def test_edges(both):
    left, right = (np.ascontiguousarray(v[:, :, 7:48]) for v in (both[:, :ROWS], both[:, ROWS:]))
    agree(kernels.edges, left, right, rtol=1e-4)
