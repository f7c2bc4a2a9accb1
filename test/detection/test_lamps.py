# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Upper and lower edges of detected fronts do not cut through lamps that clip."""
from __future__ import annotations

from dataclasses import replace

from drawn_fronts import (
    Front, LANE, LANES, pair_of, pyramids_of, RIG, SPEED_MPS, STEP_NS)
from hypothesis import given, strategies as st
import numpy as np
import pytest
from stereo_speed.core.records import StereoPair
from stereo_speed.detection.config import DetectorConfig, FrontConfig
from stereo_speed.detection.detector import PlaneSweepDetector
from stereo_speed.detection.front_sampler import FrontHypothesis
from stereo_speed.detection.lamps import Look, moved_edges, uncut_heights
from stereo_speed.detection.lane_geometry import LaneGeometry

USUAL_M = np.array([FrontConfig.high_m, FrontConfig.low_m])
TALL_M = np.array([FrontConfig.tall_high_m, FrontConfig.tall_low_m])
ROWS_M = np.arange(1.2, 0.15, -0.05)
MARGIN_M = 0.04
LAMPS_M = (0.70, 0.86)
FRONT = Front(20.0)
GEOMETRY = LaneGeometry(RIG, LANE)
SCALE_M = 1 / 24  # size of a pixel on the front, 50 m away


def look(front, pair=None):
    """Return a front and a pair that shows it."""
    found = FrontHypothesis(front.s_m, front.x_m, front.half_m)
    return Look.now(found, pair_of([front]) if pair is None else pair)


def heights_m(found, right=False):
    """Return the heights above the road of the upper and the lower edge of a detection."""
    camera, quad = (RIG.right, found.right_px) if right else (RIG.left, found.left_px)
    at = camera.rays(quad)
    return 6.0 - (at * (70.0 - found.s_m) / at[:, 2:])[[0, 2], 1]


@pytest.mark.parametrize(('lit_m', 'edges_m', 'moved_m'), [
    ((), (0.8, 0.3), (0.8, 0.3)),
    ((0.6, 0.55, 0.5), (0.8, 0.3), (0.8, 0.3)),  # within the front
    ((0.85, 0.8, 0.75), (0.8, 0.3), (0.95, 0.3)),  # to the first row more than a margin away
    (tuple(np.arange(1.2, 0.7, -0.05)), (0.8, 0.2), (0.65, 0.2)),  # too high for lamps
    (tuple(np.arange(1.1, 0.65, -0.05)), (0.8, 0.2), (0.6, 0.2)),  # the same, with room above
    (tuple(np.arange(1.2, 0.1, -0.05)), (0.8, 0.3), (0.8, 0.3)),  # nowhere to go
    ((0.6, 0.55, 0.5, 0.45), (1.2, 0.5), (1.2, 0.35)),  # lamps at the lower edge
    ((0.4, 0.35, 0.3, 0.25, 0.2), (1.2, 0.4), (1.2, 0.5)),  # light on the road
    ((0.9, 0.85, 0.5, 0.45), (0.85, 0.45), (1.0, 0.35)),  # both edges
], ids=['dark', 'whole', 'up', 'sun at the top', 'sun', 'all', 'down', 'road', 'both'])
def test_edges_move_as_by_hand(lit_m, edges_m, moved_m):
    found = moved_edges(ROWS_M, np.array(lit_m), np.array(edges_m), 0.07)
    assert found == pytest.approx(moved_m)


@given(st.lists(st.booleans(), min_size=len(ROWS_M), max_size=len(ROWS_M)),
       st.floats(0.5, 0.9), st.floats(0.2, 0.45))
def test_edge_moves_only_from_lit_rows_and_only_to_dark_ones(lit, high_m, low_m):
    edges_m = np.array([high_m, min(low_m, high_m - 0.3)])
    lit_m = ROWS_M[np.array(lit)]
    moved_m = moved_edges(ROWS_M, lit_m, edges_m, MARGIN_M)
    assert moved_m[0] - moved_m[1] >= 0.3 - 1e-9
    touched = [bool((np.abs(lit_m - edge_m) <= MARGIN_M).any()) for edge_m in edges_m]
    moves = moved_m != edges_m
    assert not any(moves[~np.array(touched)])
    assert not (np.abs(lit_m[:, None] - moved_m[moves]) <= MARGIN_M).any()
    dark_m = ROWS_M[(np.abs(ROWS_M[:, None] - lit_m) > MARGIN_M).all(axis=1)]
    if touched[0] and (dark_m >= edges_m[1] + 0.3).any():
        assert moves[0]


@pytest.mark.parametrize('window_m', [USUAL_M, TALL_M], ids=['car', 'lorry'])
def test_front_keeps_its_heights_without_lamps_and_with_whole_ones(window_m):
    within = replace(FRONT, lamps_m=(0.5, 0.6))
    for front in (FRONT, within):
        assert (uncut_heights(GEOMETRY, window_m, [look(front)]) == window_m).all()


