# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Clicks are moved onto drawn markings at exactly known positions."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from stereo_speed.site.refine.empty_road import Background
from stereo_speed.site.refine.snap import REACH_PX, snap

SIZE = (120, 160)
NORMAL = np.array([0.8, -0.6])  # of a line that falls to the right
THROUGH = np.array([80.3, 60.7])
WAY = np.array([0.6, 0.8])


def drawn(profile, noise_grey=1.0, seed=0):
    """Draw grey levels that depend on the distance from a line alone."""
    v, u = np.indices(SIZE)
    off = (u - THROUGH[0]) * NORMAL[0] + (v - THROUGH[1]) * NORMAL[1]
    image = profile(off) + np.random.default_rng(seed).normal(0, noise_grey, SIZE)
    return Background(image.astype(np.float32), noise_grey, 10)


def band(width, contrast=60.0):
    """Return the profile of a painted band, blurred."""
    return lambda x: 90 + contrast * (ndtr((x + width / 2) / 0.8) - ndtr((x - width / 2) / 0.8))


@pytest.mark.parametrize('way', [None, WAY, -WAY, np.array([0.55, 0.84])],
                         ids=['unknown', 'known', 'back', 'askew'])
@pytest.mark.parametrize('width', [2.0, 5.0, 12.0])
def test_click_beside_a_band_moves_to_its_middle(width, way):
    view, rng = drawn(band(width)), np.random.default_rng(1)
    for _ in range(4):
        click = THROUGH + rng.uniform(-12, 12) * WAY + rng.uniform(-2.5, 2.5) * NORMAL
        found = snap(view, click, way)
        assert found is not None and found.kind == 'band'
        off = float((found.uv_px - THROUGH) @ NORMAL)
        assert abs(off) < 4 * found.std_px < 0.6
        assert abs(float((found.uv_px - click) @ WAY)) < 0.2  # it stays where it is along the line


def test_click_beside_a_kerb_moves_to_its_edge():
    view = drawn(lambda x: 80 + 50 * ndtr(x / 0.9))
    found = snap(view, THROUGH + 3 * NORMAL, WAY)
    assert found is not None and found.kind == 'edge'
    assert abs(float((found.uv_px - THROUGH) @ NORMAL)) < 4 * found.std_px < 0.4


@pytest.mark.parametrize('width', [3.0, 5.0])
def test_a_band_beside_something_lighter_is_not_taken_for_a_kerb(width):
    """The band is 20 grey levels above its lighter side and 50 above the darker one."""
    view, rng = drawn(lambda x: 80 + 30 * ndtr((x - width / 2) / 0.8) + 50 * (
        ndtr((x + width / 2) / 0.8) - ndtr((x - width / 2) / 0.8))), np.random.default_rng(2)
    for _ in range(4):
        click = THROUGH + rng.uniform(-12, 12) * WAY + rng.uniform(-2.5, 2.5) * NORMAL
        found = snap(view, click, WAY)
        assert found is not None and found.kind == 'band'
        assert abs(float((found.uv_px - THROUGH) @ NORMAL)) < 4 * found.std_px < 0.6


@pytest.mark.parametrize('way', [None, WAY])
def test_click_beside_no_marking_is_unchanged(way):
    assert snap(drawn(lambda x: 90 + 0 * x, 3.0), THROUGH, way) is None
    far = THROUGH + (REACH_PX + 6) * NORMAL
    assert snap(drawn(band(3.0)), far, way) is None


def test_click_at_the_edge_of_the_image_is_safe():
    view = drawn(band(4.0))
    for corner in ((0.0, 0.0), (159.0, 119.0), (-3.0, 60.0), (159.4, 0.0)):
        snap(view, np.array(corner))
