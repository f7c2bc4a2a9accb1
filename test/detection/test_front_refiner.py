# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Refinement of proposals on drawn fronts: depth by disparity, middle and width by symmetry."""
from __future__ import annotations

from dataclasses import replace

from drawn_fronts import (
    depth_bound_m, Front, HALF_M, LANE, LANE_M, NOISE, pair_of, pyramids_of, RIG, SPEED_MPS,
    START_M)
import numpy as np
import pytest
from stereo_speed.detection.config import FrontConfig, MotionConfig
from stereo_speed.detection.front_refiner import FrontBatch, FrontKind, FrontRefiner
from stereo_speed.detection.front_sampler import FrontHypothesis, FrontSampler
from stereo_speed.detection.lane_geometry import LaneGeometry
from stereo_speed.detection.plane_sweep import Proposal
from stereo_speed.detection.temporal_match import Interval

STEP_M = 0.2 * SPEED_MPS
AT = Front(30.0, x_m=0.3)


def refiner_of(front=FrontConfig(), least_symmetry=None):
    sampler = FrontSampler(LaneGeometry(RIG, LANE), front.low_m, front.high_m)
    kind = FrontKind(front.low_m, front.high_m, front.least_width_m)
    return FrontRefiner(sampler.geometry, kind, front, MotionConfig(), least_symmetry)


def interval_of(front, late=None, lag_s=0.0):
    before = pair_of([replace(front, s_m=front.s_m - STEP_M)])
    now = pair_of([front], 1, None if late is None else [late], round(lag_s * 1e9))
    return Interval(pyramids_of(now), pyramids_of(before))


def on_ray(s_m):
    """Return the offset at which the ray to the front's middle meets another plane."""
    return (LANE_M + AT.x_m) * (START_M - s_m) / (START_M - AT.s_m) - LANE_M


@pytest.fixture(scope='module')
def interval():
    return interval_of(AT)


@pytest.mark.parametrize(('ds_m', 'dx_m'), [(0.0, 0.0), (2.0, -0.4), (-2.0, 0.6)])
@pytest.mark.parametrize('least_symmetry', [None, 0.6])
def test_proposal_becomes_the_front(interval, ds_m, dx_m, least_symmetry):
    refiner = refiner_of(least_symmetry=least_symmetry)
    front, = refiner.refine([Proposal(AT.s_m + ds_m, AT.x_m + dx_m)], interval, NOISE)
    assert abs(front.s_m - AT.s_m) < depth_bound_m(refiner.sampler.geometry, AT.s_m)
    assert abs(front.x_m - on_ray(front.s_m)) < 0.03  # a sample
    assert 0.5 < front.half_m <= HALF_M + 0.09  # within its outermost strong edges
    assert min(front.cross_ncc, front.symmetry) > 0.9
    assert front.ahead_m == 0.0


def test_proposals_of_one_front_become_one(interval):
    some = [Proposal(AT.s_m + d, AT.x_m + d / 10) for d in (-1.0, 0.0, 1.0)]
    assert len(refiner_of().refine(some, interval, NOISE)) == 1


def test_empty_road_gives_no_front(interval):
    found = refiner_of().refine([Proposal(AT.s_m - 15.0, -1.0)], interval, NOISE)
    assert all(f.cross_ncc < 0.75 or f.symmetry < 0.6 for f in found)
    assert refiner_of().refine([], interval, NOISE) == []


def test_dark_front_is_separated_from_its_shadow():
    """Most of the symmetry is about the middle of both together, which is no front."""
    dark = interval_of(replace(AT, light=0.12, shadow_m=1.6))
    some = [Proposal(AT.s_m + d, AT.x_m) for d in (-1.0, 0.5)]
    assert refiner_of(least_symmetry=None).refine(some, dark, NOISE) == []
    front, = refiner_of(least_symmetry=0.6).refine(some, dark, NOISE)
    assert abs(front.s_m - AT.s_m) < depth_bound_m(LaneGeometry(RIG, LANE), AT.s_m)
    assert abs(front.x_m - on_ray(front.s_m)) < 0.03


