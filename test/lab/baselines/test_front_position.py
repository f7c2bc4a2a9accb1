# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The position of a front from its points, and its displacement."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from stereo_speed.lab.baselines.front_position import agreeing, displacement, position_of_front
from stereo_speed.lab.baselines.matthies_shafer import covariances
from stereo_speed.lab.baselines.settings import PointSettings

NORMAL = np.array([0.0, 0, -1])
CENTRE = np.array([0.1, -0.2, 40.0])
SETTINGS = PointSettings(match_std_px=0.1, common_std_px=0.0)
TRIALS = 60


def points(rng, count=40):
    """Return random points of a front."""
    return CENTRE + np.column_stack([rng.uniform(-1, 1, (count, 2)), np.zeros(count)])


def with_errors(rig, rng, exact):
    """Return points with errors drawn from their covariances."""
    root = np.linalg.cholesky(covariances(rig, exact, SETTINGS.match_std_px))
    return exact + np.einsum('nij,nj->ni', root, rng.standard_normal(exact.shape))


def test_exact_points_give_the_exact_centre(parallel):
    found = position_of_front(parallel, points(np.random.default_rng(0)),
                              parallel.project(CENTRE[None])[0][0], NORMAL, SETTINGS)
    np.testing.assert_allclose(found.mean, CENTRE, atol=1e-9)
    assert found.used.all()


def test_position_error_has_the_claimed_covariance(parallel):
    rng = np.random.default_rng(1)
    uv = parallel.project(CENTRE[None])[0][0]
    total = 0.0
    for _ in range(TRIALS):
        found = position_of_front(
            parallel, with_errors(parallel, rng, points(rng)),
            uv + SETTINGS.centre_std_px * rng.standard_normal(2), NORMAL, SETTINGS)
        off = found.mean - CENTRE
        total += off @ np.linalg.solve(found.cov, off)
    # Scatter beyond the expected one widens the covariance, so that the sum is below chi-square.
    assert 0.6 * chi2.ppf(1e-4, 3 * TRIALS) < total < chi2.isf(1e-4, 3 * TRIALS)


def test_background_is_left_out(parallel):
    rng = np.random.default_rng(1)
    several = with_errors(parallel, rng, points(rng))
    several[:6, 2] += 15
    found = position_of_front(parallel, several, parallel.project(CENTRE[None])[0][0], NORMAL,
                              SETTINGS)
    assert not found.used[:6].any() and found.used[6:].sum() >= 30
    off = found.mean - CENTRE
    assert off @ np.linalg.solve(found.cov, off) < chi2.isf(1e-4, 3)


def test_displacement_error_has_the_claimed_covariance(parallel):
    rng, motion = np.random.default_rng(2), np.array([0.1, 0.2, -4.0])
    total = 0.0
    for _ in range(TRIALS):
        exact = points(rng)
        before, after = (with_errors(parallel, rng, x) for x in (exact, exact + motion))
        after[:4] += [0, 0, 9.0]
        found = displacement(parallel, before, after, NORMAL, SETTINGS)
        assert not found.used[:4].any()
        off = found.mean - motion
        total += off @ np.linalg.solve(found.cov, off)
    assert 0.6 * chi2.ppf(1e-4, 3 * TRIALS) < total < chi2.isf(1e-4, 3 * TRIALS)


def test_shared_error_does_not_average_out(parallel):
    rng, uv = np.random.default_rng(3), parallel.project(CENTRE[None])[0][0]
    shared = PointSettings(match_std_px=0.1, common_std_px=0.1)
    few, many = (position_of_front(parallel, points(rng, n), uv, NORMAL, shared).cov[2, 2]
                 for n in (100, 10_000))
    single = covariances(parallel, CENTRE[None], 0.1)[0, 2, 2]
    assert few > many > single and many == pytest.approx(single, rel=0.02)


def test_too_few_points_give_nothing(parallel):
    rng = np.random.default_rng(0)
    few, uv = points(rng, 2), parallel.project(CENTRE[None])[0][0]
    assert position_of_front(parallel, few, uv, NORMAL, SETTINGS) is None
    assert displacement(parallel, few, few, NORMAL, SETTINGS) is None
    more = points(rng, 5)
    assert position_of_front(parallel, more, uv, NORMAL, PointSettings(least_points=6)) is None


def test_agreeing_returns_the_excess_scatter():
    used, scale = agreeing(np.array([0.0, 0.1, -0.1, 9.0]), np.full(4, 0.1), 3.0)
    assert used.tolist() == [True, True, True, False] and 1 <= scale < 2
    values = np.random.default_rng(0).normal(0, 0.5, 20_000)
    assert agreeing(values, np.full(len(values), 0.1), 3.0)[1] == pytest.approx(5.0, rel=0.05)
