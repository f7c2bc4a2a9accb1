# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The photometric window on a front whose images have a closed form."""
from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy import stats
from stereo_speed.core.errors import InputError
from stereo_speed.core.stamp_watch import Gap
from stereo_speed.core.tracker_config import EffortConfig, NoiseConfig, TrackerConfig
from stereo_speed.tracking.front import Front
from stereo_speed.tracking.motion_prior import PassMotions, PassPrior
from stereo_speed.tracking.observation import ObservationSampler
from stereo_speed.tracking.posterior import Posterior
from stereo_speed.tracking.sharpness import blur_log_likelihoods, trial_blurs_px
from stereo_speed.tracking.window import PhotometricWindow
from stereo_speed.vision.haar import PartGrid

GRID = PartGrid(10, 4)
PERIOD_NS = 100_000_000  # of the textured drive
BEFORE = 4  # pairs before a gap of its stamps
MPS = 20.0
SECOND = 1_000_000_000


def window_of(textured, pose, config=TrackerConfig(), sampler=ObservationSampler, gamma=1.0):
    """
    Return a window of a pass whose first front was placed 0.7 m off along its ray.

    :param gamma: grey levels of the texture are this root of the light.
    """
    config = replace(config, noise=replace(config.noise, gamma=gamma))
    sampler = sampler(textured.rig, Front(textured.path, textured.corners_m), GRID.unit_xy,
                      GRID.shape, config.noise)
    range_m = 60 - pose[0]
    slope = np.array([-pose[1], 2 - pose[2]]) / range_m
    prior = PassPrior(s_m=pose[0] + 0.7, s_std_m=1.0, offset_m=pose[1:] + 0.7 * slope,
                      offset_slope=slope, speed_mps=18.0, speed_std_mps=10.0,
                      heading_std_rad=np.full(2, 1e-4))
    return PhotometricWindow(sampler, PassMotions.of(prior, config), config)


def feed(window, pairs, poses, speed_mps=MPS, rng=None):
    """Add pairs, each with an error like that of particles; return the posteriors."""
    rng = np.random.default_rng(1) if rng is None else rng
    return [window.add(pair, np.append(pose, speed_mps) + rng.normal(0, [0.3, 0.02, 0.02, 1.0]))
            for pair, pose in zip(pairs, poses)]


@pytest.fixture(scope='module')
def steady(textured, textured_drive):
    """Return the window of a steady drive and its posteriors."""
    pairs, poses = textured_drive
    window = window_of(textured, poses[0])
    return window, feed(window, pairs, poses)


def chi_square(posterior, k, truth):
    """Return the normalised square error of s, a, b, v in one pair."""
    mean, covariance = posterior.at(k)
    return float((mean - truth) @ np.linalg.solve(covariance, mean - truth))


def test_poses_and_speed_are_within_covariance_from_the_third_pair(textured_drive, steady):
    """Four errors over their covariance are a chi-square, at the level of 0.1 %."""
    _, posteriors = steady
    for k, (posterior, pose) in enumerate(zip(posteriors, textured_drive[1])):
        assert posterior.seen.all() and posterior.unoccluded.all()
        assert chi_square(posterior, -1, np.append(pose, MPS)) < stats.chi2.ppf(0.999, 4), k
    stds = [np.sqrt(posterior.at(-1)[1][3, 3]) for posterior in posteriors]
    assert stds[-1] < 0.2 < stds[0] and posteriors[-1].mean.shape == (12, 4)


def test_solved_pass_contains_the_truth_and_its_budget_is_ordered(steady):
    solved = steady[0].solve_pass()
    posterior = solved.posterior
    speeds = posterior.covariance[3::4, 3::4]
    mean, std = posterior.mean[:, 3].mean(), np.sqrt(speeds.mean())
    assert abs(mean - MPS) < stats.norm.ppf(0.9995) * std and std < 0.1
    # Each improvement leaves less: exact stamps, then an exact path too.
    for more, less in ((speeds, solved.exact_stamps), (solved.exact_stamps, solved.exact_path)):
        assert more.mean() > less.mean() > 0
    assert solved.occluded_ns == frozenset()
    np.testing.assert_allclose(posterior.ground_speeds(), np.hypot(
        posterior.mean[:, 3], posterior.lateral_mps))


