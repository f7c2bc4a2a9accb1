# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The moving part of a window: centres and widths without symmetry, and parts of wider objects."""
from __future__ import annotations

from dataclasses import replace

import cv2
from drawn_fronts import (
    Front, HEIGHT_M, LANE, LANE_M, pair_of, pyramids_of, RIG, SPEED_MPS, START_M, STEP_NS)
import numpy as np
import pytest
from stereo_speed.detection.config import MotionConfig
from stereo_speed.detection.front_sampler import FrontHypothesis, FrontSampler
from stereo_speed.detection.lane_geometry import LaneGeometry
from stereo_speed.detection.outline import going_extent, moving_outline
from stereo_speed.detection.pyramid import Pyramid
from stereo_speed.detection.temporal_match import find_motion, Interval
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath

STEP_M = SPEED_MPS * STEP_NS * 1e-9
S_M = 30.0
SAMPLER = FrontSampler(LaneGeometry(RIG, LANE), 0.4, 1.25)
GRID_M = 0.03


def interval_of(now, before):
    return Interval(pyramids_of(pair_of(now, 1)), pyramids_of(pair_of(before, 0)))


def came(x_m=0.0, half_m=0.35, gone_m=STEP_M, **how):
    """Return a front that moved, symmetric or not, in its pair and the one before."""
    return interval_of([Front(S_M, x_m, half_m=half_m, **how)],
                       [Front(S_M - gone_m, x_m, half_m=half_m, **how)])


@pytest.mark.parametrize('symmetric', [True, False])
@pytest.mark.parametrize('x_m', [-0.3, 0.4])
def test_outline_of_a_moving_front_needs_no_symmetry(x_m, symmetric):
    interval = came(x_m, symmetric=symmetric)
    middle_m, half_m = moving_outline(SAMPLER, 0.0, S_M, 1.2, interval, 1.0, MotionConfig())
    # Road that one view sees beside the front and the other does not is 12 cm wide at its top.
    assert middle_m == pytest.approx(x_m, abs=0.06 + GRID_M)
    assert half_m == pytest.approx(0.35, abs=0.06 + GRID_M)


def test_stationary_object_has_no_outline():
    still = [Front(S_M, half_m=0.35)]
    assert moving_outline(SAMPLER, 0.0, S_M, 1.2, interval_of(still, still), 1.0,
                          MotionConfig()) is None


def test_darker_pairs_have_the_same_outline():
    interval = came()
    dark = Pyramid(tuple(0.85 * level for level in interval.before.left.levels),
                   interval.before.left.origin_px)
    darker = Interval(interval.now, replace(interval.before, left=dark))
    bright, dim = (moving_outline(SAMPLER, 0.0, S_M, 1.2, one, 1.0, MotionConfig())
                   for one in (interval, darker))
    assert dim == pytest.approx(bright, abs=2 * GRID_M)


def width_of(interval, x_m=0.0, half_m=0.35):
    front = FrontHypothesis(S_M, x_m, half_m)
    motion = find_motion(SAMPLER, front, interval, MotionConfig())
    return going_extent(SAMPLER, front, motion, interval, 1.0, MotionConfig()).width_m


@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_something_static_separates_what_moves_beside_a_front(side):
    """Two objects of 0.7 m, 0.6 m apart, are one extent; only the first is near."""
    def at(s_m):
        return [Front(s_m, half_m=0.35), Front(s_m, x_m=1.3 * side, half_m=0.35)]
    interval = interval_of(at(S_M), at(S_M - 1.0))
    front = FrontHypothesis(S_M, 0.0, 0.35)
    motion = find_motion(SAMPLER, front, interval, MotionConfig())
    found = going_extent(SAMPLER, front, motion, interval, 1.0, MotionConfig())
    far_m, near_m = (found.left_m, found.near_left_m) if side > 0 else (
        -found.right_m, -found.near_right_m)
    assert far_m == pytest.approx(1.65, abs=4 * GRID_M)
    assert near_m == pytest.approx(0.35, abs=4 * GRID_M)


def lane_away():
    """Return the lane in the other direction, in which left of travel is left in the image."""
    return LanePath('away', StraightPath([LANE_M, HEIGHT_M, START_M - 50.0], [0, 0, 1.0], 50.0),
                    None, np.zeros(2), 0.0)


@pytest.mark.parametrize('away', [False, True], ids=['approaching', 'receding'])
@pytest.mark.parametrize('side', [-1.0, 1.0])
@pytest.mark.parametrize(('behind_m', 'is_part'), [
    (4.5, False),  # the right view shows it 0.051 m aside
    (0.0, True), (2.0, True)])
