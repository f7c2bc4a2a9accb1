# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The constrained tracker on a closed-form front, and on simulated passes with exact truth."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from stereo_speed.core.config import NoParameters, parameters_of
from stereo_speed.core.errors import InputError
from stereo_speed.core.passes import TrackEnd, Verdict
from stereo_speed.core.records import TrackState
from stereo_speed.core.tracker_config import EffortConfig, TrackerConfig, VisibilityConfig
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.sim.config import straight_config
from stereo_speed.lab.sim.sequence import simulate
from stereo_speed.pipeline.assembly import make_pipeline
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.track import with_unnoticed
from stereo_speed.tracking.constrained import ConstrainedTracker, may_follow
from stereo_speed.tracking.protocol import MOST_TIMES, OLD_S, Refusal, TrackStart

MPS = 20.0
SECOND = 1_000_000_000
QUICK = TrackerConfig(samples_per_part=4, particles=200)
SMALL = replace(QUICK, parts=4, particles=50, effort=EffortConfig(4, 4, 20))
COASTING, CONFIRMED, TENTATIVE = TrackState.COASTING, TrackState.CONFIRMED, TrackState.TENTATIVE


def at_most(level, errors):
    """Return the bound, in sigmas, on the largest of ``n`` normal errors at a level."""
    return stats.norm.isf(level / (2 * errors))


@pytest.fixture(scope='module')
def follow(textured):
    """Return a function that tracks pairs from the first pose, to updates and tracker."""
    def followed(pairs, pose, config=QUICK, seed=0, **changes):
        tracker = ConstrainedTracker.start(
            textured.start(pairs[0], pose, config, seed, **changes), NoParameters())
        updates = [tracker.update(pair) for pair in pairs]
        return [update for update in updates if update is not None], tracker
    return followed


@pytest.fixture(scope='module')
def steady(follow, textured_drive):
    """Return the updates and the tracker of the steady drive."""
    pairs, poses = textured_drive
    return follow(pairs, poses[0])


def blank(pair):
    grey = np.full_like(pair.left, 1600)
    return replace(pair, left=grey, right=grey)