def test_solving_the_pass_does_not_change_the_window(textured, textured_drive, steady):
    pairs, poses = textured_drive
    asked, silent = (window_of(textured, poses[0]) for _ in range(2))
    for k, (pair, pose) in enumerate(zip(pairs[:6], poses)):
        guess = np.append(pose, MPS)
        one, other = asked.add(pair, guess), silent.add(pair, guess)
        np.testing.assert_array_equal(one.mean, other.mean)
        first, again = asked.solve_pass(), asked.solve_pass()
        np.testing.assert_array_equal(first.posterior.mean, again.posterior.mean)
        np.testing.assert_array_equal(first.exact_path, again.exact_path)


@pytest.mark.parametrize('off_px', [
    [0.15] + [0.0] * 11,  # the first pair alone
    [0.15, -0.1, 0.1, 0.05, -0.15, 0.1, -0.05, 0.0, 0.1, -0.1, 0.05, -0.1]])
def test_disparity_errors_are_not_taken_for_braking_or_climbing(textured, textured_drive, off_px):
    """A twentieth of a pixel is 1 m along the path at 60 m; image rows determine it better."""
    _, poses = textured_drive
    ranges_m = textured.far_m - poses[:, 0]
    pairs = [textured.pair(k, round(k * SECOND / 10), pose, right_pose=pose + [
        0.0, off * range_m / textured.focal_px, 0.0])
        for k, (pose, off, range_m) in enumerate(zip(poses, off_px, ranges_m))]
    posteriors = feed(window_of(textured, poses[0]), pairs, poses)
    # In its third pair a vehicle is confirmed.
    for k, posterior in list(enumerate(posteriors))[2:]:
        mean, covariance = posterior.at(-1)
        assert abs(mean[3] - MPS) < 3.5 * np.sqrt(covariance[3, 3]), k


@pytest.mark.parametrize('noise', [1.0, 4.0])
def test_speed_uncertainty_does_not_depend_on_the_initial_guess(textured, noise):
    """Residuals at a wrong position no longer affect the scatter once it is corrected."""
    front = replace(textured, noise=noise)
    pairs, poses = front.drive(7, 5.0, 30.0)
    near, far = (window_of(front, poses[0]) for _ in range(2))
    wrong = np.array([2.0, 0.08, -0.08, 4.0])
    for pair, pose in zip(pairs, poses):
        guess = np.append(pose, 30.0)
        one, other = (window.add(pair, at).at(-1)
                      for window, at in ((near, guess), (far, guess + wrong)))
        std, std_from_afar = (np.sqrt(covariance[3, 3]) for _, covariance in (one, other))
        assert std_from_afar == pytest.approx(std, rel=0.25)
        assert abs(one[0][3] - other[0][3]) < 0.5 * std


def test_hard_braking_is_within_its_sigma(textured):
    """6 m/s^2 from the seventh pair on."""
    times_s = np.arange(14) / 10
    braked_s = np.maximum(times_s - 0.6, 0.0)
    poses = np.array([6.0, 0.1, 1.9]) + np.outer(MPS * times_s - 3 * braked_s ** 2, [1, 0, 0])
    pairs = [textured.pair(k, round(t * SECOND), pose)
             for k, (t, pose) in enumerate(zip(times_s, poses))]
    posteriors = feed(window_of(textured, poses[0]), pairs, poses)
    stds = [np.sqrt(posterior.at(-1)[1][3, 3]) for posterior in posteriors]
    for posterior, std, late_s in list(zip(posteriors, stds, braked_s))[3:]:
        assert abs(posterior.at(-1)[0][3] - (MPS - 6 * late_s)) < 4 * std, late_s
    assert stds[-1] < 0.3


@pytest.mark.parametrize('fps, parts', [(5.0, 15), (10.0, 20)])
def test_sustained_braking_is_measured(textured, fps, parts):
    """
    Before the onset is modelled a steady speed until it seems nearly impossible.

    The speed loss is known to a twentieth; to a fifteenth where pairs are 0.2 s apart, so that
    braking may also have begun between pairs, or have ended again.
    """
    began_s, until_s, braking = 0.6 if fps == 10 else 0.8, 1.2, 6.0
    times_s = np.arange(0.0, until_s + 1e-9, 1 / fps)
    braked_s = np.maximum(times_s - began_s, 0.0)
    poses = np.array([6.0, 0.1, 1.9]) + np.outer(
        MPS * times_s - braking / 2 * braked_s ** 2, [1, 0, 0])
    pairs = [textured.pair(k, round(t * SECOND), pose)
             for k, (t, pose) in enumerate(zip(times_s, poses))]
    speeds = [posterior.at(-1)[0][3] for posterior in feed(
        window_of(textured, poses[0]), pairs, poses)]
    for speed, lost in zip(speeds, braking * braked_s):
        if lost > braking * 0.35:
            assert abs(speed - (MPS - lost)) < lost / parts, lost


