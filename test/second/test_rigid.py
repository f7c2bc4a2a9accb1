# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Positions of a body whose corners project with known noise."""
from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from stereo_speed.core.tracker_config import SecondConfig
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import of_camera, StereoRig
from stereo_speed.road.path import SplinePath, StraightPath
from stereo_speed.second import rigid
from stereo_speed.second.rigid import places_of, Rays

F_PX, NOISE_PX = 1600.0, 0.1
K = np.array([[F_PX, 0, 512], [0, F_PX, 384], [0, 0, 1.0]])
CONFIG = SecondConfig(match_floor_px=0.0)


def rig() -> StereoRig:
    """Return cameras that converge slightly."""
    cameras = [Camera(name, 1024, 768, K, np.zeros(5), 'plumb_bob') for name in ('left', 'right')]
    turn = of_camera((np.radians(-0.5), 0.0, 0.0))
    return StereoRig(*cameras, turn, turn @ np.array([-0.5, 0.0, 0.0]))


STRAIGHT = StraightPath(np.array([-5.0, 3.0, 70.0]), np.array([0.05, 0.0, -1.0]), 60.0)
ANGLES = np.linspace(0.0, 0.8, 12)
BEND = SplinePath(np.stack([-35 + 40 * np.cos(ANGLES), 0 * ANGLES + 3.0,
                            45 - 40 * np.sin(ANGLES)], axis=1))


def sightings(path, rng, *, speed=20.0, count=9, lag_s=0.0, strangers=0, sliding=0,
              slide_px=0.3):
    """
    Return rays of 25 corners and of some stationary ones beside the road, and the true places.

    :param sliding: number of corners that move over the body, equally in both views.
    :param slide_px: 1-sigma of a step of theirs.
    """
    own, body = rig(), rng.uniform(-1, 1, (25, 3)) * [0.3, 0.8, 0.3]
    still = rng.uniform(-1, 1, (strangers, 3)) * [2, 0.5, 2] + path.position(np.array(30.0))
    times = np.arange(count) * 0.15
    s_m = 2.0 + speed * times
    out, slid = [], np.zeros((25 + strangers, 2))
    for t, s in zip(times, s_m):
        views = []
        slid[:sliding] += rng.normal(0, slide_px / F_PX, (sliding, 2))
        for camera, late in ((own.left, 0.0), (own.right, lag_s)):
            at = np.array(s + speed * late)
            points = np.concatenate([path.position(at) + body @ path.frame(at).T, still])
            if camera is own.right:
                points = own.to_right(points)
            xy = points[:, :2] / points[:, 2:]
            views.append(xy + slid + rng.normal(0, NOISE_PX / F_PX, xy.shape))
        out.append(Rays(own, t, lag_s, np.arange(25 + strangers), *views, 1.0))
    return out, s_m


@pytest.mark.parametrize('path', [STRAIGHT, BEND], ids=['straight', 'bend'])
@pytest.mark.parametrize('how', [{}, {'lag_s': 0.005}, {'strangers': 8}],
                         ids=['plain', 'late right view', 'with strangers'])
def test_moves_are_within_their_sigmas(path, how):
    """Differences of positions are normal with their covariance: no gauge, no bias."""
    squares = []
    for seed in range(6):
        seen, s_m = sightings(path, np.random.default_rng(seed), **how)
        places = places_of(seen, path, CONFIG)
        moves = np.diff(places.place[:, 0]) - np.diff(s_m)
        differ = np.diff(np.eye(len(s_m)), axis=0)
        covariance = differ @ places.covariance[:, 0, :, 0] @ differ.T
        squares.append(moves @ np.linalg.solve(covariance, moves) / len(moves))
    # mean of 48 squares of normal numbers: 1-sigma is 0.2; static corners add uncertainty
    assert (0.0 if 'strangers' in how else 0.4) < np.mean(squares) < 1.6


def drawn_speeds(**how):
    """Return errors of the mean speeds of 24 draws, m/s, and their 1-sigmas."""
    errors, stds = [], []
    for seed in range(24):
        seen, s_m = sightings(STRAIGHT, np.random.default_rng(seed), **how)
        places = places_of(seen, STRAIGHT, CONFIG)
        ends = np.zeros(len(s_m))
        ends[[0, -1]] = np.array([-1, 1]) / (places.stamps_s[-1] - places.stamps_s[0])
        errors.append(ends @ (places.place[:, 0] - s_m))
        stds.append(np.sqrt(ends @ places.covariance[:, 0, :, 0] @ ends))
    return np.array(errors), np.array(stds)


@pytest.mark.slow
@pytest.mark.parametrize('sliding', [8, 25], ids=['some', 'all'])
def test_sliding_corners_do_not_make_the_sigma_too_small(sliding):
    """Their errors are correlated between pairs; treated as independent they would average out."""
    errors, stds = drawn_speeds(sliding=sliding)
    # 24 times the mean of 24 squares of normal numbers: one in 20000 is below 6
    assert 0.25 < np.mean((errors / stds) ** 2) < 1 + 4 * 0.29


@pytest.mark.slow
def test_sliding_corners_reduce_the_certainty():
    """Fixed corners have more information; all sliding has less than some sliding."""
    none, some, most = (float(np.mean(drawn_speeds(sliding=n)[1])) for n in (0, 8, 25))
    assert none < some < most


