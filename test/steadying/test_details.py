# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Patches of an image are found in it from starts with known offsets."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.steadying.details import corners, Details

SIDE_PX = 60
CENTRE_PX = np.array([[30.0, 30.0]])


def blob(contrast):
    """Return whole grey levels of a smooth blob."""
    v, u = np.mgrid[:SIDE_PX, :SIDE_PX] - 30.0
    return np.rint(20 + contrast * np.exp(-(u ** 2 + v ** 2) / 32)).astype(np.uint8)


@pytest.mark.parametrize('contrast', [200, 20, 5], ids=['by day', 'dusk', 'by night'])
@pytest.mark.parametrize('off_px', [[0.0, 0.0], [0.125, 0.0], [0.0, -0.125], [0.05, 0.08]])
def test_offset_is_found_at_any_contrast(contrast, off_px):
    image = blob(contrast)
    details = Details.at(image, CENTRE_PX)
    found = details.find(image, CENTRE_PX + off_px)
    back_px = found.offset_px[0] @ details.axes[0]
    assert back_px == pytest.approx(-np.array(off_px), abs=0.02)


@pytest.mark.parametrize('count', [110, 250, 400])
def test_corners_are_spread_over_the_whole_image_however_many(count):
    """Where there is more texture than is needed, the cells at the bottom count as those above."""
    image = np.random.default_rng(1).integers(0, 255, (540, 960), dtype=np.uint8)
    found = corners(image, count)
    assert len(found) == count
    cells = np.histogram2d(found[:, 1], found[:, 0], bins=(
        np.linspace(6, 534, 10).astype(int), np.linspace(6, 954, 13).astype(int)))[0]
    assert cells.max() - cells.min() <= 1
    taken = found[:count // 2]
    more = corners(image, count, taken)
    assert len(more) == count - len(taken)
    assert np.linalg.norm(more[:, None] - taken, axis=-1).min() > 4.0