@pytest.mark.parametrize('lag_s', [-0.04, 1 / 60, 0.05])
def test_right_view_of_a_later_time_gives_the_same_front(lag_s):
    gone_m = lag_s * SPEED_MPS
    late = replace(AT, s_m=AT.s_m + gone_m)
    refiner = refiner_of()
    some = [Proposal(AT.s_m + 2.0, AT.x_m + 0.3, ahead_m=gone_m + 0.2)]
    front, = refiner.refine(some, interval_of(AT, late, lag_s), NOISE)
    rates = refiner.sampler.geometry.rates(np.array([AT.s_m]))
    # The speed between the left views, good to half a pixel, errs the depth by its own share.
    speed_std = 0.5 / (0.2 * float(np.abs(rates.px_per_m * rates.climb)[0]))
    more_m = abs(float((rates.slide / rates.shift)[0]) * lag_s) * speed_std
    assert abs(front.ahead_m - gone_m) < abs(lag_s) * speed_std
    assert abs(front.s_m - AT.s_m) < depth_bound_m(refiner.sampler.geometry, AT.s_m) + more_m
    assert abs(front.x_m - on_ray(front.s_m)) < 0.06


def test_asymmetric_front_keeps_the_given_middle():
    lopsided = replace(AT, symmetric=False)
    front, = refiner_of().refine([Proposal(AT.s_m + 2.0, AT.x_m, half_m=0.8)],
                                 interval_of(lopsided), NOISE, symmetric=False)
    assert (front.x_m, front.half_m) == (AT.x_m, 0.8)
    assert abs(front.s_m - AT.s_m) < depth_bound_m(LaneGeometry(RIG, LANE), AT.s_m)
    assert front.cross_ncc > 0.9


def test_upright_fronts_are_separated_from_flat_markings(interval):
    refiner = refiner_of()
    front, = refiner.refine([Proposal(AT.s_m, AT.x_m)], interval, NOISE)
    assert 1 - refiner.lying_ncc(front, interval.now) > 2 * (1 - front.cross_ncc)
    # Through a plane some metres in front of it a painted marking on the road is visible.
    lying = pyramids_of(pair_of([replace(AT, lying=True)], 1))
    assert max(refiner.lying_ncc(replace(front, s_m=AT.s_m + d), lying)
               for d in np.arange(0.0, 6.0, 0.5)) > 0.9


@pytest.mark.parametrize(('behind_m', 'limits', 'is_one'), [
    (0.0, {}, True),
    (1.0, {}, True),  # 0.4 px
    (2.5, {}, True),  # 0.9 px
    (3.5, {}, False),  # 1.2 px
    (6.0, {}, False),  # 2.0 px
    (6.0, {'apart_px': 2.5}, True), (6.0, {'apart_m': 8.0}, True)])
@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_halves_at_two_depths_are_two_vehicles(behind_m, limits, is_one, side):
    """Half a front, and beside it another half that is seen there but stands farther away."""
    nearer = (START_M - AT.s_m) / (START_M - AT.s_m + behind_m)
    middle_m = LANE_M + 0.45 * side  # of the other half, as seen on the plane of the first
    other = Front(AT.s_m - behind_m, middle_m / nearer - LANE_M, half_m=0.45 / nearer,
                  low_m=-2.0)  # as the cameras are too high to see much of it else
    pair = pyramids_of(pair_of([other, Front(AT.s_m, -0.45 * side, half_m=0.45)], 1))
    front = FrontHypothesis(AT.s_m, 0.0, 0.9)
    assert refiner_of(FrontConfig(**limits)).is_one_body(front, pair) is is_one


@pytest.mark.parametrize('light', [0.0, 1e3], ids=['black', 'clipped'])
@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_half_without_details_belongs_to_the_other(light, side):
    halves = [Front(AT.s_m, 0.45 * side, half_m=0.45, light=light),
              Front(AT.s_m, -0.45 * side, half_m=0.45)]
    front = FrontHypothesis(AT.s_m, 0.0, 0.9)
    assert all(refiner_of().is_one_body(front, pyramids_of(pair_of(halves, k)))
               for k in range(8))


def test_hopeless_proposals_are_dropped():
    config = FrontConfig(hopeless_ncc=1.0)
    some = [Proposal(AT.s_m + 3.0, AT.x_m)]
    assert refiner_of(config).refine(some, interval_of(AT), NOISE) == []


def test_batch_is_indexed_by_masks_and_numbers():
    batch = FrontBatch.of([Proposal(float(k), 0.1 * k, ahead_m=-float(k)) for k in range(4)])
    assert batch.take(np.array([True, False, False, True])).s_m.tolist() == [0.0, 3.0]
    assert [h.ahead_m for h in batch.take(np.array([2, 1])).hypotheses()] == [-2.0, -1.0]
    assert len(batch.take(np.zeros(0, dtype=np.int64))) == 0
