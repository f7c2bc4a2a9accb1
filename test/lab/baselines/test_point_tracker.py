# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Point trackers on fronts whose points have Gaussian errors, without images."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from stereo_speed.core.records import TrackState
from stereo_speed.lab.baselines.point_tracker import PointTracker
from stereo_speed.lab.baselines.points import Points
from stereo_speed.lab.baselines.settings import PointSettings, SiftSettings
from stereo_speed.lab.baselines.triangulation import TriangulationTracker

RUNS, PAIRS = 25, 8


class Filtering(PointTracker[PointSettings]):
    """Only the common part, with a given source."""

    Settings = PointSettings
    source_given = None

    def _source(self):
        return self.source_given


class Triangulating(TriangulationTracker):
    """The same for ``triangulation``."""

    source_given = None

    def _source(self):
        return self.source_given


@pytest.fixture
def tracker(scene):
    """Make a tracker of a scene; other sources transform the scene by a function."""
    def make(kind=Filtering, seen=None, settings=None, **changes):
        world = scene(**changes)

        class Source:
            def observe(self, pair, expected):
                points = world.observe(pair, expected)
                return points if seen is None else seen(pair, points)
        given = type('Given', (kind,), {'source_given': Source()})
        return world, given(world.start, world.placed, settings or kind.Settings())
    return make


@pytest.mark.slow
@pytest.mark.parametrize('kind', [Filtering, Triangulating])
def test_errors_match_their_covariances(tracker, kind):
    """Sums of normalised squares over many runs are below chi-square, but not far below."""
    live, along, whole = 0.0, 0.0, 0.0
    for seed in range(RUNS):
        world, one = tracker(kind, seed=seed, focal_std=0.0, baseline_std_m=0.0)
        last = world.run(one, PAIRS)[-1]
        off = last.position_m - world.centre_m(last.stamp_ns)
        along += off[2] ** 2 / last.position_cov_m2[2, 2]
        live += ((last.speed_mps - world.speed_mps) / last.speed_std_mps) ** 2
        result = one.result()
        whole += ((result.speed_mps - world.speed_mps) / result.speed_std_mps) ** 2
    # The models allow for braking, bends and bounces, which this vehicle does without.
    assert 0.05 * RUNS < live < chi2.isf(1e-4, RUNS)
    assert 0.05 * RUNS < along < chi2.isf(1e-4, RUNS)
    assert 0.05 * RUNS < whole < chi2.isf(1e-4, RUNS)


def test_pass_is_more_certain_than_from_its_first_and_last_position(tracker):
    world, one = tracker()
    world.run(one, PAIRS)
    ends = [one.filtered[0].cov, one.filtered[-1].cov]
    duration_s = 0.2 * (PAIRS - 1)
    naive = np.sqrt(sum(cov[2, 2] for cov in ends)) / duration_s
    assert one.result().speed_std_mps < naive


def test_life_of_a_track(tracker):
    world, one = tracker()
    updates = world.run(one, 4)
    assert [u.state for u in updates] == [TrackState.TENTATIVE] * 2 + [TrackState.CONFIRMED] * 2
    assert [u.s_m for u in updates] == pytest.approx([20, 24, 28, 32], abs=1.0)
    assert {u.track for u in updates} == {7} and {u.lane for u in updates} == {'lane'}
    np.testing.assert_allclose(updates[-1].axes, world.axes, atol=0.1)


@pytest.mark.parametrize('kind', [Filtering, Triangulating])
def test_pairs_without_points_coast(tracker, kind):
    def seen(pair, points):
        return points.only(np.full(len(points.ids), pair.index not in (4, 5)))
    world, one = tracker(kind, seen)
    updates = world.run(one, 8)
    assert [k for k, u in enumerate(updates) if u.state is TrackState.COASTING] == [4, 5]
    result = one.result()
    assert result.pairs == len(result.smoothed) == 6
    assert abs(result.speed_mps - world.speed_mps) < 4 * result.speed_std_mps


def test_background_points_are_dropped(tracker):
    rng = np.random.default_rng(0)

    def seen(pair, points):
        still = world.rig.project(world.centre_m(0) + background)
        return Points(np.append(points.ids, 100 + np.arange(8)),
                      np.vstack([points.left, still[0]]), np.vstack([points.right, still[1]]))
    background = rng.uniform([-2, -1, 20], [2, 1, 40], (8, 3))
    world, one = tracker(seen=seen)
    last = world.run(one, PAIRS)[-1]
    assert abs(last.speed_mps - world.speed_mps) < 4 * last.speed_std_mps


def test_position_beyond_any_motion_is_not_the_vehicle(tracker):
    def seen(pair, points):
        jump = np.array([10.0 if pair.index == 5 else 0.0, 0])  # 10 px of disparity
        return replace(points, right=points.right - jump)
    world, one = tracker(seen=seen)
    assert [u.state for u in world.run(one, 8)][5] is TrackState.COASTING
    world, one = tracker(seen=seen, settings=PointSettings(most_distance2=1e4, jolt_std_m=5.0))
    assert [u.state for u in world.run(one, 8)][5] is TrackState.CONFIRMED


def test_sources_get_8_bit_images(tracker):
    depths = []

    def seen(pair, points):
        depths.extend([pair.left.dtype, pair.right.dtype])
        return points
    world, one = tracker(seen=seen)
    one.update(world.pair(0, np.uint16))
    assert depths == [np.uint8, np.uint8]


def test_late_right_view_counts_at_its_own_time(tracker):
    world, one = tracker()
    _, late = tracker()
    for k in range(5):
        pair = world.pair(k)
        there = one.update(pair)
        here = late.update(replace(pair, right_stamp_ns=pair.stamp_ns + 20_000_000))
    # As later ones, the right pixels are moved back by the motion of 20 ms, which makes the
    # disparity f b / Z greater by the motion's part across the right view, and the front nearer.
    centre = world.centre_m(pair.stamp_ns)
    motion_px = np.diff(world.rig.project(np.array([centre, centre - [0, 0, 0.4]]))[1][:, 0])[0]
    nearer_m = motion_px * centre[2] ** 2 / (1800 * 0.5)
    off = here.position_m[2] - there.position_m[2]
    assert off == pytest.approx(-nearer_m, abs=0.2 * nearer_m)


def test_triangulation_reports_the_motion_between_two_pairs(tracker):
    world, one = tracker(Triangulating, std_px=0.001,
                         settings=SiftSettings(match_std_px=0.01, common_std_px=0.0))
    updates = world.run(one, 5)
    assert [u.speed_mps for u in updates[2:]] == pytest.approx([20.0] * 3, abs=0.02)