def behind_a_post(pair, share=0.4, nearer_px=6):
    """
    Return a pair in which a striped post hides a share of the front, from the left.

    :param nearer_px: by which its disparity exceeds that of the front.
    """
    images = []
    for image, shift_px in ((pair.left, 0), (pair.right, nearer_px)):
        columns = np.flatnonzero(image.std(axis=0) > 60)
        end = columns[0] + int(share * len(columns)) - shift_px
        covered = slice(columns[0] - 3 - shift_px, end)
        image = image.copy()
        image[:, covered] = 16 * (90 + 60 * (np.arange(len(image)) // 5 % 2))[:, None]
        images.append(image)
    return replace(pair, left=images[0], right=images[1])


def test_readings_and_pass_speed_are_within_their_sigma(steady, textured_drive):
    updates, tracker = steady
    poses = textured_drive[1]
    assert [u.state for u in updates] == [TENTATIVE] * 2 + [CONFIRMED] * 10
    z = [(u.speed_mps - MPS) / u.speed_std_mps for u in updates]
    assert np.abs(z).max() < at_most(0.001, len(z))
    for update, (s, a, b) in zip(updates[2:], poses[2:]):
        error = update.position_m - [a, 2 - b, 60 - s]
        square = error @ np.linalg.solve(update.position_cov_m2, error)
        assert square < stats.chi2.isf(0.001 / 10, 3)
        assert update.s_m == pytest.approx(60 - update.position_m[2])
    result = tracker.result()
    assert result.verdict is Verdict.MEASURED and result.pairs == 12
    assert abs(result.speed_mps - MPS) < at_most(0.001, 1) * result.speed_std_mps < 0.4
    assert result.end is TrackEnd.STREAM_ENDED and result.budget.total_mps == pytest.approx(
        result.speed_std_mps)


def test_quads_are_those_of_the_front(steady, textured, textured_drive):
    for update, pose in list(zip(steady[0], textured_drive[1]))[2:]:
        for got, want in zip((update.quad_left_px, update.quad_right_px), textured.quads(pose)):
            np.testing.assert_allclose(got, want, atol=0.5)
        np.testing.assert_allclose(update.axes, textured.path.frame(np.array(pose[0])), atol=1e-3)


def test_result_can_be_queried_without_side_effects(follow, textured_drive):
    pairs, poses = textured_drive
    updates, tracker = follow(pairs[:8], poses[0])
    first, again = tracker.result(), tracker.result()
    assert first.smoothed == again.smoothed and first.budget == again.budget
    silent = follow(pairs[:9], poses[0])[0]
    assert tracker.update(pairs[8]).speed_mps == silent[-1].speed_mps


def test_same_seed_repeats_readings_and_other_seeds_agree(follow, steady, textured_drive):
    pairs, poses = textured_drive
    first, again, other = (np.array([u.speed_mps for u in updates]) for updates in (
        steady[0], follow(pairs[:6], poses[0])[0], follow(pairs, poses[0], seed=6)[0]))
    np.testing.assert_array_equal(first[:6], again)
    assert np.any(first != other)
    stds = np.array([u.speed_std_mps for u in steady[0]])
    assert np.all(np.abs(first - other)[2:] < stds[2:])


def test_vehicle_is_found_again_after_pairs_that_do_not_show_it(follow, textured_drive):
    pairs, poses = textured_drive
    hidden = [blank(p) if p.index in (5, 6) else p for p in pairs]
    updates, tracker = follow(hidden, poses[0])
    states = [u.state for u in updates]
    assert [k for k, s in enumerate(states) if s is COASTING] == [5, 6]
    assert states[7:9] == [TENTATIVE, CONFIRMED]
    result = tracker.result()
    assert result.pairs == len(pairs) - 2 and result.verdict is Verdict.MEASURED
    assert abs(result.speed_mps - MPS) < at_most(0.001, 1) * result.speed_std_mps


def test_partial_occlusion_does_not_bias_the_track(follow, steady, textured_drive):
    pairs, poses = textured_drive
    occluded = [behind_a_post(p) if p.index in (5, 6, 7) else p for p in pairs]
    updates, tracker = follow(occluded, poses[0])
    assert [k for k, u in enumerate(updates) if u.state is COASTING] == [5, 6, 7]
    result = tracker.result()
    assert result.verdict is Verdict.MEASURED and result.pairs == len(pairs) - 3
    assert abs(result.speed_mps - MPS) < at_most(0.001, 1) * result.speed_std_mps
    for update, clear in list(zip(updates, steady[0]))[9:]:
        std = np.sqrt(np.trace(update.position_cov_m2))
        assert np.linalg.norm(update.position_m - clear.position_m) < 3 * std


def test_front_that_stays_partly_occluded_is_lost(follow, textured_drive):
    pairs, poses = textured_drive
    config = replace(QUICK, visibility=VisibilityConfig(occluded_for_s=0.35))
    occluded = [behind_a_post(p) if p.index > 4 else p for p in pairs]
    updates, tracker = follow(occluded, poses[0], config)
    assert tracker.ended and tracker.result().end is TrackEnd.LOST
    assert len(updates) == 8 and updates[-1].state is COASTING
    assert tracker.update(pairs[-1]) is None


def test_a_vehicle_lost_for_good_ends_its_track(follow, textured_drive):
    pairs, poses = textured_drive
    config = replace(QUICK, visibility=VisibilityConfig(lost_after_s=0.45))
    updates, tracker = follow([blank(p) if p.index > 1 else p for p in pairs], poses[0], config)
    result = tracker.result()
    assert len(updates) == 6 and result.pairs == 2 and result.end is TrackEnd.LOST
    assert {u.state for u in updates} == {TENTATIVE, COASTING}


def test_vehicle_that_was_never_seen_has_no_result(textured, textured_drive):
    pairs, poses = textured_drive
    tracker = ConstrainedTracker.start(
        textured.start(pairs[0], poses[0], QUICK), NoParameters())
    for pair in pairs[:4]:  # it started in a good pair, but is given others
        tracker.update(blank(pair))
    result = tracker.result()
    assert (result.verdict, result.reason, result.pairs) == (
        Verdict.REJECTED, 'never_seen', 0)
    assert result.first_ns == pairs[0].stamp_ns


def test_track_ends_when_the_vehicle_leaves_the_view(follow, textured):
    pairs, poses = textured.drive(12, speed_mps=30.0, pose=(30.0, 1.0, 1.9))
    updates, tracker = follow(pairs, poses[0])
    # Its corner 1.9 m beside the axis leaves the right half, 160 px of a focal length of 1500,
    # 17.8 m away.
    assert len(updates) == sum(60 - pose[0] > 1.9 * 1500 / 160 for pose in poses)
    assert tracker.result().end is TrackEnd.LEFT_VIEW


def test_track_ends_far_beyond_the_end_of_the_path(follow, textured, textured_drive):
    pairs, poses = textured_drive
    config = replace(QUICK, visibility=VisibilityConfig(beyond_path_m=0.0))
    start = textured.start(pairs[0], poses[0], config)
    short = type(textured.path)(np.array([0.0, 2, 60]), np.array([0.0, 0, -1]), 15.0)
    tracker = ConstrainedTracker.start(
        replace(start, lane=replace(textured.lane, path=short)), NoParameters())
    updates = [tracker.update(pair) for pair in pairs]
    assert [u is None for u in updates] == [pose[0] > 15.0 for pose in poses]


def test_short_pass_is_rejected(follow, textured_drive):
    pairs, poses = textured_drive
    result = follow(pairs[:3], poses[0])[1].result()
    assert (result.verdict, result.reason) == (Verdict.REJECTED, 'too_few_pairs')


def test_long_passes_are_thinned_without_losing_stamps(follow, textured_drive):
    pairs, poses = textured_drive
    config = replace(QUICK, effort=EffortConfig(live_observations=5, pass_observations=8))
    updates, tracker = follow(pairs, poses[0], config)
    result = tracker.result()
    assert list(result.smoothed) == [u.stamp_ns for u in updates] == [p.stamp_ns for p in pairs]
    assert abs(result.speed_mps - MPS) < at_most(0.001, 1) * result.speed_std_mps


def test_braking_is_followed_and_the_profile_is_smooth(follow, textured):
    """
    Braking at 6 m/s^2 from 20 m/s after half a second, 10 pairs a second.

    One vehicle in twenty brakes in the first two pairs, which the 1-sigma does not cover.
    """
    times = np.arange(16) / 10
    late = np.maximum(times - 0.5, 0)
    speeds = MPS - 6 * late
    poses = np.column_stack([6 + MPS * times - 3 * late ** 2, np.full(16, 0.1), np.full(16, 1.9)])
    pairs = [textured.pair(k, round(t * SECOND), pose)
             for k, (t, pose) in enumerate(zip(times, poses))]
    updates, tracker = follow(pairs, poses[0])
    z = [(u.speed_mps - v) / u.speed_std_mps for u, v, t in zip(updates, speeds, times)
         if u.state is CONFIRMED and not 0.55 < t < 0.75]
    assert len(z) == 12 and np.abs(z).max() < at_most(0.001, len(z))
    result = tracker.result()
    smooth = [(result.smoothed[p.stamp_ns] - v) / result.smoothed_std[p.stamp_ns]
              for p, v in zip(pairs, speeds)]
    assert result.verdict is Verdict.MEASURED
    assert np.square(smooth).sum() < stats.chi2.isf(0.001, 16)
    assert np.ptp(list(result.smoothed.values())) == pytest.approx(6.0, abs=0.7)


def test_every_pair_of_a_slow_camera_is_solved(follow, steady, textured_drive):
    pairs, poses = textured_drive
    config = replace(QUICK, effort=EffortConfig(solve_interval_s=0.0))
    for update, other in zip(steady[0], follow(pairs[:6], poses[0], config)[0]):
        assert (update.speed_mps, update.speed_std_mps) == (other.speed_mps, other.speed_std_mps)


SPARING = replace(QUICK, effort=EffortConfig(solve_interval_s=0.15))  # of 10 pairs a second


def test_readings_between_solutions_are_within_their_sigma(follow, steady, textured_drive):
    """From the third pair on every other pair is solved; all of them count."""
    pairs, poses = textured_drive
    updates, tracker = follow(pairs, poses[0], SPARING)
    assert [u.state for u in updates] == [TENTATIVE] * 2 + [CONFIRMED] * 10
    z = [(u.speed_mps - MPS) / u.speed_std_mps for u in updates]
    assert np.abs(z).max() < at_most(0.001, len(z))
    for update, (s, a, b) in zip(updates[2:], poses[2:]):
        error = update.position_m - [a, 2 - b, 60 - s]
        assert error @ np.linalg.solve(update.position_cov_m2, error) < stats.chi2.isf(
            0.001 / 10, 3)
    result, every = tracker.result(), steady[1].result()
    assert list(result.smoothed) == list(every.smoothed)
    assert abs(result.speed_mps - every.speed_mps) < 0.3 * every.speed_std_mps
    assert result.speed_std_mps == pytest.approx(every.speed_std_mps, rel=0.1)


@pytest.mark.parametrize(('alone', 'interval_s'), [(1, 0.15), (2, 0.075), (3, 0.05)])
def test_share_of_the_particles_is_also_the_share_of_the_solutions(
        follow, textured_drive, alone, interval_s):
    """Its readings equal those of a lone track with the same interval between solutions."""
    pairs, poses = textured_drive
    config = replace(QUICK, effort=EffortConfig(solve_interval_s=interval_s))
    shared = follow(pairs[:7], poses[0], config, particles_alone=alone * QUICK.particles)[0]
    for update, other in zip(shared, follow(pairs[:7], poses[0], SPARING)[0], strict=True):
        assert (update.speed_mps, update.speed_std_mps) == (other.speed_mps, other.speed_std_mps)


@pytest.mark.parametrize('interval_s', [0.045, 0.06])
def test_hurried_track_is_solved_at_the_maximum_solution_age(textured, textured_drive, interval_s):
    pairs, poses = textured_drive
    said = []
    for interval, hurried in ((interval_s, True), (MOST_TIMES * OLD_S, False)):
        config = replace(QUICK, effort=EffortConfig(solve_interval_s=interval))
        tracker = ConstrainedTracker.start(
            textured.start(pairs[0], poses[0], config), NoParameters())
        tracker.hurry(hurried)
        said.append([(u.speed_mps, u.speed_std_mps) for u in map(tracker.update, pairs)])
    assert said[0] == said[1]


@pytest.mark.parametrize('hide', [behind_a_post, blank], ids=['post', 'nothing'])
def test_hurried_track_notices_the_end_of_an_occlusion_at_once(textured, textured_drive, hide):
    """Hidden in pairs 5 to 8: without a quick check it would be searched only after 1.8 s."""
    pairs, poses = textured_drive
    config = replace(QUICK, effort=EffortConfig(solve_interval_s=0.05))
    tracker = ConstrainedTracker.start(
        textured.start(pairs[0], poses[0], config), NoParameters())
    tracker.hurry(True)
    states = [tracker.update(hide(pair) if 5 <= pair.index < 9 else pair).state
              for pair in pairs[:11]]
    assert states[2:] == [CONFIRMED] * 3 + [COASTING] * 4 + [TENTATIVE, CONFIRMED]


def hidden_for_long(textured, poses, hurried, of=1):
    """
    Follow a vehicle at 30 pairs a second that is hidden from pair 6 on.

    :param poses: (n, 3) of the vehicle in each pair.
    :param of: number of tracks in view, which share solutions.
    :return: the tracker and, for each pair, the update and whether the vehicle was searched for.
    """
    pairs = [textured.pair(k, round(k * SECOND / 30), pose) for k, pose in enumerate(poses[:6])]
    grey = blank(pairs[0])
    pairs += [replace(grey, index=k, stamp_ns=round(k * SECOND / 30),
                      right_stamp_ns=round(k * SECOND / 30)) for k in range(6, len(poses))]
    tracker = ConstrainedTracker.start(textured.start(
        pairs[0], poses[0], QUICK, particles_alone=of * QUICK.particles), NoParameters())
    said = []
    for pair in pairs:
        tracker.hurry(hurried and pair.index > 5)
        update = tracker.update(pair)
        said.append((update, update is not None and tracker.unsolved_s(pair.stamp_ns) == 0.0))
        if tracker.ended:
            break
    return tracker, said


@pytest.mark.parametrize(('hurried', 'most_s'), [(False, OLD_S), (True, 1.5)])
@pytest.mark.parametrize('of', [1, 4])
def test_hidden_vehicle_is_searched_for_and_lost_in_time(textured, hurried, most_s, of):
    """It is lost 1.5 s after pair 5, the last that showed it, however rare the searches."""
    poses = np.array([6.0, 0.1, 1.9]) + np.outer(np.arange(60) / 30, [10.0, 0, 0])
    tracker, said = hidden_for_long(textured, poses, hurried, of)
    assert tracker.life.end is TrackEnd.LOST
    assert len(said) - 1 == 5 + 45 + 1  # the first pair more than 1.5 s later
    assert said[-1][0] is None and {u.state for u, _ in said[6:-1]} == {COASTING}
    looks = [k for k, (_, looked) in enumerate(said) if looked and k > 5] + [len(said) - 1]
    assert max(np.diff(looks)) / 30 <= most_s + 1 / 30 and len(looks) < 23


@pytest.mark.parametrize('hurried', [False, True])
def test_hidden_vehicle_leaves_the_view_in_time(textured, hurried):
    """At 30 m/s its corner leaves the right image 17.8 m away, 1 m per pair, 0.5 s later."""
    poses = np.array([20.0, 1.0, 1.9]) + np.outer(np.arange(40) / 30, [30.0, 0, 0])
    tracker, said = hidden_for_long(textured, poses, hurried)
    assert tracker.life.end is TrackEnd.LEFT_VIEW
    seen = sum(60 - pose[0] > 1.9 * 1500 / 160 for pose in poses)
    assert 20 < seen < 25 and abs(len(said) - 1 - seen) <= 1


@pytest.mark.parametrize('hide', [behind_a_post, blank], ids=['post', 'nothing'])
def test_vehicle_hidden_between_solutions_coasts(follow, textured_drive, hide):
    """Pair 5 would not be solved for; 7 is the next solution, and 9 confirms it."""
    pairs, poses = textured_drive
    hidden = [hide(p) if p.index == 5 else p for p in pairs]
    updates, tracker = follow(hidden, poses[0], SPARING)
    assert [k for k, u in enumerate(updates) if u.state is COASTING] == [5, 6]
    assert [u.state for u in updates[7:10]] == [TENTATIVE] * 2 + [CONFIRMED]
    result = tracker.result()
    assert pairs[5].stamp_ns not in result.smoothed and result.verdict is Verdict.MEASURED
    assert abs(result.speed_mps - MPS) < at_most(0.001, 1) * result.speed_std_mps


def test_pair_without_the_vehicle_is_checked_once_before_it_is_solved(
        follow, textured_drive, monkeypatch):
    """Pair 5 is requested three times, as by a pipeline that solves in the background."""
    pairs, poses = textured_drive
    hidden = blank(pairs[5])
    _, tracker = follow(pairs[:5], poses[0], SPARING)
    looks, keep, shows = [], tracker.window.keep, tracker.window.shows
    monkeypatch.setattr(tracker.window, 'keep', lambda *at: looks.append('keep') or keep(*at))
    monkeypatch.setattr(tracker.window, 'shows', lambda *at: looks.append('shows') or shows(*at))
    assert tracker.carry(hidden) is None and tracker.expected(hidden) is None
    said = tracker.update(hidden)
    assert looks == ['keep']
    asked_once = follow([*pairs[:5], hidden], poses[0], SPARING)[0][-1]
    assert said.state is COASTING and (said.s_m, said.speed_mps) == (
        asked_once.s_m, asked_once.speed_mps)
    _, tracker = follow(pairs[:5], poses[0], SPARING)
    assert tracker.expected(hidden) is None  # by its own check
    assert tracker.expected(pairs[5]).stamp_ns == pairs[5].stamp_ns


def test_expected_pose_is_the_mean_of_the_predicted_particles(follow, textured_drive):
    """By another computation: forty thousand particles moved by their random walks."""
    pairs, poses = textured_drive
    _, tracker = follow(pairs[:6], poses[0])
    n, later_ns = 40_000, pairs[5].stamp_ns + 400_000_000
    tracker.share(n)
    mean, covariance = tracker.cloud.ahead(later_ns, tracker.config, tracker._lateral_mps())
    got_mean, got_covariance = tracker._predicted(later_ns).moments()
    std = np.sqrt(np.diag(covariance))
    most = at_most(0.001, 20) / np.sqrt(n)
    assert np.abs((got_mean - mean) / std).max() < most
    assert np.abs((got_covariance - covariance) / np.outer(std, std)).max() < np.sqrt(2) * most


def test_braking_at_30_pairs_a_second_is_within_its_sigma(follow, textured):
    """From 20 m/s at 6 m/s^2; both kinds of readings follow within 0.2 s."""
    times = np.arange(36) / 30
    late = np.maximum(times - 0.5, 0)
    poses = np.column_stack([6 + MPS * times - 3 * late ** 2, np.full(36, 0.1), np.full(36, 1.9)])
    pairs = [textured.pair(k, round(t * SECOND), pose)
             for k, (t, pose) in enumerate(zip(times, poses))]
    updates, _ = follow(pairs, poses[0])
    z = [(u.speed_mps - MPS + 6 * t) / u.speed_std_mps for u, t in zip(updates, late)
         if u.state is CONFIRMED and not 0 < t < 0.2]
    assert len(z) == 28 and np.abs(z).max() < at_most(0.001, len(z))


def test_speed_changed_while_hidden_is_confirmed_after_two_pairs(follow, textured):
    """Hidden while it braked at 4 m/s^2 for 0.4 s; pairs less than 0.06 s apart count as one."""
    times = np.arange(24) / 30
    late = np.clip(times - 0.3, 0, 0.4)
    path_m = MPS * times - 2 * late ** 2 - 4 * late * np.maximum(times - 0.7, 0)
    poses = np.column_stack([6 + path_m, np.full(24, 0.1), np.full(24, 1.9)])
    pairs = [textured.pair(k, round(t * SECOND), pose)
             for k, (t, pose) in enumerate(zip(times, poses))]
    updates, _ = follow([blank(p) if 9 <= p.index < 18 else p for p in pairs], poses[0])
    back = [u for u in updates[9:] if u.state is not COASTING]
    assert [u.state for u in back[:3]] == [TENTATIVE] * 2 + [CONFIRMED]
    z = [(u.speed_mps - MPS + 4 * t) / u.speed_std_mps for u, t in zip(updates, late)
         if any(u is one for one in back[2:])]
    assert len(z) >= 2 and np.abs(z).max() < at_most(0.001, len(z))


def test_right_view_exposed_later_counts_at_its_own_time(follow, textured):
    """Each right image is taken 40 ms later, 0.8 m further on."""
    times = np.arange(10) / 10
    poses = np.column_stack([6 + MPS * times, np.full(10, 0.1), np.full(10, 1.9)])
    pairs = [textured.pair(k, round(t * SECOND), pose, right_ns=round((t + 0.04) * SECOND),
                           right_pose=pose + [0.04 * MPS, 0, 0])
             for k, (t, pose) in enumerate(zip(times, poses))]
    start = textured.start(pairs[0], poses[0], QUICK)
    right_px = textured.quads(poses[0] + [0.04 * MPS, 0, 0])[1]
    tracker = ConstrainedTracker.start(
        replace(start, front=replace(start.front, right_px=right_px)), NoParameters())
    updates = [tracker.update(pair) for pair in pairs]
    z = [(u.speed_mps - MPS) / u.speed_std_mps for u in updates]
    assert np.abs(z).max() < at_most(0.001, len(z))
    far = [(u.s_m - pose[0]) / np.sqrt(u.position_cov_m2[2, 2]) for u, pose in zip(updates, poses)]
    assert np.abs(far).max() < at_most(0.001, len(far))
    result = tracker.result()
    assert abs(result.speed_mps - MPS) < at_most(0.001, 1) * result.speed_std_mps


def test_number_of_particles_does_not_change_the_reading(follow, textured_drive):
    pairs, poses = textured_drive
    _, tracker = follow(pairs[:6], poses[0])
    tracker.share(77)
    assert tracker.particles == 77
    update = tracker.update(pairs[6])
    assert abs(update.speed_mps - MPS) < at_most(0.001, 1) * update.speed_std_mps


def test_quads_on_different_objects_are_refused(textured, textured_drive):
    pairs, poses = textured_drive
    start = textured.start(pairs[0], poses[0], QUICK)
    wrong = replace(start.front, right_px=start.front.right_px + [0.0, 60.0])
    refused = ConstrainedTracker.start(replace(start, front=wrong), NoParameters())
    assert isinstance(refused, Refusal)
    pipeline = make_pipeline(
        textured.rig, {'lane': textured.lane}, PipelineConfig(QUICK), [wrong])
    with pytest.raises(InputError, match='left and right'):
        pipeline.process(pairs[0])


def test_stamps_must_increase_until_a_reset(textured, textured_drive):
    pairs, poses = textured_drive
    front = textured.start(pairs[0], poses[0]).front
    pipeline = make_pipeline(
        textured.rig, {'lane': textured.lane}, PipelineConfig(QUICK), [front])
    first = [pipeline.process(p).updates[0].track for p in pairs[:2]]
    with pytest.raises(InputError, match='later than'):
        pipeline.process(pairs[0])
    pipeline.reset()
    assert first == [0, 0] and pipeline.process(pairs[0]).updates[0].track == 1


@pytest.mark.parametrize('speed_mps, may', [
    (23.8, True), (24.0, False), (16.2, True), (16.0, False)])
def test_physically_impossible_speed_change_is_not_confirmed(steady, speed_mps, may):
    """The limit is 2.4 m/s within 0.2 s plus three joint 1-sigmas, at most 0.5 m/s."""
    before = replace(steady[0][-1], speed_mps=20.0, speed_std_mps=0.3)
    update = replace(before, stamp_ns=before.stamp_ns + 200_000_000, speed_mps=speed_mps,
                     speed_std_mps=0.4)
    assert may_follow(update, before, TrackerConfig()) == may


def test_lane_change_during_missing_pairs_is_followed(follow, textured):
    """Five pairs a second; none for 0.8 s as the lane change begins, 1.1 m to the left."""
    times = np.array([0, 0.2, 0.4, 0.6, 1.4, 1.6])
    across = 3.5 * (1 - np.cos(np.pi * np.clip((times - 0.6) / 2.1, 0, 1))) / 2
    poses = np.column_stack([4 + MPS * times, across - 1.0, np.full(6, 1.9)])
    pairs = [textured.pair(k, round(t * SECOND), pose)
             for k, (t, pose) in enumerate(zip(times, poses))]
    assert 1.1 < across[4] < 1.2
    updates, tracker = follow(pairs, poses[0], TrackerConfig())
    assert COASTING not in [u.state for u in updates]
    assert np.abs([u.lateral_m for u in updates] - poses[:, 1]).max() < 0.05
    result = tracker.result()
    assert result.verdict is Verdict.MEASURED and result.pairs == 6


@pytest.mark.parametrize('exposed_ms, confirmed', [(15.0, True), (0.0, False)])
def test_uneven_stamps_count_only_if_exposures_are_uneven(follow, textured, exposed_ms, confirmed):
    """All stamps are uneven; the exposures are equally uneven, or even."""
    off_s = 0.015 * np.random.default_rng(3).uniform(-1, 1, 12)
    even_s = np.arange(12) / 10
    poses = np.column_stack([6 + MPS * (even_s + exposed_ms / 15 * off_s), np.full(12, 0.1),
                             np.full(12, 1.9)])
    pairs = [textured.pair(k, round(t * SECOND), pose)
             for k, (t, pose) in enumerate(zip(even_s + off_s + 0.1, poses))]
    _, sure = follow(pairs, poses[0])
    _, tracker = follow(pairs[:1], poses[0], replace(QUICK, stamp_std_s=0.01),
                        nominal_stamp_std_s=QUICK.stamp_std_s)
    for pair in pairs[1:]:
        tracker.update(pair)
    result, sure_std_mps = tracker.result(), sure.result().speed_std_mps
    assert result.verdict is Verdict.MEASURED
    assert (result.budget.stamps_mps < 0.2 * result.speed_std_mps) == confirmed
    assert abs(result.speed_mps - MPS) < at_most(0.001, 2) * result.speed_std_mps
    if confirmed:
        assert result.speed_std_mps < 1.1 * sure_std_mps


def extreme_configs(together=6):
    """Return groups of parameters at their minimum or maximum, each extreme in one group."""
    extremes = []
    for name, field in parameters_of(TrackerConfig):
        choices = field.metadata['choices']
        low, high = choices[::len(choices) - 1] if choices else (
            field.metadata['low'], min(field.metadata['high'], 2000))
        extremes += [(name, type(field.default)(value)) for value in {low, high}]
    order = np.random.default_rng(0).permutation(len(extremes))
    return [[extremes[k] for k in order[first:first + together]]
            for first in range(0, len(extremes), together)]


@pytest.mark.slow
@pytest.mark.parametrize('extremes', extreme_configs())
def test_every_valid_configuration_runs(textured, textured_drive, extremes):
    config = SMALL
    for name, value in extremes:
        section, _, key = name.rpartition('.')
        try:
            changed = replace(getattr(config, section), **{key: value}) if section else value
        except InputError:
            continue  # refused when it is loaded
        config = replace(config, **{section or key: changed})
    pairs, poses = textured_drive
    tracker = ConstrainedTracker.start(
        textured.start(pairs[0], poses[0], config), NoParameters())
    if isinstance(tracker, Refusal):
        return
    for pair in pairs[:5]:
        update = tracker.update(pair)
        assert update is None or np.isfinite([update.speed_mps, update.speed_std_mps]).all()
    assert tracker.result().reason or tracker.result().speed_mps


@pytest.mark.slow
@pytest.mark.parametrize('name', ['straight', 'circle'])
def test_simulated_passes_are_measured_within_their_sigma(name, request, drive):
    sequence = request.getfixturevalue(name)
    updates, (result,) = drive(sequence)
    truth = sequence.truth
    speeds = np.array([row['speed'] for row in truth], float)
    assert len(updates) == len(truth) == len(sequence.pairs)
    z = [(u.speed_mps - v) / u.speed_std_mps for u, v in zip(updates, speeds)]
    assert np.abs(z[2:]).max() < at_most(0.001, len(z))
    assert result.verdict is Verdict.MEASURED
    assert abs(result.speed_mps - speeds.mean()) < at_most(0.001, 1) * result.speed_std_mps
    for update, row in list(zip(updates, truth))[len(truth) // 2:]:
        place = np.array([row[k] for k in 'xyz'], float)
        assert np.linalg.norm(update.position_m - place) < 0.3  # the annotation's own scatter
        assert update.state is CONFIRMED and update.lane == updates[0].lane


@pytest.mark.slow
@pytest.mark.parametrize('lag_s, seed, knots', [
    (0.0, 2, ((0.8143136, 23.0465692), (1.6881198, 17.8037323))),
    (0.05, 3, ((0.75, 21.5), (1.5, 17.0))), (0.05, 6, ((0.96, 22.7), (1.6, 18.9)))])
def test_abrupt_end_of_braking_is_within_4_sigma(prepare, lag_s, seed, knots):
    """
    A vehicle that stops braking at 6 m/s^2 from one pair to the next; some pairs are lost.

    Without a model for the end of braking the first reading was 6.5 sigmas low.  In the other
    cases the cameras are exposed apart, so that the right view shows the vehicle some 90 cm
    further on; with the lag applied to the speed instead of solved for with it, errors reached 4.9
    and 8.2 sigmas.
    """
    readings = braked(prepare, knots, seed, lag_s, drop=(2, 6) if seed == 3 else ())
    after = [sigmas for time_s, sigmas, _ in readings if time_s > knots[1][0]]
    assert len(after) >= 4 and np.abs(after).max() < 4.0


def braked(prepare, knots, seed, lag_s=0.0, drop=()):
    """Return the readings of a vehicle: time, s, and error in sigmas and mph."""
    start = straight_config('50 mph', right_delay_s=lag_s, drop=drop)
    vehicle = replace(start.vehicles[0], speed_knots=knots)
    sequence = simulate(replace(start, vehicles=(vehicle,)), np.random.default_rng(seed))
    lanes, fronts = prepare(sequence)
    first_ns = sequence.pairs[0].stamp_ns
    truth = {row['stamp_ns']: row['speed'] for row in sequence.truth}
    tracker = ConstrainedTracker.start(TrackStart(
        rig=sequence.rig, lane=lanes['lane_0'], config=TrackerConfig(), front=fronts[0],
        pair=sequence.pairs[0], track=0, rng=np.random.default_rng(0)), NoParameters())
    updates = [update for pair in sequence.pairs if (update := tracker.update(pair)) is not None]
    told = [with_unnoticed(update, TrackerConfig().visibility) for update in updates]
    errors = [(u, u.speed_mps - truth[u.stamp_ns]) for u in told if u.state is CONFIRMED]
    assert len(errors) >= 10
    return [((update.stamp_ns - first_ns) * 1e-9, error / update.speed_std_mps,
             error / MPH_MPS) for update, error in errors]


@pytest.mark.slow
def test_hard_braking_is_within_4_sigma(prepare):
    """
    Twelve vehicles that brake at 6 m/s^2 from a random time on, for a random time.

    Images hardly show the onset in the first reading after it, which is printed separately
    (``pytest -s``).
    """
    first, others = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        begins_s, lasts_s = rng.uniform(0.4, 1.2), rng.uniform(0.5, 1.0)
        knots = (begins_s, 22.35), (begins_s + lasts_s, 22.35 - 6 * lasts_s)
        readings = braked(prepare, knots, seed)
        newest = next(k for k, (time_s, _, _) in enumerate(readings) if time_s > begins_s)
        first.append(readings.pop(newest))
        others += [sigmas for _, sigmas, _ in readings]
    beyond = sum(abs(sigmas) > 4 for _, sigmas, _ in first)
    print(f'\n{beyond} of {len(first)} first readings beyond 4 sigma, the worst of all '
          f'{max((sigmas for _, sigmas, _ in first), key=abs):+.1f} sigma and '
          f'{max((mph for _, _, mph in first), key=abs):+.1f} mph off; '
          f'of {len(others)} others {np.abs(others).max():.1f} sigma at most')
    assert not beyond and np.abs(others).max() < 4.0