def test_what_stands_farther_away_is_no_part_of_a_front(behind_m, is_part, side, away):
    """Something moves along beside a front, without a gap between them in the left view."""
    def pair(s_m):
        far_m = START_M - s_m
        middle_m, nearer = LANE_M + 1.0 * side, far_m / (far_m + behind_m)
        return [Front(s_m - behind_m, middle_m / nearer - LANE_M, half_m=0.65 / nearer,
                      low_m=-2.0, high_m=2.5), Front(s_m, half_m=0.35)]
    gone_m = -1.0 if away else 1.0
    sampler = FrontSampler(LaneGeometry(RIG, lane_away()), 0.4, 1.25) if away else SAMPLER
    interval = interval_of(pair(S_M), pair(S_M - gone_m))
    front = FrontHypothesis(50.0 - S_M if away else S_M, 0.0, 0.35)
    motion = find_motion(sampler, front, interval, MotionConfig())
    found = going_extent(sampler, front, motion, interval, 1.0, MotionConfig(), 0.04)
    assert found.width_m > 1.6 if is_part else found.width_m < 1.2


@pytest.mark.parametrize('lag_s', [-0.033, -0.01, 0.01, 0.033])
@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_what_moves_farther_away_is_seen_where_it_is_when_the_right_view_is_exposed(side, lag_s):
    def pair(s_m, index):
        far_m, behind_m = START_M - s_m, 6.0
        middle_m, nearer = LANE_M + 1.0 * side, far_m / (far_m + behind_m)
        both = [Front(s_m - behind_m, middle_m / nearer - LANE_M, half_m=0.65 / nearer,
                      low_m=-2.0, high_m=2.5), Front(s_m, half_m=0.35)]
        late = [replace(front, s_m=front.s_m + lag_s * SPEED_MPS) for front in both]
        return pyramids_of(pair_of(both, index, late, round(lag_s * 1e9)))
    interval = Interval(pair(S_M, 1), pair(S_M - STEP_M, 0))
    front = FrontHypothesis(S_M, 0.0, 0.35, ahead_m=lag_s * SPEED_MPS)
    motion = find_motion(SAMPLER, front, interval, MotionConfig())
    assert going_extent(
        SAMPLER, front, motion, interval, 1.0, MotionConfig(), 0.04).width_m < 1.5


@pytest.mark.parametrize('gone_m', [1.0, STEP_M])
def test_width_moving_with_a_narrow_front_is_its_own(gone_m):
    """Neither the road nor the part of it that the front has uncovered counts."""
    assert width_of(came(gone_m=gone_m)) == pytest.approx(0.7, abs=4 * GRID_M)


@pytest.mark.parametrize('right', [False, True], ids=['left soft', 'right soft'])
@pytest.mark.parametrize('blur_px', [0.7, 1.0, 2.0])
def test_width_of_a_narrow_front_is_kept_with_one_view_out_of_focus(blur_px, right):
    """The blurred view matches the road behind it as well, if the other one is equally blurred."""
    def soft(cars, index):
        pair = pair_of(cars, index)
        views = {'right' if right else 'left': cv2.GaussianBlur(
            pair.right if right else pair.left, (0, 0), blur_px)}
        return pyramids_of(replace(pair, **views))
    interval = Interval(soft([Front(S_M, half_m=0.35)], 1),
                        soft([Front(S_M - STEP_M, half_m=0.35)], 0))
    assert width_of(interval) < 1.3


@pytest.mark.parametrize('x_m', [-0.5, 0.0, 0.5])
def test_part_of_a_wide_front_is_wider_than_a_two_wheeler(x_m):
    assert width_of(came(half_m=0.9, symmetric=False), x_m) > 1.6


def test_stationary_object_beside_a_narrow_front_does_not_count():
    post = Front(S_M + 1.0, 1.0, half_m=0.2)
    both = interval_of([Front(S_M, half_m=0.35), post], [Front(S_M - STEP_M, half_m=0.35), post])
    assert width_of(both) == pytest.approx(0.7, abs=4 * GRID_M)


def test_moving_shadow_does_not_count():
    def pair(s_m):  # the shadow lies beside and behind the front, where its window shows it
        return [Front(s_m - 4.0, 1.2, half_m=0.4, lying=True), Front(s_m, half_m=0.35)]
    alone, shaded = width_of(came()), width_of(interval_of(pair(S_M), pair(S_M - STEP_M)))
    assert shaded == pytest.approx(alone, abs=4 * GRID_M)


def end_of_wide(side, hidden_now):
    """Return pairs in one of which the rest of a wide front is occluded by a vehicle ahead."""
    def pair(s_m, hidden):
        nearer = (START_M - s_m - 8.0) / (START_M - s_m)
        # As the left camera sees it, 0.4 m from the middle to beyond the other end.
        ends_m = [(LANE_M + x_m) * nearer - LANE_M for x_m in (0.4 * side, -1.6 * side)]
        lorry = Front(s_m + 8.0, sum(ends_m) / 2, half_m=abs(ends_m[0] - ends_m[1]) / 2,
                      low_m=0.0, high_m=2.6)
        return [Front(s_m, half_m=0.9, symmetric=False), *([lorry] if hidden else [])]
    return interval_of(pair(S_M, hidden_now), pair(S_M - STEP_M, not hidden_now))


@pytest.mark.parametrize('side', [-1, 1])
@pytest.mark.parametrize('hidden_now', [False, True])
def test_hidden_area_beside_a_front_may_be_part_of_it(side, hidden_now):
    """Half a metre of 1.8 m is seen to move along."""
    assert width_of(end_of_wide(side, hidden_now), 0.65 * side, 0.24) > 1.2
