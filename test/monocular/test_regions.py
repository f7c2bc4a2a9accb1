# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Maps drawn from polygons, against another library's point-in-polygon test."""
from __future__ import annotations

from matplotlib.path import Path as Outline
import numpy as np
import pytest

from stereo_speed.monocular.regions import draw_map, polygon_mask, Region


def region(kind, *points):
    return Region(kind=kind, polygon_px=np.array(points, dtype=float))


def star(rng, corners, centre, radius):
    """Draw a non-convex polygon without crossings."""
    turn = np.sort(rng.uniform(0, 2 * np.pi, corners))
    reach = radius * rng.uniform(0.3, 1.0, corners)
    return centre + reach[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)


@pytest.mark.parametrize('seed', range(6))
def test_pixels_with_their_centre_inside_are_drawn(seed):
    rng = np.random.default_rng(seed)
    polygon = star(rng, rng.integers(3, 12), rng.uniform(15, 45, 2), rng.uniform(20, 60))
    rows, columns = np.mgrid[:50, :70]
    centres = np.stack([columns.ravel(), rows.ravel()], axis=-1)
    wanted = Outline(np.concatenate([polygon, polygon[:1]]), closed=True).contains_points(centres)
    assert 0 < wanted.sum() < 3500
    for corners in (polygon, polygon[::-1], np.roll(polygon, 1, axis=0)):
        np.testing.assert_array_equal(polygon_mask(corners, 70, 50), wanted.reshape(50, 70))


def test_rectangle_by_hand():
    mask = polygon_mask(np.array([[1.5, 0.5], [4.5, 0.5], [4.5, 2.5], [1.5, 2.5]]), 7, 5)
    wanted = np.zeros((5, 7), dtype=bool)
    wanted[1:3, 2:5] = True
    np.testing.assert_array_equal(mask, wanted)


def test_crossing_outline_is_even_odd():
    """A square traversed twice is empty; the inner square of a frame is a hole."""
    square = np.array([[0.5, 0.5], [6.5, 0.5], [6.5, 6.5], [0.5, 6.5]])
    assert not polygon_mask(np.concatenate([square, square]), 8, 8).any()
    inner = 3.5 + (square - 3.5) / 3
    framed = polygon_mask(np.concatenate([square, square[:1], inner, inner[:1]]), 8, 8)
    np.testing.assert_array_equal(framed,
                                  polygon_mask(square, 8, 8) & ~polygon_mask(inner, 8, 8))
    assert framed.sum() == 36 - 4


@pytest.mark.parametrize('corner', [(3.0, 4.0), (3.4, 4.7)])
def test_neighbours_leave_no_gap_and_share_no_pixel(corner):
    """Four quarters around a corner, on pixel centres and off them."""
    x, y = corner
    quarters = [[(-9, -9), (x, -9), corner, (-9, y)], [(x, -9), (20, -9), (20, y), corner],
                [corner, (20, y), (20, 20), (x, 20)], [(-9, y), corner, (x, 20), (-9, 20)]]
    total = sum(polygon_mask(np.array(q, dtype=float), 8, 9).astype(int) for q in quarters)
    np.testing.assert_array_equal(total, 1)


def test_later_regions_cover_earlier_ones():
    labels = draw_map([region('pathway', (-5, 1.5), (30, 1.5), (30, 5.5), (-5, 5.5)),
                       region('inaccessible', (2.5, -9), (5.5, -9), (5.5, 99), (2.5, 99)),
                       region('accessible', (3.5, 3.5), (4.5, 3.5), (4.5, 4.5), (3.5, 4.5))],
                      9, 8)
    wanted = np.full((8, 9), 128)
    wanted[2:6], wanted[:, 3:6], wanted[4, 4] = 255, 0, 128
    assert labels.dtype == np.uint8
    np.testing.assert_array_equal(labels, wanted)


@pytest.mark.parametrize(('kind', 'level'), [('pathway', 255), ('accessible', 128),
                                             ('inaccessible', 0)])
def test_background_is_the_rest(kind, level):
    np.testing.assert_array_equal(draw_map([], 3, 2, kind), np.full((2, 3), level))
