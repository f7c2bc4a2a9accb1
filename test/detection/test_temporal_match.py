# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The position of a drawn front in an earlier pair, and its similarity there."""
from __future__ import annotations

from dataclasses import replace

from drawn_fronts import Front, HALF_M, LANE, NOISE, pair_of, pyramids_of, RIG, SPEED_MPS
import numpy as np
import pytest
from stereo_speed.detection.config import FrontConfig, MotionConfig
from stereo_speed.detection.front_sampler import FrontHypothesis, FrontSampler
from stereo_speed.detection.lane_geometry import LaneGeometry
from stereo_speed.detection.temporal_match import (
    find_motion, find_travel, Interval, Motion, moved, moving_half)

STEP_M = 0.2 * SPEED_MPS
AT = Front(30.0)
SEEN = FrontHypothesis(s_m=AT.s_m, x_m=AT.x_m, half_m=HALF_M)
CONFIG = MotionConfig()


@pytest.fixture(scope='module')
def sampler():
    front = FrontConfig()
    return FrontSampler(LaneGeometry(RIG, LANE), front.low_m, front.high_m)


@pytest.fixture(scope='module')
def now():
    return pyramids_of(pair_of([AT], 1))


def before(**changes):
    return pyramids_of(pair_of([replace(AT, **{'s_m': AT.s_m - STEP_M, **changes})]))


def bound_m(sampler, px=0.5):
    """Return the displacement along the lane for a shift of half a pixel in the left view."""
    rates = sampler.geometry.rates(np.array([AT.s_m - STEP_M]))
    return px / float(np.abs(rates.px_per_m * rates.climb)[0])


@pytest.mark.parametrize('aside_m', [0.0, 0.3, -0.45])
def test_earlier_place_of_a_front_is_found(sampler, now, aside_m):
    motion = find_motion(sampler, SEEN, Interval(now, before(x_m=aside_m)), CONFIG)
    assert motion.gone_m == pytest.approx(STEP_M, abs=bound_m(sampler))
    assert motion.aside_m == pytest.approx(aside_m, abs=0.03)
    assert motion.speed_mps == pytest.approx(motion.gone_m / 0.2)
    assert motion.ncc > 0.9 > motion.still_ncc + CONFIG.still_margin
    ends = [sampler.geometry.project(np.array([s]), np.array([x]), sampler.heights_m[:1])[0]
            for s, x in ((AT.s_m, 0.0), (AT.s_m - STEP_M, aside_m))]
    assert motion.moved_px == pytest.approx(float(np.linalg.norm(ends[0] - ends[1])), abs=1.5)
    assert moved(motion, CONFIG)


def test_search_near_an_expected_motion_is_sufficient(sampler, now):
    interval = Interval(now, before())
    travel = find_travel(sampler, SEEN, interval, CONFIG, expected_m=0.9 * STEP_M)
    assert travel.gone_m == pytest.approx(STEP_M, abs=bound_m(sampler))


def test_front_is_followed_forward_as_well(sampler, now):
    earlier = before()
    there = replace(SEEN, s_m=AT.s_m - STEP_M)
    travel = find_travel(sampler, there, Interval(earlier, now), CONFIG, expected_m=-STEP_M)
    assert travel.gone_m == pytest.approx(-STEP_M, abs=bound_m(sampler))


def test_stationary_object_has_not_moved(sampler, now):
    motion = find_motion(sampler, SEEN, Interval(now, before(s_m=AT.s_m)), CONFIG)
    assert motion.gone_m < bound_m(sampler, 1.0) and not moved(motion, CONFIG)


@pytest.mark.parametrize('config', [
    MotionConfig(least_ncc=0.85), MotionConfig(least_px=13.0), MotionConfig(still_margin=0.15),
    MotionConfig(least_speed_mps=19.9, greatest_speed_mps=21.0),
    MotionConfig(least_speed_mps=19.0, greatest_speed_mps=19.5)], ids=range(5))
def test_each_limit_can_refuse_a_motion(config):
    motion = Motion(speed_mps=19.8, gone_m=4.0, aside_m=0.0, ncc=0.8, still_ncc=0.7, moved_px=12.0)
    assert moved(motion, CONFIG)
    assert not moved(motion, config)


def test_search_is_limited_to_plausible_lateral_motion(sampler, now):
    narrow = MotionConfig(aside_mps=0.0, aside_m=0.0)
    travel = find_travel(sampler, SEEN, Interval(now, before(x_m=0.6)), narrow)
    assert abs(travel.aside_m) <= 0.12 + 1e-9  # the fine search goes on by four samples


def test_whole_front_moves_as_one(sampler, now):
    interval = Interval(now, before())
    motion = find_motion(sampler, SEEN, interval, CONFIG)
    assert moving_half(sampler, SEEN, motion, interval, NOISE, CONFIG) \
        == pytest.approx(HALF_M, abs=0.07)


def test_surroundings_of_a_front_do_not_move_with_it(sampler, now):
    wide = replace(SEEN, half_m=1.2)
    interval = Interval(now, before())
    motion = find_motion(sampler, wide, interval, CONFIG)
    assert moving_half(sampler, wide, motion, interval, NOISE, CONFIG) \
        == pytest.approx(HALF_M, abs=0.1)


def test_front_occluded_in_its_middle_is_refused(sampler, now):
    interval = Interval(now, before(pole_m=0.25))
    motion = find_motion(sampler, SEEN, interval, CONFIG)
    assert moving_half(sampler, SEEN, motion, interval, NOISE, CONFIG) == 0.0
    lenient = MotionConfig(occluded_share=1.0)
    assert moving_half(sampler, SEEN, motion, interval, NOISE, lenient) > 0.0


def test_right_views_are_used_at_their_own_time(sampler):
    lag_s = 0.04
    late_m = lag_s * SPEED_MPS
    now, earlier = (pyramids_of(pair_of([f], k, [replace(f, s_m=f.s_m + late_m)], 40_000_000))
                    for k, f in ((1, AT), (0, replace(AT, s_m=AT.s_m - STEP_M))))
    interval = Interval(now, earlier)
    front = replace(SEEN, ahead_m=late_m)
    motion = find_motion(sampler, front, interval, CONFIG)
    assert moving_half(sampler, front, motion, interval, NOISE, CONFIG) \
        == pytest.approx(HALF_M, abs=0.07)
    wrong = Interval(now, replace(earlier, pair=earlier.pair.triggered(1.0)))
    assert moving_half(sampler, front, motion, wrong, NOISE, CONFIG) == 0.0
