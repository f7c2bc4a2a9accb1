# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The life of a track by hand, one pair every half second."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.passes import TrackEnd
from stereo_speed.core.records import TrackState
from stereo_speed.core.tracker_config import TrackerConfig, VisibilityConfig
from stereo_speed.tracking.life import extent_px, TrackLife

POSE = np.array([20.0, 0.1, 1.9])
LIMITS = VisibilityConfig(confirm_pairs=3, lost_after_s=1.0, occluded_for_s=2.0)


@pytest.fixture()
def life(textured, empty):
    return TrackLife(textured.start(empty, POSE, TrackerConfig(visibility=LIMITS)))


@pytest.fixture()
def empty(textured_drive):
    return textured_drive[0][0]


@pytest.fixture()
def at(empty):
    return lambda k: replace(empty, index=k, stamp_ns=k * 500_000_000)


def test_track_is_confirmed_after_enough_pairs_however_spread(life, at, textured):
    left, _ = textured.quads(POSE)
    assert [life.seen(at(0), left), life.seen(at(1), left)] == [TrackState.TENTATIVE] * 2
    assert life.coasts(at(2))
    assert life.seen(at(3), left) is TrackState.CONFIRMED
    assert life.stamps_ns == [0, 500_000_000, 1_500_000_000] and life.end is None


def test_extent_is_the_maximum(life, at, textured):
    for k, s in enumerate((20.0, 30.0, 10.0)):
        life.seen(at(k), textured.quads((s, 0.1, 1.9))[0])
    assert life.extent_px == pytest.approx(1.8 * 1500 / 30)


def test_time_advances_from_pair_to_pair(life, at):
    assert [life.advance_s(at(k)) for k in (0, 1, 4)] == [0.0, 0.5, 1.5]


@pytest.mark.parametrize('partly_seen, pairs', [(False, 2), (True, 4)])
def test_track_is_lost_when_unseen_or_occluded_for_too_long(
        life, at, textured, partly_seen, pairs):
    life.seen(at(0), textured.quads(POSE)[0])
    goes_on = [life.coasts(at(k), partly_seen=partly_seen) for k in range(1, pairs + 2)]
    assert goes_on == [True] * pairs + [False] and life.end is TrackEnd.LOST


def test_track_that_was_never_seen_is_lost_too(life, at):
    assert [life.coasts(at(k)) for k in (0, 1, 2, 3)] == [True, True, True, False]
    assert life.first_ns == 0 and life.stamps_ns == []


@pytest.mark.parametrize('shift', [(0.0, 0.0), (-300.0, 0.0), (0.0, 200.0), (np.nan, np.nan)])
@pytest.mark.parametrize('side', [0, 1])
def test_vehicle_leaves_with_its_first_corner_outside_an_image(life, textured, shift, side):
    quads = list(textured.quads(POSE))
    quads[side] = quads[side].copy()
    quads[side][2] += shift
    left = life.leaves_view(*quads)
    assert left == (shift != (0.0, 0.0))
    assert life.end is (TrackEnd.LEFT_VIEW if left else None)


@pytest.mark.parametrize(('seen_m', 'now_m', 'too_far'), [
    ((), 5.0, False), ((5.0,), 6.0, False), ((5.0, 20.0), 8.0, True), ((20.0,), 5.0, True),
    ((20.0,), 15.0, False), ((5.0,), -2.0, True), ((5.0,), 4.0, False)])
def test_only_a_receding_vehicle_becomes_too_far(textured, empty, at, seen_m, now_m, too_far):
    """At s its front is 1.8 m * 1500 px / (60 m - s) wide: 44 px at -2, 49 at 5, 52 at 8."""
    life = TrackLife(textured.start(empty, POSE, TrackerConfig(visibility=VisibilityConfig(
        least_width_px=53.0))))
    for k, s_m in enumerate(seen_m):
        life.seen(at(k), textured.quads((s_m, 0.1, 1.9))[0])
    assert life.is_too_far(textured.quads((now_m, 0.1, 1.9))[0]) == too_far


def test_extent_of_a_tall_front_is_its_height():
    upright = np.array([[10.0, 20], [27, 21], [28, 52], [11, 51]])  # 17 or 18 px wide
    assert extent_px(upright) == pytest.approx(32.0)
    assert extent_px(upright[:, ::-1]) == pytest.approx(32.0)
