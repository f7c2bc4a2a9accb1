# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The part of an annotated front that is measured."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.records import InitialFront
from stereo_speed.core.tracker_config import StartConfig, TrackerConfig
from stereo_speed.tracking.marked_front import measured_part
from stereo_speed.tracking.protocol import Refusal

POSE = np.array([20.0, 0.1, 0.7])  # 40 m away, from 0.3 to 1.1 m above the road
HALF_WIDTH_M = 0.9


@pytest.fixture(scope='module')
def pair(textured):
    return textured.pair(3, 0, POSE)


def part(textured, pair, tall_width_m, tall_high_m, pose=POSE):
    config = TrackerConfig(start=StartConfig(tall_width_m=tall_width_m, tall_high_m=tall_high_m))
    start = textured.start(pair, pose, config)
    return start.front, measured_part(start)


@pytest.mark.parametrize('high_m', [0.7, 0.9])
def test_wide_front_ends_at_the_height_of_its_bumper(textured, pair, high_m):
    _, found = part(textured, pair, 1.5, high_m)
    corners = np.array([[POSE[1] + x, 2.0 - height, 60.0 - POSE[0]] for x, height in (
        (-HALF_WIDTH_M, high_m), (HALF_WIDTH_M, high_m), (HALF_WIDTH_M, 0.3),
        (-HALF_WIDTH_M, 0.3))])
    left, right, _, _ = textured.rig.project(corners)
    # A place wrong by 0.2 px of disparity, 0.4 m, moves the height by 1 cm: 0.5 px.
    np.testing.assert_allclose(found.left_px, left, atol=0.5)
    np.testing.assert_allclose(found.right_px, right, atol=0.5)
    assert np.array_equal(found.left_px[2:], textured.quads(POSE)[0][2:])
    assert found.std_px == InitialFront(0, left, right).std_px


def test_edges_of_a_tilted_quad_end_at_the_same_height(textured, pair):
    """Its upper edge was marked 0.1 m higher on the right."""
    start = textured.start(pair, POSE, TrackerConfig(
        start=StartConfig(tall_width_m=1.5, tall_high_m=0.7)))
    up_px = np.array([[0.0, 0.0], [0.0, -0.1 * textured.focal_px / 40], [0.0, 0.0], [0.0, 0.0]])
    tilted = replace(start.front, left_px=start.front.left_px + up_px,
                     right_px=start.front.right_px + up_px)
    found = measured_part(replace(start, front=tilted))
    assert found.left_px[0, 1] == pytest.approx(found.left_px[1, 1], abs=0.1)


@pytest.mark.parametrize('tall_width_m, tall_high_m, why', [
    (1.9, 0.7, 'narrower than a lorry'), (1.5, 1.2, 'not taller'), (1.5, 0.5, 'no lower part')])
def test_other_fronts_are_measured_as_marked(textured, pair, tall_width_m, tall_high_m, why):
    marked, found = part(textured, pair, tall_width_m, tall_high_m)
    assert found is marked, why


def test_quads_of_no_front_are_refused(textured, pair):
    start = textured.start(pair, POSE)
    off = replace(start.front, right_px=start.front.right_px + [0.0, 12.0])
    assert isinstance(measured_part(replace(start, front=off)), Refusal)
