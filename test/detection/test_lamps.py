# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Edges of detected fronts do not cut through lamps that clip."""
from __future__ import annotations

from dataclasses import replace

from drawn_fronts import Front, LANE, LANES, pair_of, RIG, SPEED_MPS, STEP_NS
from hypothesis import given, strategies as st
import numpy as np
import pytest
from stereo_speed.detection.config import DetectorConfig, FrontConfig
from stereo_speed.detection.detector import PlaneSweepDetector
from stereo_speed.detection.front_sampler import FrontHypothesis
from stereo_speed.detection.lamps import moved_edges, uncut_heights
from stereo_speed.detection.lane_geometry import LaneGeometry

USUAL_M = np.array([FrontConfig.high_m, FrontConfig.low_m])
ROWS_M = np.arange(1.2, 0.15, -0.05)
FRONT = Front(20.0)
FOUND = FrontHypothesis(FRONT.s_m, FRONT.x_m, FRONT.half_m)


def detected(lamps_m):
    """Return the detection of a front with such lamps, in the second of two pairs."""
    detector = PlaneSweepDetector(RIG, LANES, DetectorConfig())
    before = replace(FRONT, s_m=FRONT.s_m - SPEED_MPS * STEP_NS * 1e-9, lamps_m=lamps_m)
    assert not detector.update(pair_of([before]), [])
    found, = detector.update(pair_of([replace(FRONT, lamps_m=lamps_m)], 1), [])
    return found


def heights_m(found):
    """Return the heights above the road of the upper and the lower edge of a detection."""
    at = RIG.left.rays(found.left_px)
    points = at * (70.0 - found.s_m) / at[:, 2:]
    return 6.0 - points[[0, 2], 1]


@pytest.mark.parametrize(('lit_m', 'edges_m', 'moved_m'), [
    ((), (0.8, 0.3), (0.8, 0.3)),
    ((0.5, 0.55, 0.6), (0.8, 0.3), (0.8, 0.3)),  # within the front
    ((0.75, 0.8, 0.85), (0.8, 0.3), (0.95, 0.3)),  # up to the first row more than a margin away
    ((0.25, 0.3), (0.8, 0.3), (0.8, 0.4)),  # light on the road
    (tuple(np.arange(0.7, 1.25, 0.05)), (0.8, 0.2), (0.6, 0.2)),  # up to the last row: down
    (tuple(np.arange(0.1, 1.25, 0.05)), (0.8, 0.3), (0.8, 0.3)),  # nowhere to go
], ids=['dark', 'whole', 'up', 'road', 'down', 'all clipped'])
def test_edges_move_as_by_hand(lit_m, edges_m, moved_m):
    found = moved_edges(ROWS_M, np.array(lit_m), np.array(edges_m), 0.07)
    assert found == pytest.approx(moved_m)


@given(st.lists(st.booleans(), min_size=len(ROWS_M), max_size=len(ROWS_M)),
       st.floats(0.5, 0.9), st.floats(0.2, 0.45))
def test_front_keeps_its_height_and_edges_move_only_to_dark_rows(lit, high_m, low_m):
    low_m = min(low_m, high_m - 0.3)
    lit_m = ROWS_M[np.array(lit)]
    edges_m = np.array([high_m, low_m])
    moved_m = moved_edges(ROWS_M, lit_m, edges_m, 0.04)
    assert moved_m[0] - moved_m[1] >= 0.3 - 1e-9
    for edge_m, to_m in zip(edges_m, moved_m):
        assert to_m == edge_m or not (np.abs(lit_m - to_m) <= 0.04).any()


def test_lamps_are_found_where_they_are_drawn():
    """The upper edge ends up a pixel, here 2.5 cm, and a row of 2 cm above them at most."""
    lamps_m = (0.70, 0.86)
    pair = pair_of([replace(FRONT, lamps_m=lamps_m)])
    high_m, low_m = uncut_heights(LaneGeometry(RIG, LANE), FOUND, USUAL_M, pair)
    assert lamps_m[1] < high_m < lamps_m[1] + 0.025 + 0.02 * 2 + 0.025
    assert low_m == USUAL_M[1]
    assert (uncut_heights(LaneGeometry(RIG, LANE), FOUND, USUAL_M, pair_of([FRONT]))
            == USUAL_M).all()


def test_detected_front_has_whole_lamps():
    lamps_m = (0.70, 0.86)
    usual, whole = detected((0.0, 0.0)), detected(lamps_m)
    assert heights_m(usual) == pytest.approx(USUAL_M, abs=0.01)
    assert heights_m(whole)[0] > lamps_m[1] + 0.02
    assert whole.height_m == pytest.approx(-np.diff(heights_m(whole))[0], abs=0.01)
