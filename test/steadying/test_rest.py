# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The mean pose of a swaying rig, and its uncertainty."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.steadying.rest import Rest, REST_PAIRS

PRIOR_RAD = 1e-3


def rest_of_poses(poses):
    """Return the rest of a rig that sways."""
    rest = Rest(PRIOR_RAD)
    for pose in poses:
        rest.add(pose)
    rest.moves = True
    return rest


def test_uncertainty_by_hand():
    """The mean of four poses 2, 0, 2 and 0; each square is about the mean so far."""
    poses = 1e-3 * np.array([2.0, 0.0, 2.0, 0.0])[:, None] * np.ones(3)
    rest = rest_of_poses(poses)
    assert rest.mean_rad == pytest.approx(np.full(3, 1e-3))
    about = 1e-6 * (1 + 0 + 1 + (2 - 4 / 3) ** 2 + 1)  # the prior's first
    assert np.diag(rest.covariance_rad2) == pytest.approx(np.full(3, about / 4 / 3))


def test_rig_that_stands_still_has_a_certain_rest():
    rest = rest_of_poses([np.zeros(3)])
    assert np.diag(rest.covariance_rad2) == pytest.approx(np.full(3, 4 * PRIOR_RAD ** 2))
    rest.moves = False
    assert not rest.covariance_rad2.any()


@pytest.mark.parametrize('alike', [0.0, 0.6, 0.9])
@pytest.mark.parametrize('pairs', [20, REST_PAIRS])
def test_uncertainty_covers_the_error_of_the_mean(alike, pairs):
    """A mast sways slowly: neighbouring poses are alike, and their mean less certain."""
    rng, squares = np.random.default_rng(3), []
    for _ in range(100):
        noise = np.sqrt(1 - alike ** 2) * rng.standard_normal((pairs + 50, 3))
        poses = [noise[0]]
        for step in noise[1:]:
            poses.append(alike * poses[-1] + step)
        rest = rest_of_poses(2e-3 * np.array(poses[50:]))
        squares.append(rest.mean_rad ** 2 / np.diag(rest.covariance_rad2))
    assert 0.7 < np.sqrt(np.mean(squares)) < 1.3


def test_later_mean_follows_a_slow_change_but_not_its_uncertainty():
    rest = rest_of_poses(1e-3 * np.random.default_rng(1).standard_normal((REST_PAIRS, 3)))
    known = rest.covariance_rad2
    for _ in range(5 * REST_PAIRS):
        rest.add(np.full(3, 0.01))
    assert rest.mean_rad == pytest.approx(np.full(3, 0.01), rel=0.02)
    assert np.array_equal(rest.covariance_rad2, known)
