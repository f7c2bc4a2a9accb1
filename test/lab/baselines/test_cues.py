# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Histograms, outline gradients and disparities of quadrilaterals."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.lab.baselines.cues import BINS, histograms, outline_gradient
from stereo_speed.lab.baselines.rectify import Rectifier
from stereo_speed.lab.sim.config import DISTORTED, straight_config
from stereo_speed.lab.sim.scene import SimScene
from stereo_speed.lab.sim.sequence import simulate
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
    found = histograms(box, np.stack([QUAD, QUAD - [40, 30]]),
                       PartGrid(10, 4), 255.0)
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    assert found[0, 40 * BINS // 256] == pytest.approx(1.0)
    assert found[1, 200 * BINS // 256] == pytest.approx(1.0)
    assert bhattacharyya(found, found[0]) == pytest.approx([1.0, 0.0])


def test_outline_is_strongest_on_the_edge(box):
    shifts = np.arange(-6, 7)
    quads = QUAD - 0.5 + shifts[:, None, None] * np.array([1.0, 0.0])
    quads[:, 1:3] += 1.0  # the edge lies half a pixel outside the outermost centres
    found = outline_gradient(box, quads)
    assert shifts[np.argmax(found)] == 0 and found.max() > 3 * found[0] / 2
    assert outline_gradient(box, QUAD[None] * 0.2 + 2).max() < 1e-3


def test_virtual_cameras_see_points_on_one_row_at_their_disparity():
    rig = SimScene(straight_config(rig=DISTORTED)).rig
    virtual = Rectifier(rig)
    points = np.random.default_rng(0).uniform([-3, -2, 15], [3, 2, 60], (20, 3))
    left, disparity = virtual.project(points, points)
    centre = -rig.R.T @ rig.t
    seen = (points - centre) @ virtual.turn.T  # from the right camera's place, turned alike
    right = virtual.f_px * seen[:, :2] / seen[:, 2:]
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
    np.testing.assert_allclose(left[:, 0] - right[:, 0], disparity, atol=1e-9)


def test_disparity_map_of_a_simulated_front():
    sequence = simulate(straight_config(rig=DISTORTED, start_m=32.0, pairs=1, noise_grey=0.0),
                        np.random.default_rng(0))
    row, pair = sequence.truth[0], sequence.pairs[0]
    centre = np.array([[float(row[k]) for k in 'xyz']])
    virtual = Rectifier(sequence.rig)
    uv, expected = virtual.project(centre, centre)
    low, high = np.round(uv[0]) - [20, 10], np.round(uv[0]) + [20, 10]
    found = virtual.disparity(pair.left, pair.right, low, high,
                              (expected[0] - 8, expected[0] + 8))
    assert found.shape == (20, 40) and np.isfinite(found).mean() > 0.8
    assert np.nanmedian(found) == pytest.approx(expected[0], abs=0.35)
