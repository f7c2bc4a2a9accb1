# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Wrong order and crossings of picked lines, by hand."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.site.checks import crossing, out_of_order

LINE = np.array([[0.0, 0], [10, 10], [20, 20], [30, 30], [40, 40]])


def swapped(i, j):
    """Swap two points of the line."""
    points = LINE.copy()
    points[[i, j]] = points[[j, i]]
    return points


@pytest.mark.parametrize('points, wanted', [
    (LINE, None), (LINE[:2], None), (LINE[::-1], None),
    (swapped(1, 2), 2), (swapped(2, 3), 3), (swapped(3, 4), 4), (swapped(0, 1), 1),
    (np.insert(LINE, 2, LINE[1], axis=0), 2),  # the same point twice
    (np.array([[0.0, 0], [10, 0], [20, 2], [11, 3], [1, 4]]), None),  # one hairpin is a curve
    (np.array([[0.0, 0, 9], [0, 0, 5], [0, 0, 7]]), 2)],  # surveyed points
    ids=['in order', 'two', 'backwards', '1-2', '2-3', 'last', 'first', 'twice', 'hairpin', '3-D'])
def test_order(points, wanted):
    assert out_of_order(points) == wanted


def test_crossing_segments():
    other = np.array([[0.0, 25], [12, 24], [30, 20], [50, 0]])
    assert crossing(LINE, other) == (2, 1)
    assert crossing(LINE, other + [0.0, 30.0]) is None
    assert crossing(LINE, LINE + [5.0, 0.0]) is None  # parallel
    assert crossing(LINE, LINE[::-1]) is None  # one line in both directions


def test_lines_that_cross_themselves():
    loop = np.array([[0.0, 0], [10, 10], [20, 0], [10, -5], [5, 20]])
    assert crossing(loop, loop) == (0, 3)
    assert crossing(LINE, LINE) is None
