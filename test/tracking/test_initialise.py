# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The start of a track on a front whose images have a closed form."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from stereo_speed.core.errors import InputError
from stereo_speed.core.records import InitialFront
from stereo_speed.core.tracker_config import StartConfig, TrackerConfig
from stereo_speed.tracking.initialise import check_annotation, first_states, place_front, Placement
from stereo_speed.tracking.protocol import Refusal
from stereo_speed.vision.haar import PartGrid

GRID = PartGrid(10, 8)
POSE = np.array([20.0, 0.1, 1.9])  # 40 m away: f b / Z^2 = 0.469 px of disparity a metre
SLOPE = 1500 * 0.5 / 40 ** 2


@pytest.fixture(scope='module')
def pair(textured):
    return textured.pair(3, 0, POSE)


def moved(front, left=(0.0, 0.0), right=(0.0, 0.0)):
    return replace(front, left_px=front.left_px + left, right_px=front.right_px + right)


def test_exact_quads_give_the_position_and_its_slopes(textured, pair):
    placed = place_front(textured.start(pair, POSE), GRID)
    assert abs(placed.pose[0] - POSE[0]) < 0.2 / SLOPE  # the step of the search
    np.testing.assert_allclose(placed.front.corners_m, textured.corners_m, atol=0.01)
    assert placed.disparity_slope == pytest.approx(SLOPE, rel=1e-3)
    # On the ray of the centre, (0.1, 0.1, 40) m, a shrinks and b grows with s.
    np.testing.assert_allclose(placed.offset_slope, [-0.1 / 40, 0.1 / 40], rtol=0.02)
    assert placed.s_std_m == pytest.approx(0.7 * np.sqrt(2 / 4) / SLOPE, rel=1e-3)
    assert placed.cross_ncc > 0.97


def test_views_measure_depth_better_than_scattered_quads(textured, pair):
    """Quads are wrong by their 1-sigma in depth, either way; the offsets stay on the ray."""
    start = textured.start(pair, POSE)
    by_quads_m = start.front.std_px * np.sqrt(2 / 4) / SLOPE
    for sign in (-1, 1):
        off = moved(start.front, right=(sign * by_quads_m * SLOPE, 0.0))
        placed = place_front(replace(start, front=off), GRID)
        assert abs(placed.pose[0] - POSE[0]) < 0.4 / SLOPE < by_quads_m
        along = placed.pose[0] - POSE[0]
        np.testing.assert_allclose(placed.pose[1:], POSE[1:] + along * placed.offset_slope,
                                   atol=1e-3)


@pytest.mark.parametrize('left, right, what, found', [
    ((0.0, 0.0), (0.0, 12.0), 'left and right quads', 'px apart'),
    ((0.0, 0.0), (60.0, 0.0), 'left and right quads', 'no point in front of the cameras'),
    ((30.0, -60.0), (30.0, -60.0), 'left-right correlation', '0.0'),
])
def test_invalid_fronts_are_refused_with_a_reason(textured, pair, left, right, what, found):
    start = textured.start(pair, POSE)
    # Beside the front there is noise, which the views do not have in common.
    refused = place_front(replace(start, front=moved(start.front, left, right)), GRID)
    assert isinstance(refused, Refusal) and refused.where == 'pair 3: first front'
    assert refused.what == what and found in refused.found
    with pytest.raises(InputError, match=what):
        raise refused.error()


def test_limits_of_the_start_are_parameters(textured, pair):
    start = textured.start(pair, POSE, TrackerConfig(start=StartConfig(most_gap_px=20.0)))
    assert isinstance(place_front(
        replace(start, front=moved(start.front, right=(0.0, 12.0))), GRID), (Placement, Refusal))
    strict = textured.start(pair, POSE, TrackerConfig(start=StartConfig(least_ncc=0.9999)))
    assert place_front(strict, GRID).wanted.startswith('above 0.9999')


def test_right_view_of_a_later_time_gives_the_same_position(textured):
    """40 ms later the front is 0.8 m further on, at an expected speed of 20 m/s."""
    then = POSE + [0.8, 0, 0]
    late = textured.pair(0, 0, POSE, right_ns=40_000_000, right_pose=then)
    start = textured.start(late, POSE)
    front = replace(start.front, right_px=textured.quads(then)[1])
    placed = place_front(replace(start, front=front), GRID)
    assert abs(placed.pose[0] - POSE[0]) < 0.3 / SLOPE and placed.cross_ncc > 0.97


def placement(textured, config):
    start = textured.start(textured.pair(0, 0, POSE), POSE, config)
    return start, place_front(start, GRID)


def test_first_particles_lie_on_the_ray_with_likely_speeds(textured):
    config = TrackerConfig(particles=4000, start=StartConfig(any_speed_share=0.0),
                           initial_speed_std=0.1)
    start, placed = placement(textured, config)
    states = first_states(start, placed, 0.5)
    n = len(states)
    assert n == 4000
    z = (states[:, 0].mean() - placed.pose[0]) / (0.5 / np.sqrt(n))
    assert abs(z) < 4
    np.testing.assert_allclose(states[:, 1:3] - placed.pose[1:],
                               np.outer(states[:, 0] - placed.pose[0], placed.offset_slope))
    assert stats.kstest(states[:, 3], stats.norm(20.0, 2.0).cdf).pvalue > 1e-3


@pytest.mark.parametrize('share, factor', [(0.25, 2.5), (1.0, 1.5)])
def test_some_of_the_first_particles_have_any_speed(textured, share, factor):
    config = TrackerConfig(
        particles=2000, initial_speed_std=0.01,
        start=StartConfig(any_speed_share=share, any_speed_factor=factor))
    start, placed = placement(textured, config)
    speed = first_states(start, placed, 0.5)[:int(2000 * share), 3]
    assert stats.kstest(speed, stats.uniform(0.0, factor * 20.0).cdf).pvalue > 1e-3


@pytest.mark.parametrize('side', ['left', 'right'])
def test_annotation_outside_its_image_names_the_side(textured, side):
    left, right = textured.quads(POSE)
    check_annotation(textured.rig, InitialFront(2, left, right), 'init.yaml')
    outside = moved(InitialFront(2, left, right), **{side: (300.0, 0.0)})
    with pytest.raises(InputError, match=f'init.yaml.*frame 2: {side}_image'):
        check_annotation(textured.rig, outside, 'init.yaml')