def test_vehicle_that_stands_for_minutes_is_followed(textured):
    """No model expects it to, least of all one whose vehicles change their speed now and then."""
    poses = np.tile([30.0, 0.1, 1.9], (14, 1))
    pairs = [textured.pair(k, 15 * k * SECOND, pose) for k, pose in enumerate(poses)]
    for posterior in feed(window_of(textured, poses[0]), pairs, poses, speed_mps=0.0)[7:]:
        (s_m, _, _, speed_mps), covariance = posterior.at(-1)
        assert abs(s_m - 30.0) < 0.02
        assert abs(speed_mps) < 0.02 and np.sqrt(covariance[3, 3]) < 0.2


def ahead_by_hand(states, after_s, gap_s, lateral_mps):
    """Return s, a, b, v extrapolated from the last of two states (8,) at an even acceleration."""
    (_, _, _, v_before), (s, a, b, v) = states.reshape(2, 4)
    gain = (v - v_before) / gap_s
    return np.array([s + v * after_s + gain * after_s ** 2 / 2, a + lateral_mps * after_s, b,
                     v + gain * after_s])


def test_state_is_extrapolated_between_solutions():
    """From 20 to 19 m/s in 0.1 s, hence 18.5 m/s after 0.05 s more; the speed is a random walk."""
    rng, config = np.random.default_rng(3), TrackerConfig()
    mean = np.array([[1.0, 0.2, 0.1, 21.0], [3.0, 0.2, 0.1, 20.0], [5.0, 0.3, 0.0, 19.0]])
    root = rng.normal(size=(12, 12))
    posterior = Posterior(0, np.array([0.0, 0.1, 0.2]), mean, root @ root.T, np.full(3, 0.4),
                          *np.ones((3, 3)), *np.ones((2, 3), bool), 0.5)
    at, covariance = posterior.ahead(0.05, config)
    np.testing.assert_allclose(at, [5.0 + 0.9375, 0.32, 0.0, 18.5])
    by = np.array([ahead_by_hand(mean[1:].ravel() + step, 0.05, 0.1, 0.4) - at
                   for step in np.eye(8)]).T  # it is linear
    strays = covariance - by @ posterior.covariance[4:, 4:] @ by.T
    # Brownian motion of 0.5 m/s/sqrt(s) in the speed, integrated for the distance.
    np.testing.assert_allclose(np.diag(strays), np.array([
        0.25 * 0.05 ** 2 / 3, config.drift_across_std_m ** 2, config.drift_up_std_m ** 2, 0.25]
    ) * 0.05)
    np.testing.assert_allclose([strays[0, 3], strays[3, 0]], 0.25 * 0.05 ** 2 / 2)


def test_kept_pairs_count_in_the_next_solution(textured, textured_drive):
    pairs, poses = textured_drive
    window = window_of(textured, poses[0])
    last = feed(window, pairs[:6], poses)[-1]
    for k in (6, 7):
        assert window.keep(pairs[k], last.ahead((k - 5) / 10, window.config)[0])
    after, = feed(window, pairs[8:9], poses[8:])
    assert len(after.mean) == 9 and after.unoccluded.all()
    for k, pose in enumerate(poses[6:9], 6):
        assert chi_square(after, k, np.append(pose, MPS)) < stats.chi2.ppf(0.999, 4)
    assert len(window.solve_pass().posterior.mean) == 9


def test_pair_with_weaker_agreement_is_not_kept(textured, textured_drive):
    pairs, poses = textured_drive
    window = window_of(textured, poses[0])
    feed(window, pairs[:6], poses)
    guess, grey = np.append(poses[6], MPS), np.full_like(pairs[6].left, 1600)
    assert not window.keep(behind_a_post(pairs[6]), guess)
    assert not window.keep(replace(pairs[6], right=grey), guess)
    assert not window.keep(pairs[6], np.array([20.0, 30.0, 1.9, MPS]))  # out of both images
    assert len(window.solve_pass().posterior.mean) == 6


