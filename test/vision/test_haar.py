# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Haar-like features: by hand, against brute force, and their invariances."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.core.errors import InputError
from stereo_speed.vision.haar import haar_basis, PART_LAYOUT, PartGrid


def test_basis_is_orthonormal_and_complete():
    rows = haar_basis().reshape(16, 16)
    np.testing.assert_allclose(rows @ rows.T, np.eye(16), atol=1e-12)


def test_up_down_of_a_step_by_hand():
    # A 4 x 4 part, top half 1, bottom half 0: mean 16/2/4 = 2, up-down 8/4 = 2, all else 0.
    part = np.zeros((4, 4))
    part[:2] = 1.0
    values = haar_basis().reshape(16, 16) @ part.ravel()
    np.testing.assert_allclose(values, [2, 2] + [0] * 14, atol=1e-12)


@pytest.mark.parametrize('parts', sorted(PART_LAYOUT))
def test_transform_equals_box_differences(parts):
    grid = PartGrid(parts, 8)
    rows, cols = grid.shape
    patch = np.random.default_rng(parts).normal(size=(rows, cols)).astype(np.float32)
    across, _ = PART_LAYOUT[parts]
    got = grid.transform(patch.reshape(1, -1)).reshape(parts, 16)
    for part in range(parts):
        r, c = divmod(part, across)
        block = patch[8 * r:8 * r + 8, 8 * c:8 * c + 8]
        # Box sums, each scaled to unit length: 64 samples at level 1, 16 at level 2.
        left_right = (block[:, :4].sum() - block[:, 4:].sum()) / 8
        up_down = (block[:4].sum() - block[4:].sum()) / 8
        quadrant = block[:4, 4:]
        diagonal = (quadrant[:2, :2].sum() - quadrant[:2, 2:].sum()
                    - quadrant[2:, :2].sum() + quadrant[2:, 2:].sum()) / 4
        assert got[part, 1] == pytest.approx(up_down, abs=1e-4)
        assert got[part, 2] == pytest.approx(left_right, abs=1e-4)
        assert got[part, 9] == pytest.approx(diagonal, abs=1e-4)


def test_features_ignore_gain_and_offset():
    grid = PartGrid()
    patch = np.random.default_rng(1).uniform(0, 255, (3, grid.unit_xy.shape[0])).astype('f4')
    np.testing.assert_allclose(grid.features(2.5 * patch - 40), grid.features(patch), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(grid.features(patch), axis=1), 1, atol=1e-4)


def test_flat_patch_has_no_features():
    grid = PartGrid()
    flat = np.full((1, grid.unit_xy.shape[0]), 90, np.float32)
    np.testing.assert_allclose(grid.features(flat), 0, atol=1e-6)


@pytest.mark.parametrize('parts, samples, field', [(5, 8, 'parts'), (10, 6, 'samples_per_part')])
def test_impossible_grids_are_refused(parts, samples, field):
    with pytest.raises(InputError, match=field):
        PartGrid(parts, samples)