@pytest.mark.parametrize('lit', [slice(0, 2), slice(0, 1), slice(1, 2)],
                         ids=['both views', 'left view', 'right view'])
@pytest.mark.parametrize('bits', [8, 12, 16])
def test_upper_edge_is_next_above_the_lamps(lit, bits):
    """At most a margin of a pixel, half a pixel for the lamp's edge, and a row further up."""
    bright, dark = pair_of([replace(FRONT, lamps_m=LAMPS_M)]), pair_of([FRONT])
    views = [dark.left, dark.right]
    views[lit] = [bright.left, bright.right][lit]
    if bits > 8:
        views = [np.rint(view * (((1 << bits) - 1) / 255)).astype(np.uint16) for view in views]
    pair = StereoPair(0, dark.stamp_ns, dark.right_stamp_ns, *views)
    high_m, low_m = uncut_heights(GEOMETRY, USUAL_M, [look(FRONT, pair)])
    assert LAMPS_M[1] + 0.5 * SCALE_M < high_m < LAMPS_M[1] + 1.5 * SCALE_M + 0.02
    assert low_m == USUAL_M[1]


def test_lamps_of_the_earlier_pair_count_too():
    """A lamp keeps its size in pixels, so it is larger on the front where that is farther away."""
    earlier = replace(FRONT, s_m=FRONT.s_m - 6.0, lamps_m=(0.66, 0.98))
    now = replace(FRONT, lamps_m=LAMPS_M)
    before = Look.before(look(earlier).front, pyramids_of(pair_of([earlier])))
    high_m, _ = uncut_heights(GEOMETRY, USUAL_M, [look(now), before])
    assert high_m > 0.98


def test_late_right_view_is_looked_at_where_the_front_is_by_then():
    gone_m = 2.0
    front = replace(FRONT, lamps_m=LAMPS_M)
    late = pair_of([replace(FRONT)], late=[replace(front, s_m=front.s_m + gone_m)],
                   lag_ns=90_000_000)
    found = FrontHypothesis(FRONT.s_m, FRONT.x_m, FRONT.half_m, ahead_m=gone_m)
    assert uncut_heights(GEOMETRY, USUAL_M, [Look.now(found, late)])[0] > LAMPS_M[1]


def test_lower_edge_of_a_lorry_goes_below_its_lamps():
    front = replace(FRONT, lamps_m=(0.36, 0.62))
    high_m, low_m = uncut_heights(GEOMETRY, TALL_M, [look(front)])
    assert high_m == TALL_M[0] and low_m < 0.36


def test_edges_stay_inside_the_images():
    """Lamps that reach the top of the image leave the upper edge below them."""
    pair = pair_of([replace(FRONT, lamps_m=LAMPS_M)])
    rows = int(RIG.left.project(GEOMETRY.points(
        np.array([FRONT.s_m]), np.zeros(1), np.array([0.9])))[0][0, 0, 0, 1])
    rig = replace(RIG, **{
        name: replace(camera, K=camera.K - [[0, 0, 0], [0, 0, rows], [0, 0, 0]],
                      height_px=camera.height_px - rows)
        for name, camera in (('left', RIG.left), ('right', RIG.right))})
    cut = StereoPair(0, pair.stamp_ns, pair.right_stamp_ns, pair.left[rows:], pair.right[rows:])
    high_m, _ = uncut_heights(LaneGeometry(rig, LANE), USUAL_M, [look(FRONT, cut)])
    assert high_m < LAMPS_M[0]


def test_detected_front_has_whole_lamps():
    def detected(lamps_m):
        detector = PlaneSweepDetector(RIG, LANES, DetectorConfig())
        before = replace(FRONT, s_m=FRONT.s_m - SPEED_MPS * STEP_NS * 1e-9, lamps_m=lamps_m)
        assert not detector.update(pair_of([before]), [])
        found, = detector.update(pair_of([replace(FRONT, lamps_m=lamps_m)], 1), [])
        return found

    usual, whole = detected((0.0, 0.0)), detected(LAMPS_M)
    assert heights_m(usual) == pytest.approx(USUAL_M, abs=0.01)
    assert heights_m(whole)[0] > LAMPS_M[1] + 0.02
    assert heights_m(whole, right=True) == pytest.approx(heights_m(whole), abs=0.01)
    assert whole.height_m == pytest.approx(-np.diff(heights_m(whole))[0], abs=0.01)
    quads = [quad[[0, 2], 1] for quad in (whole.earlier.left_px, usual.earlier.left_px)]
    assert quads[0][0] < quads[1][0] - 2 and quads[0][1] == pytest.approx(quads[1][1], abs=1)