def behind_a_post(pair, share=0.35):
    """Return a pair in which a striped post hides a share of the front, from the left."""
    images = []
    for image in (pair.left, pair.right):
        columns = np.flatnonzero(image.std(axis=0) > 60)
        covered = slice(columns[0] - 3, columns[0] + int(share * len(columns)))
        image = image.copy()
        image[:, covered] = 16 * (90 + 60 * (np.arange(len(image)) // 5 % 2))[:, None]
        images.append(image)
    return replace(pair, left=images[0], right=images[1])


def test_occluded_observation_is_left_out_of_later_solutions(textured, textured_drive):
    pairs, poses = textured_drive
    with_post, without = (window_of(textured, poses[0]) for _ in range(2))
    for window in (with_post, without):
        feed(window, pairs[:6], poses)
    occluded, = feed(with_post, [behind_a_post(pairs[6])], poses[6:])
    assert occluded.seen[-1] and not occluded.unoccluded[-1] and occluded.unoccluded[:-1].all()
    assert len(occluded.mean) == 7
    guess = np.append(poses[7], MPS)
    after, never = (w.add(pairs[7], guess, reacquires=True) for w in (with_post, without))
    assert len(after.mean) == 7
    np.testing.assert_array_equal(after.mean, never.mean)
    np.testing.assert_array_equal(after.covariance, never.covariance)
    np.testing.assert_array_equal(with_post.solve_pass().posterior.mean,
                                  without.solve_pass().posterior.mean)


@pytest.mark.parametrize('hidden', [1, 2])
def test_first_pairs_that_do_not_show_the_front_do_not_affect_its_position(
        textured, textured_drive, hidden):
    """The object that half hid it at detection placed it 1.5 m too far away, and aside."""
    pairs, poses = textured_drive
    pairs = [behind_a_post(pair, 0.6) if k < hidden else pair for k, pair in enumerate(pairs)]
    window = window_of(textured, poses[0])
    prior = window.motions.prior
    prior = replace(prior, s_m=poses[0][0] - 1.5, s_std_m=0.2,
                    offset_m=prior.offset_m + [0.3, 0.2])
    window = PhotometricWindow(
        window.sampler, PassMotions.of(prior, window.config), window.config)
    live = feed(window, pairs, poses)
    for posterior in live[hidden + 2:]:
        assert posterior.first_ns == pairs[hidden].stamp_ns
        (_, _, _, speed), around = posterior.at(-1)
        assert abs(speed - MPS) < 4 * np.sqrt(around[3, 3]) < 4.0
    solved = window.solve_pass()
    assert {pair.stamp_ns for pair in pairs[:hidden]} <= solved.occluded_ns
    speeds, covariance = solved.posterior.mean[:, 3], solved.posterior.covariance[3::4, 3::4]
    assert solved.posterior.first_ns == pairs[hidden].stamp_ns
    assert abs(speeds.mean() - MPS) < 3 * np.sqrt(covariance.mean()) < 0.5
    assert (np.abs(speeds - MPS) < 4 * np.sqrt(np.diag(covariance))).all()


def test_another_object_is_not_seen_as_the_vehicle(textured, textured_drive):
    pairs, poses = textured_drive
    window = window_of(textured, poses[0])
    feed(window, pairs[:4], poses)
    grey = np.full_like(pairs[4].left, 1600)
    blank, = feed(window, [replace(pairs[4], left=grey, right=grey)], poses[4:])
    assert not blank.seen[-1]
    assert window.add(pairs[5], np.array([20.0, 30.0, 1.9, MPS])) is None  # out of both images
    assert len(feed(window, pairs[6:7], poses[6:])[0].mean) == 5


def effort(live, whole):
    return TrackerConfig(effort=EffortConfig(live_observations=live, pass_observations=whole))


@pytest.mark.parametrize('live, whole', [(4, 4), (4, 5), (5, 9), (12, 12)])
def test_inactive_keyframes_are_recalled_up_to_the_limit(textured, textured_drive, live, whole):
    pairs, poses = textured_drive
    window = window_of(textured, poses[0], effort(live, whole))
    posteriors = feed(window, pairs, poses)
    assert [len(p.mean) for p in posteriors] == [min(k + 1, live) for k in range(12)]
    solved = window.solve_pass().posterior
    assert len(solved.mean) == whole
    stamps = np.round(solved.stamps_s, 6).tolist()
    assert stamps == sorted(set(stamps)) and set(stamps) <= {k / 10 for k in range(12)}
    assert stamps[0] == 0.0 and stamps[-2:] == [1.0, 1.1]
    # Observed again at the positions from the others, they are equally accurate.
    for k, stamp in enumerate(stamps):
        truth = np.append(poses[round(10 * stamp)], MPS)
        assert chi_square(solved, k, truth) < stats.chi2.ppf(0.9999, 4)


def test_pass_with_fewer_observations_than_a_reading_is_refused():
    with pytest.raises(InputError, match='pass_observations.*at least live_observations, 24'):
        EffortConfig(pass_observations=23)
    assert EffortConfig(pass_observations=24).live_observations == 24


def changing_lanes(textured, fps=10.0, lasts_s=1.6):
    """Return pairs of a vehicle that moves 1.6 m to the left, heading where it drives."""
    times = np.arange(18) / fps
    part = np.clip((times - 0.1) / lasts_s, 0, 1)
    offset = 1.6 * part ** 3 * (10 - 15 * part + 6 * part ** 2) - 0.8
    rates = np.gradient(offset, times)
    poses = np.column_stack([2 + MPS * times, offset, np.full(len(times), 1.9)])
    headings = np.arctan2(rates, MPS)
    pairs = [textured.pair(k, round(t * SECOND), pose, heading_rad=psi)
             for k, (t, pose, psi) in enumerate(zip(times, poses, headings))]
    return pairs, poses, rates, headings


def test_lane_change_gives_a_heading_and_lane_keeping_none(textured, steady):
    pairs, poses, rates, headings = changing_lanes(textured)
    posterior = feed(window_of(textured, poses[0]), pairs, poses)[-1]
    inner = slice(4, -4)
    assert np.abs(posterior.heading_rad[inner] - headings[inner]).max() < 0.01 < headings.max()
    assert np.abs(posterior.lateral_mps[inner] - rates[inner]).max() < 0.1 * rates.max()
    np.testing.assert_allclose(posterior.ground_speeds()[inner],
                               np.hypot(MPS, rates)[inner], atol=0.1)
    kept = steady[1][-1].heading_rad
    assert np.abs(kept).max() < 0.001


def test_evidence_follows_braking_that_a_cruising_model_would_smooth(textured):
    """From 20 m/s by 6 m/s^2 after 0.4 s; a configuration without that model lags behind."""
    times = np.arange(14) / 10
    late = np.maximum(times - 0.4, 0)
    speeds = MPS - 6 * late
    poses = np.column_stack([6 + MPS * times - 3 * late ** 2, np.full(14, 0.1), np.full(14, 1.9)])
    pairs = [textured.pair(k, round(t * SECOND), p) for k, (t, p) in enumerate(zip(times, poses))]
    z = []
    for config in (TrackerConfig(), TrackerConfig(
            manoeuvre_probability=0.0, onset_per_s=0.0, cruise_share=1.0)):
        window = window_of(textured, poses[0], config)
        rng = np.random.default_rng(1)
        for pair, pose, speed in zip(pairs, poses, speeds):
            posterior, = feed(window, [pair], [pose], speed, rng)
        mean, covariance = posterior.at(-1)
        z.append(abs(mean[3] - speeds[-1]) / np.sqrt(covariance[3, 3]))
    assert z[0] < stats.norm.ppf(0.9995) < z[1]


def exposed_apart(textured, lags_s, across_mps=0.0, height_m=1.9, off_rows=0):
    """Return pairs, 10 a second, with right views later by these lags, and their poses."""
    times = np.arange(len(lags_s)) / 10
    rates = np.array([MPS, across_mps, 0.0])
    poses = np.array([6.0, 0.1 - across_mps * times.mean(), height_m]) + np.outer(times, rates)
    pairs = [textured.pair(k, round(t * SECOND), pose, right_ns=round((t + lag_s) * SECOND),
                           right_pose=pose + rates * lag_s)
             for k, (t, pose, lag_s) in enumerate(zip(times, poses, lags_s))]
    return [replace(p, right=np.roll(p.right, off_rows, axis=0)) for p in pairs], poses


@pytest.mark.parametrize('lags_s', [
    [0.03] * 8, [-0.03] * 8, [0.0, 0.03] * 4, [0.03] + [0.0] * 7, [0.0] * 7 + [-0.03]])
def test_lag_of_the_right_view_is_modelled(textured, lags_s):
    """In all pairs or in some, later or earlier than the left view."""
    lag_s = 0.03
    pairs, poses = exposed_apart(textured, lags_s)
    mean, covariance = feed(window_of(textured, poses[0]), pairs, poses)[-1].at(-1)
    error, along = mean - np.append(poses[-1], MPS), np.ix_([0, 3], [0, 3])
    assert error[[0, 3]] @ np.linalg.solve(covariance[along], error[[0, 3]]) \
        < stats.chi2.ppf(0.999, 2)
    assert error[0] ** 2 < (0.1 * MPS * lag_s) ** 2  # a tenth of what the lag would cost


def test_lateral_motion_during_the_lag_is_modelled(textured):
    """In 40 ms at 1.5 m/s that is 6 cm: a disparity of 2 px, and 4 m along the path at 50 m."""
    pairs, poses = exposed_apart(textured, [0.04] * 8, across_mps=1.5)
    window = window_of(textured, poses[0])
    live = feed(window, pairs, poses)[-1]
    for posterior in (live, window.solve_pass().posterior):
        for k, pose in enumerate(poses):
            assert chi_square(posterior, k, np.append(pose, MPS)) < stats.chi2.ppf(0.9999, 4), k


def test_right_view_off_its_epipolar_line_has_no_speed_information(textured):
    """In 30 ms a front 2 m below the cameras moves down 1 px: a row is its only information."""
    speeds = []
    for off_rows in (0, 1):
        pairs, poses = exposed_apart(textured, [0.03] * 8, height_m=0.0, off_rows=off_rows)
        mean, covariance = feed(window_of(textured, poses[0]), pairs, poses)[-1].at(-1)
        speeds.append(mean[3])
    assert abs(speeds[1] - speeds[0]) < 0.5 * np.sqrt(covariance[3, 3])


def first_gain(textured, pair, pose):
    """Return the log evidence that one pair gives for its likeliest blur difference over none."""
    window, noise = window_of(textured, pose), NoiseConfig()
    said = blur_log_likelihoods(*window.sampler.blurred_patches(
        pair, pose, np.zeros(3), trial_blurs_px(noise), [1.0]), noise)[0]
    return float(said.max() - said[len(said) // 2])


def test_later_pairs_decide_the_focus_that_one_pair_leaves_open(textured, textured_drive):
    """The limit lies above the evidence of the first pair and below that of two."""
    pairs, poses = textured_drive
    pairs = [replace(p, right=cv2.GaussianBlur(p.right, (0, 0), 1.5)) for p in pairs]
    sigmas = float(np.sqrt(2 * 1.4 * first_gain(textured, pairs[0], poses[0])))
    late = window_of(textured, poses[0], TrackerConfig(noise=NoiseConfig(sharpness_sigmas=sigmas)))
    feed(late, pairs[:1], poses)
    assert late.sampler.blur_px == (0.0, 0.0)
    known = window_of(textured, poses[0])
    for window, done in ((late, 1), (known, 0)):
        posterior = feed(window, pairs[done:], poses[done:])[-1]
        assert window.sampler.blur_px == pytest.approx((1.5, 0.0), abs=0.25)
        assert np.abs(posterior.mean[:, 3] - MPS).max() < 4 * np.sqrt(posterior.covariance[-1, -1])
    # Observations from before it was known are not in the solution.
    speeds = [np.mean(one.solve_pass().posterior.mean[:, 3]) for one in (late, known)]
    assert speeds[0] == pytest.approx(speeds[1], abs=0.02)


@pytest.mark.parametrize('blurred', ['light', 'grey levels'])
def test_views_tell_whether_light_or_grey_levels_are_blurred(textured, textured_drive, blurred):
    pairs, poses = textured_drive
    pairs = [textured.with_contrast(pair) for pair in pairs[:4]]
    gamma = 2.2 if blurred == 'light' else 1.0
    pairs = [replace(p, right=textured.softened(p, 1.5, gamma).right) for p in pairs]
    window = window_of(textured, poses[0], gamma=2.2)
    feed(window, pairs, poses)
    assert window.sampler.blur_px == pytest.approx((1.5, 0.0), abs=0.15)
    assert window.sampler.blur_gamma == gamma


def test_equally_sharp_views_are_never_blurred(steady):
    assert steady[0].sampler.blur_px == (0.0, 0.0)


@pytest.mark.slow
def test_change_due_to_equal_blurs_is_in_the_doubt(textured, textured_drive):
    """By a share of the change: half the share, a quarter of the variance, and the same speeds."""
    pairs, poses = textured_drive
    out_of_focus = [replace(p, right=cv2.GaussianBlur(p.right, (0, 0), 2.0)) for p in pairs]

    def solved(blur_doubt, pairs):
        window = window_of(textured, poses[0], TrackerConfig(noise=NoiseConfig(
            blur_doubt=blur_doubt)))
        feed(window, pairs, poses)
        return window.solve_pass()
    none, half, whole = (solved(doubt, out_of_focus) for doubt in (0.0, 0.5, 1.0))
    for one in (half, whole):
        np.testing.assert_array_equal(one.posterior.mean, none.posterior.mean)
    less, more = (one.posterior.covariance - none.posterior.covariance for one in (half, whole))
    np.testing.assert_allclose(4 * less, more, atol=1e-9)
    assert np.diag(more)[3::4].min() > 0 and np.linalg.eigvalsh(more).min() > -1e-9
    np.testing.assert_allclose(whole.exact_path - none.exact_path, more[3::4, 3::4], atol=1e-9)
    np.testing.assert_array_equal(solved(0.0, pairs).posterior.covariance,
                                  solved(1.0, pairs).posterior.covariance)


class SeenLess(ObservationSampler):
    """Does not see some pairs, or sees them wrongly, with less blur."""

    lost: frozenset[int] = frozenset()
    then_lost = frozenset({3})
    then_wrong = False

    def less_blurred(self):
        samplers = super().less_blurred()
        for sampler in samplers:
            sampler.lost, sampler.wrong = self.then_lost, self.then_wrong
        return samplers

    def observe(self, pair, *where):
        observation = super().observe(pair, *where)
        if pair.index in self.lost:
            return None
        return replace(observation, pixels=np.nan) if self.wrong else observation

    wrong = False


class FirstUnseen(SeenLess):
    then_lost = frozenset({0})


class Unsolved(SeenLess):
    then_lost = frozenset()
    then_wrong = True


def doubt_of_speeds(textured, drive, sampler):
    """Return the covariance (n, n) that blur adds to the speeds of a pass out of focus."""
    def solved(share):
        window = window_of(textured, drive[1][0], TrackerConfig(noise=NoiseConfig(
            blur_doubt=share)), sampler)
        feed(window, [replace(p, right=cv2.GaussianBlur(p.right, (0, 0), 2.0))
                      for p in drive[0]], drive[1])
        return window.solve_pass().posterior
    return (solved(1.0).covariance - solved(0.0).covariance)[3::4, 3::4]


@pytest.mark.slow
def test_only_the_pair_lost_with_less_blur_is_left_out(textured, textured_drive):
    usual, less = (np.sqrt(np.diag(doubt_of_speeds(textured, textured_drive, sampler)).mean())
                   for sampler in (ObservationSampler, SeenLess))
    assert less == pytest.approx(usual, rel=0.3) and usual > 0


@pytest.mark.slow
@pytest.mark.parametrize('sampler', [FirstUnseen, Unsolved])
def test_passes_of_unknown_doubt_keep_the_prior_uncertainty(textured, textured_drive, sampler):
    """Twice 10 m/s, common to all pairs: from both solutions with less blur."""
    doubt = doubt_of_speeds(textured, textured_drive, sampler)
    np.testing.assert_allclose(doubt, 200.0, rtol=1e-6)


def window_with_gap(textured, textured_drive, *, missing, set_forward, told=False):
    """Return a window of a pass with a gap, which it was told or not, and the gap."""
    pairs, poses = textured_drive
    kept = [k for k in range(len(pairs)) if not BEFORE <= k < BEFORE + missing]
    stamps = {k: pairs[k].stamp_ns + (k >= BEFORE) * set_forward * PERIOD_NS for k in kept}
    gap = Gap(stamps[BEFORE + missing], 1 + missing + set_forward, PERIOD_NS * 1e-9)
    window = window_of(textured, poses[0])
    window.gaps = [gap] if told else []
    posteriors = feed(window, [replace(
        pairs[k], stamp_ns=stamps[k], right_stamp_ns=stamps[k]) for k in kept], poses[kept])
    assert posteriors[-1].unoccluded.all()
    return window, gap


@pytest.mark.parametrize('missing, set_forward', [(0, 1), (0, 2), (0, 4), (2, 0), (5, 0), (2, 1)])
def test_clock_set_forward_is_told_from_missing_images(
        textured, textured_drive, missing, set_forward):
    """At 20 m/s a period is 2 m of the way, and the front is known to some centimetres."""
    window, gap = window_with_gap(
        textured, textured_drive, missing=missing, set_forward=set_forward)
    assert not window.solve_pass().clock_set  # it does not know of the gap
    window.gaps = [Gap(gap.after_ns - 10 ** 12, 4, 0.1), gap, Gap(gap.after_ns + 10 ** 12, 4, 0.1)]
    assert window.solve_pass().clock_set == (set_forward > 0)


@pytest.mark.parametrize('missing, set_forward', [(0, 1), (0, 4), (5, 0), (2, 1)])
def test_live_readings_doubt_a_clock_that_was_set_forward(
        textured, textured_drive, missing, set_forward):
    window, gap = window_with_gap(
        textured, textured_drive, missing=missing, set_forward=set_forward, told=True)
    assert (window.clock.doubtful, window.clock.step) == (
        (True, gap) if set_forward else (False, None))


def solved_with(front, pairs, poses, share, *, stamp_std_s=None):
    """Return a pass solved with a share of what its bands disagree by."""
    window = window_of(front, poses[0], TrackerConfig(noise=NoiseConfig(band_share=share)))
    feed(window, pairs, poses)
    if stamp_std_s is not None:
        window.doubt_stamps(stamp_std_s)
    return window.solve_pass()


@pytest.fixture(scope='module')
def mirroring(textured):
    """
    Return what most of a front mirrors: it grows by 0.2 % a metre more than the front does.

    The passes solved without and with the agreement of its bands come after front and drive.
    """
    front = replace(textured, mirrors=0.002)
    drive = front.drive()
    return (front, drive, *(solved_with(front, *drive, share) for share in (0.0, 0.5)))


def test_sigma_tells_that_bands_of_a_front_disagree(mirroring):
    """By the fit alone the speed is more than 5 sigma off."""
    _, _, by_fit, by_bands = mirroring
    off, off_too = (solved.posterior.mean[:, 3].mean() - MPS for solved in (by_fit, by_bands))
    assert off == off_too
    fit, bands = ([np.array(c) for c in (
        solved.posterior.covariance[3::4, 3::4], solved.exact_stamps, solved.exact_path)]
        for solved in (by_fit, by_bands))
    assert abs(off) > 5 * np.sqrt(fit[0].mean())
    assert abs(off) < 3 * np.sqrt(bands[0].mean())
    # All of it is matching; the rest of the budget is as before.
    for one, other in zip(fit[:2], bands[:2]):
        np.testing.assert_allclose(other - bands[2], one - fit[2], atol=1e-9)


def test_covariance_of_disagreeing_bands_is_one(mirroring):
    """It is symmetric and positive, with stamps that are doubted too."""
    front, (pairs, poses), _, by_bands = mirroring
    doubted = solved_with(front, pairs, poses, 0.5, stamp_std_s=0.003)
    for solved in (by_bands, doubted):
        covariance = solved.posterior.covariance
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(covariance).min() > 0
        assert np.isfinite(solved.posterior.ground_stds()).all()


@pytest.mark.parametrize('count', [1, 2, 4, 12])
def test_bands_that_agree_leave_the_sigma(textured, count):
    """Errors that all bands share do not show, those of a prior most of all."""
    drive = textured.drive(count)
    by_fit, by_bands = (solved_with(textured, *drive, share) for share in (0.0, 0.5))
    np.testing.assert_array_equal(by_fit.posterior.mean, by_bands.posterior.mean)
    for one, other in ((by_fit.exact_path, by_bands.exact_path),
                       (by_fit.posterior.covariance, by_bands.posterior.covariance)):
        assert one.trace() <= other.trace() < 1.2 * one.trace()


def test_bands_are_compared_where_the_views_have_two_stamps(textured):
    """One of the pairs is behind a post."""
    pairs, poses = exposed_apart(textured, [0.02] * 12)[:2]
    solved = solved_with(textured, [pairs[0], behind_a_post(pairs[1]), *pairs[2:]], poses, 1.0)
    speeds = solved.posterior.covariance[3::4, 3::4]
    assert abs(solved.posterior.mean[:, 3].mean() - MPS) < 4 * np.sqrt(speeds.mean()) < 1.0
