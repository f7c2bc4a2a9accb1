# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Histograms and outline gradients of quadrilaterals."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.lab.baselines.cues import BINS, histograms, outline_gradient
from stereo_speed.vision.haar import PartGrid
from stereo_speed.vision.histograms import bhattacharyya

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


def test_the_outline_counts_less_than_the_middle(box):
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


def test_outline_is_strongest_on_the_edge(box):
    shifts = np.arange(-6, 7)
    quads = QUAD - 0.5 + shifts[:, None, None] * np.array([1.0, 0.0])
    quads[:, 1:3] += 1.0  # the edge lies half a pixel outside the outermost centres
    found = outline_gradient(box, quads)
    assert shifts[np.argmax(found)] == 0 and found.max() > 3 * found[0] / 2
    assert outline_gradient(box, QUAD[None] * 0.2 + 2).max() < 1e-3
