# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The part of an annotated front that is measured."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.records import RigMotion
from stereo_speed.core.tracker_config import StartConfig, TrackerConfig
from stereo_speed.tracking.marked_front import measured_part

POSE = np.array([20.0, 0.1, 0.7])  # 40 m away, from 0.3 to 1.1 m above the road
HALF_WIDTH_M = 0.9


@pytest.fixture(scope='module')
def pair(textured):
    return textured.pair(3, 0, POSE)


def with_limits(tall_width_m, tall_high_m):
    return TrackerConfig(start=StartConfig(tall_width_m=tall_width_m, tall_high_m=tall_high_m))


LOW = with_limits(1.5, 0.7)


def lower(textured, pose, high_m):
    """Return the quads of the part from 0.3 m above the road up to a height, in both views."""
    corners = np.array([[pose[1] + x, 2.0 - height, 60.0 - pose[0]] for x, height in (
        (-HALF_WIDTH_M, high_m), (HALF_WIDTH_M, high_m), (HALF_WIDTH_M, 0.3),
        (-HALF_WIDTH_M, 0.3))])
    return textured.rig.project(corners)[:2]


@pytest.mark.parametrize('high_m', [0.7, 0.9])
def test_wide_front_ends_at_the_height_of_its_bumper(textured, pair, high_m):
    start = textured.start(pair, POSE, with_limits(1.5, high_m))
    found = measured_part(start)
    # A place wrong by 0.2 px of disparity, 0.4 m, moves the height by 1 cm: 0.5 px.
    for quad, wanted in zip((found.left_px, found.right_px), lower(textured, POSE, high_m)):
        np.testing.assert_allclose(quad, wanted, atol=0.5)
    assert np.array_equal(found.left_px[2:], start.front.left_px[2:])
    assert (found.frame, found.std_px) == (start.front.frame, start.front.std_px)


def test_edges_of_a_tilted_quad_end_at_the_same_height(textured, pair):
    """Its upper edge was marked 0.1 m higher on the right."""
    start = textured.start(pair, POSE, LOW)
    up_px = np.zeros((4, 2))
    up_px[1, 1] = -0.1 * textured.focal_px / 40
    tilted = replace(start.front, left_px=start.front.left_px + up_px,
                     right_px=start.front.right_px + up_px)
    found = measured_part(replace(start, front=tilted))
    for quad, wanted in zip((found.left_px, found.right_px), lower(textured, POSE, 0.7)):
        np.testing.assert_allclose(quad, wanted, atol=0.5)


@pytest.mark.parametrize('limits, why', [
    ((1.9, 0.7), 'narrower than a lorry'), ((1.5, 1.2), 'not taller'),
    ((1.5, 0.5), 'hardly anything left')])
def test_other_fronts_are_measured_as_marked(textured, pair, limits, why):
    start = textured.start(pair, POSE, with_limits(*limits))
    assert measured_part(start) is start.front, why


def test_quads_that_do_not_match_are_left_to_the_tracker(textured, pair):
    start = textured.start(pair, POSE, LOW)
    off = replace(start.front, right_px=start.front.right_px + [0.0, 12.0])
    assert measured_part(replace(start, front=off)) is off


def test_part_is_found_in_a_right_view_of_a_later_time(textured):
    """It was exposed 10 ms later, when the front had come 0.2 m nearer."""
    later = POSE + [0.2, 0.0, 0.0]
    pair = textured.pair(3, 0, POSE, right_ns=10_000_000, right_pose=later)
    start = textured.start(pair, POSE, LOW)
    front = replace(start.front, right_px=textured.quads(later)[1])
    found = measured_part(replace(start, front=front, seen_mps=20.0))
    for quad, pose, view in ((found.left_px, POSE, 0), (found.right_px, later, 1)):
        np.testing.assert_allclose(quad, lower(textured, pose, 0.7)[view], atol=0.5)


def test_height_is_that_above_the_road_however_the_rig_has_swayed(textured, pair):
    """By a rig tilted downwards by 0.1 degrees the same pixels lie 7 cm lower 40 m away."""
    start = textured.start(pair, POSE, LOW)
    motion = RigMotion(sway_rad=(0.0, -np.radians(0.1), 0.0))
    found = measured_part(replace(start, pair=replace(pair, motion=motion)))
    more_px = measured_part(start).left_px[:2, 1] - found.left_px[:2, 1]
    np.testing.assert_allclose(more_px, np.radians(0.1) * textured.focal_px, atol=0.6)
