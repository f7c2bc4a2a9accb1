# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Places of a body whose corners project with known noise."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.config import SecondConfig
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import of_camera, StereoRig
from stereo_speed.road.path import SplinePath, StraightPath
from stereo_speed.second.rigid import places_of, Rays

F_PX, NOISE_PX = 1600.0, 0.1
K = np.array([[F_PX, 0, 512], [0, F_PX, 384], [0, 0, 1.0]])
CONFIG = SecondConfig(match_floor_px=0.0)


def rig() -> StereoRig:
    """Return cameras that converge a little."""
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
    Return rays of 25 corners and of some that stand still beside the road, and true places.

    :param sliding: so many of the corners walk over the body, the same in both views.
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
    """Differences of places are normal with their covariance: no gauge, no bias."""
    squares = []
    for seed in range(6):
        seen, s_m = sightings(path, np.random.default_rng(seed), **how)
        places = places_of(seen, path, CONFIG)
        moves = np.diff(places.place[:, 0]) - np.diff(s_m)
        differ = np.diff(np.eye(len(s_m)), axis=0)
        covariance = differ @ places.covariance[:, 0, :, 0] @ differ.T
        squares.append(moves @ np.linalg.solve(covariance, moves) / len(moves))
    # mean of 48 squares of normal numbers: 1-sigma is 0.2; strangers cost certainty
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
def test_corners_that_slide_leave_an_honest_speed(sliding):
    """Their errors stay from pair to pair: as independent ones they would be averaged away."""
    errors, stds = drawn_speeds(sliding=sliding)
    # mean of 24 squares of normal numbers: 1-sigma is 0.29
    assert np.mean((errors / stds) ** 2) < 1 + 4 * 0.29


@pytest.mark.slow
def test_corners_that_slide_cost_certainty():
    """What stays on the body tells more, and corners that all slide less than some of them."""
    none, some, most = (float(np.mean(drawn_speeds(sliding=n)[1])) for n in (0, 8, 25))
    assert none < some < most


def test_a_move_as_by_hand():
    """Without noise a move is exact, but for what is known of any front beforehand: its depth."""
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
    """By hand: a disparity off by e px moves what is at Z by Z^2 e / (f b)."""
    seen, _ = sightings(STRAIGHT, np.random.default_rng(0), count=4)
    one, floor = (places_of(seen, STRAIGHT, SecondConfig(match_floor_px=px)).covariance[0, 0, 0, 0]
                  for px in (0.0, 0.05))
    z_m = 68.0
    assert np.sqrt(floor - one) == pytest.approx(z_m ** 2 * 0.05 / (F_PX * 0.5), rel=0.03)


def test_corners_without_a_ray_are_left_out():
    seen, _ = sightings(STRAIGHT, np.random.default_rng(0), count=1)
    seen[0].left[3, 1] = np.nan
    assert len(seen[0].finite().ids) == 24 and 3 not in seen[0].finite().ids
