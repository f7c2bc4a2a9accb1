# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Proposals of the plane sweep on one drawn front."""
from __future__ import annotations

from dataclasses import replace

from drawn_fronts import Front, HALF_M, LANE, NOISE, pair_of, pyramids_of, RIG, SPEED_MPS
import numpy as np
import pytest
from stereo_speed.detection.config import DetectorConfig, SweepConfig
from stereo_speed.detection.lane_geometry import LaneGeometry
from stereo_speed.detection.plane_sweep import PlaneSweep

STEP_M = 0.2 * SPEED_MPS
AT = Front(30.0, x_m=0.3)
BEFORE = replace(AT, s_m=AT.s_m - STEP_M)


@pytest.fixture(scope='module')
def geometry():
    return LaneGeometry(RIG, LANE)


@pytest.fixture(scope='module')
def sweep(geometry):
    return PlaneSweep(geometry, DetectorConfig())


@pytest.fixture(scope='module')
def before():
    return pyramids_of(pair_of([BEFORE]))


@pytest.fixture(scope='module')
def now():
    return pyramids_of(pair_of([AT], 1))


def test_planes_are_evenly_spaced_in_the_right_view(sweep, geometry):
    shift = np.cumsum(np.abs(geometry.rates(sweep.s_m).shift) * np.gradient(sweep.s_m))
    steps = np.diff(shift)
    assert len(steps) > 10 and np.ptp(steps) < 0.1 * steps.mean()


def test_moving_front_is_proposed_first(sweep, now, before):
    first = sweep.proposals(now, before, NOISE)[0]
    plane_m = np.abs(np.diff(sweep.s_m)).max()
    assert abs(first.s_m - AT.s_m) <= plane_m
    assert abs(first.x_m - AT.x_m) < HALF_M  # its window shows more of the front than of the road
    assert first.ahead_m == 0.0 and first.votes > 2.0


def test_stationary_object_is_not_proposed(sweep, now):
    again = pyramids_of(pair_of([AT], 2))
    assert sweep.proposals(again, now, NOISE) == []


def test_flat_marking_gets_fewer_votes(sweep, now, before):
    lying = [pyramids_of(pair_of([replace(f, lying=True)], k))
             for k, f in enumerate((BEFORE, AT))]
    votes = [p.votes for p in sweep.proposals(lying[1], lying[0], NOISE)]
    assert max(votes, default=0.0) < 0.7 * sweep.proposals(now, before, NOISE)[0].votes


@pytest.mark.parametrize('lag_s', [-0.04, 1 / 60, 0.05])
def test_right_view_of_a_later_time_is_searched_over_speeds(sweep, geometry, before, lag_s):
    gone_m = lag_s * SPEED_MPS
    now = pyramids_of(pair_of([AT], 1, [replace(AT, s_m=AT.s_m + gone_m)], round(lag_s * 1e9)))
    proposals = sweep.proposals(now, before, NOISE)
    best = min(proposals, key=lambda p: abs(p.s_m - AT.s_m))
    # Half a step between speeds shifts the right view by 4 cm: refining bridges three times that.
    rates = geometry.rates(np.array([AT.s_m]))
    assert abs(best.ahead_m - gone_m) < 0.08 / abs(float(rates.slide[0]))
    assert abs(best.s_m - AT.s_m) < 0.08 / abs(float(rates.shift[0]))
    at_once = replace(now, pair=now.pair.triggered(1.0))
    assert {p.ahead_m for p in sweep.proposals(at_once, before, NOISE)} <= {0.0}


@pytest.mark.parametrize('limits', [
    SweepConfig(least_contrast=100.0), SweepConfig(noise_factor=20.0),
    SweepConfig(still_ncc=-1.0), SweepConfig(least_ncc=1.0), SweepConfig(least_votes=100.0),
    SweepConfig(least_px_per_m=500.0)], ids=lambda limits: str(limits)[12:40])
def test_each_limit_can_forbid_every_proposal(geometry, now, before, limits):
    sweep = PlaneSweep(geometry, DetectorConfig(sweep=limits))
    assert sweep.proposals(now, before, 5 * NOISE) == []


def test_number_of_proposals_is_limited(geometry, sweep, now, before):
    two = pyramids_of(pair_of([AT, Front(15.0)], 1))
    assert len(sweep.proposals(two, before, NOISE)) >= 2
    one = PlaneSweep(geometry, DetectorConfig(sweep=SweepConfig(most_proposals=1)))
    assert len(one.proposals(two, before, NOISE)) == 1