@pytest.fixture
def weighed(monkeypatch):
    """Return a list that collects the noise, residuals and new weights of every round."""
    rounds, real = [], rigid._weights

    def spy(corners, noise, residual, dof):
        rounds.append((corners, noise, residual, real(corners, noise, residual, dof)))
        return rounds[-1][-1]
    monkeypatch.setattr(rigid, '_weights', spy)
    return rounds


def test_single_outlier_gets_the_textbook_weight(weighed):
    """By hand: one that is off by r of the scale counts (dof + 4) / (dof + r^2)."""
    seen, _ = sightings(STRAIGHT, np.random.default_rng(1))
    off = 30 * NOISE_PX / F_PX
    seen[4].left[7, 0] += off
    places_of(seen, STRAIGHT, CONFIG)
    assert len(weighed) < 10, 'it converges'
    corners, noise, _, weight = weighed[-1]
    one = (corners.pair == 4) & (corners.corner == 7)
    dof = CONFIG.tail_dof
    # its own noise is a thirtieth of it
    assert weight[one] == pytest.approx((dof + 4) / (dof + off ** 2 / noise.variance), rel=0.15)
    assert weight[~one].min() > 10 * weight[one]


def test_weights_use_the_expected_noise_apart_from_the_slide(weighed):
    """By the normal distribution of the noise, given its sum with a random walk."""
    seen, _ = sightings(STRAIGHT, np.random.default_rng(2), sliding=25, slide_px=0.5)
    places_of(seen, STRAIGHT, CONFIG)
    corners, noise, residual, weight = weighed[-1]
    assert noise.slide.max() > 0
    k = int(np.argmax(noise.slide))
    own = np.diag(1 / noise.weight[corners.corner == k])
    n = np.arange(len(own))
    total = own + 2 * noise.slide[k] * np.minimum(n[:, None], n)
    left, right = residual[corners.corner == k, :2], residual[corners.corner == k, 2:]
    given = own @ np.linalg.inv(total)
    squares = np.sum((given @ (left + right)) ** 2 + (left - right) ** 2, axis=1) / 2
    spread = np.diag(own - given @ own)
    np.testing.assert_allclose(
        weight[corners.corner == k],
        (CONFIG.tail_dof + 4) / (CONFIG.tail_dof + squares / noise.variance + 2 * spread))


def test_corners_are_grouped_to_fit_into_memory(monkeypatch):
    """With 120 pairs of 25 corners the full matrix of slopes would take 35 MB."""
    seen, _ = sightings(STRAIGHT, np.random.default_rng(0), count=120, speed=2.0)
    tracemalloc.start()
    try:
        one_by_one = places_of(seen, STRAIGHT, CONFIG)
        assert tracemalloc.get_traced_memory()[1] < 30e6
    finally:
        tracemalloc.stop()
    monkeypatch.setattr(rigid, '_MOST_SQUARED', 10 ** 9)
    at_once = places_of(seen, STRAIGHT, CONFIG)
    np.testing.assert_allclose(one_by_one.place, at_once.place, atol=1e-9)
    np.testing.assert_allclose(one_by_one.covariance, at_once.covariance, atol=1e-8)


def test_grouping_of_rare_corners_does_not_change_the_result():
    """In groups with others, or each by itself, the result is the same."""
    seen, _ = sightings(STRAIGHT, np.random.default_rng(3), sliding=5)
    rng = np.random.default_rng(4)
    seen = [one.only(rng.uniform(size=len(one.ids)) < 0.6) for one in seen]
    together = places_of(seen, STRAIGHT, CONFIG)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rigid, '_MOST_SQUARED', 1)
        alone = places_of(seen, STRAIGHT, CONFIG)
    np.testing.assert_allclose(together.place, alone.place, atol=1e-9)
    np.testing.assert_allclose(together.covariance, alone.covariance, atol=1e-8)


def test_move_by_hand():
    """Without noise a move is exact, except for the prior of the depth of a front."""
    seen, s_m = sightings(STRAIGHT, np.random.default_rng(0), count=4)
    exact = list(seen)
    body = np.random.default_rng(0).uniform(-1, 1, (25, 3)) * [0.3, 0.8, 0.3]
    own = rig()
    for k, s in enumerate(s_m):
        points = STRAIGHT.position(np.array(s)) + body @ STRAIGHT.frame(np.array(s)).T
        right = own.to_right(points)
        exact[k] = Rays(own, seen[k].stamp_s, 0.0, seen[k].ids, points[:, :2] / points[:, 2:],
                        right[:, :2] / right[:, 2:], 1.0)
    places = places_of(exact, STRAIGHT, CONFIG)
    np.testing.assert_allclose(np.diff(places.place[:, 0]), np.diff(s_m), rtol=3e-3)


def test_shared_error_of_a_pair_is_that_of_its_disparity():
    """By hand: a disparity error of e px moves a point at Z by Z^2 e / (f b)."""
    seen, _ = sightings(STRAIGHT, np.random.default_rng(0), count=4)
    one, floor = (places_of(seen, STRAIGHT, SecondConfig(match_floor_px=px)).covariance[0, 0, 0, 0]
                  for px in (0.0, 0.05))
    z_m = 68.0
    assert np.sqrt(floor - one) == pytest.approx(z_m ** 2 * 0.05 / (F_PX * 0.5), rel=0.03)


def test_corners_without_a_ray_are_left_out():
    seen, _ = sightings(STRAIGHT, np.random.default_rng(0), count=1)
    seen[0].left[3, 1] = np.nan
    assert len(seen[0].finite().ids) == 24 and 3 not in seen[0].finite().ids
