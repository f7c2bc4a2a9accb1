# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The mean pose of a swaying rig, and its uncertainty."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.steadying.rest import Rest, REST_PAIRS

PRIOR_RAD = np.radians(0.05)
SWAY_RAD = np.radians(0.1)


def rest_of_poses(poses, fps=10.0, swayed=True):
    """Return the rest of a rig after some poses."""
    rest = Rest(PRIOR_RAD)
    for k, pose in enumerate(poses):
        rest.add(pose, round(k / fps * 1e9), swayed)
    return rest


def error_over_std(poses_of, seeds=150):
    """Return the r.m.s. of the error of the rest over its 1-sigma; the true one is zero."""
    squares = []
    for seed in range(seeds):
        mean, covariance = rest_of_poses(poses_of(np.random.default_rng(seed))).standing
        squares.append(mean ** 2 / np.diag(covariance))
    return float(np.sqrt(np.mean(squares)))


def test_uncertainty_by_hand():
    """Seven poses 2, 0, 2, ... of three equal angles; neighbours are opposed, so none is alike."""
    poses = 1e-3 * np.array([2.0, 0, 2, 0, 2, 0, 2])[:, None] * np.ones(3)
    mean, covariance = rest_of_poses(poses).standing
    assert mean == pytest.approx(np.full(3, 8e-3 / 7))
    running = np.cumsum(poses[:, 0]) / np.arange(1, 8)
    square = PRIOR_RAD ** 2 + np.sum((poses[:, 0] - running) ** 2)
    assert np.diag(covariance) == pytest.approx(
        np.full(3, square / 7 / 6 + (PRIOR_RAD / 7) ** 2))


def test_few_poses_tell_little():
    _, covariance = rest_of_poses(np.zeros((4, 3))).standing
    # Four fifths of them count as one, and of the assumed sway.
    assert np.diag(covariance) == pytest.approx(
        np.full(3, PRIOR_RAD ** 2 / 4 * 3.2 / 0.8 + 0.64 * PRIOR_RAD ** 2))


def test_rig_that_stands_still_has_a_certain_rest():
    rest = rest_of_poses(np.full((9, 3), 1e-3), swayed=False)
    assert not rest.moves and not any(map(np.any, rest.standing))
    rest.add(np.full(3, 1e-3), 10**9, True)
    assert not rest.moves  # one alone may be chance
    rest.add(np.full(3, 1e-3), 2 * 10**9, True)
    assert rest.moves and all(map(np.any, rest.standing))


@pytest.mark.parametrize('alike', [0.0, 0.6, 0.9])
@pytest.mark.parametrize('pairs', [10, 15, 20, REST_PAIRS])
def test_uncertainty_covers_the_error_of_the_mean(alike, pairs):
    """A mast sways slowly: neighbouring poses are alike, and their mean less certain."""
    def poses_of(rng):
        noise = np.sqrt(1 - alike ** 2) * rng.standard_normal((pairs + 50, 3))
        poses = [noise[0]]
        for step in noise[1:]:
            poses.append(alike * poses[-1] + step)
        return SWAY_RAD * np.array(poses[50:])
    assert 0.3 < error_over_std(poses_of) < 1.4


@pytest.mark.parametrize('hz, fps, pairs', [
    (0.5, 20, 15), (0.3, 10, 15), (2.0, 10, 15), (0.3, 30, 90), (0.3, 20, 60), (1.0, 30, 90)])
def test_uncertainty_covers_waves(hz, fps, pairs):
    """Part of a period, as in a short bag, and what a node has seen once it measures."""
    def poses_of(rng):
        phase = rng.uniform(0, 2 * np.pi, 3)
        wave = np.sin(2 * np.pi * hz * np.arange(pairs)[:, None] / fps + phase)
        return np.sqrt(2) * SWAY_RAD * wave
    assert error_over_std(poses_of) < 1.4


def test_rest_is_settled_and_averaged_after_enough_pairs_and_time():
    fast, slow = Rest(PRIOR_RAD), Rest(PRIOR_RAD)
    settled, averaged = [], []
    for k in range(400):
        for rest, ns in ((fast, k * 33_333_333), (slow, k * 10**9)):
            rest.add(np.zeros(3), ns, True)
        settled.append((fast.is_settled, slow.is_settled))
        averaged.append((fast.is_averaged, slow.is_averaged))
    # at 30 pairs a second the time decides, at one a second the number of pairs
    assert [list(column).index(True) for column in zip(*settled)] == [91, 19]
    assert [list(column).index(True) for column in zip(*averaged)] == [301, 99]


def test_later_mean_follows_a_slow_change_but_not_its_uncertainty():
    rest = rest_of_poses(1e-3 * np.random.default_rng(1).standard_normal((REST_PAIRS, 3)), fps=5.0)
    known = rest.standing[1]
    for k in range(5 * REST_PAIRS):
        rest.add(np.full(3, 0.01), (100 + k) * 10**9, True)
    assert rest.standing[0] == pytest.approx(np.full(3, 0.01), rel=0.02)
    assert np.array_equal(rest.standing[1], known)
