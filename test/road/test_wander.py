# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Wandering lines: probabilities by hand, evidence against the dense Gaussian, residuals."""
from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal
from stereo_speed.road.first_guess import guess_road
from stereo_speed.road.problem import Picks, RoadPrior, RoadProblem
from stereo_speed.road.wander import MayWander, wander_of, WanderEvidence, Ways

COUNT, LENGTH_M = 60, 10.0


def two_lines(rng):
    """Return places (n,), derivatives (n,) by a line's place, and the modes of both lines."""
    s, per_m = np.linspace(0.0, 60.0, COUNT), rng.uniform(600, 1800, COUNT)
    mine = np.arange(COUNT) % 2
    return s, per_m, [Ways.of(np.flatnonzero(mine == i), per_m[mine == i], s[mine == i], LENGTH_M)
                      for i in (0, 1)]


def dense(s, per_m, std_m):
    """Return the covariance (n, n) of picks of two wandering lines in turn, in their own order."""
    out = np.zeros((COUNT, COUNT))
    for i, std in enumerate(std_m):
        own = np.ix_(np.arange(COUNT) % 2 == i, np.arange(COUNT) % 2 == i)
        out[own] = std**2 * (np.outer(per_m, per_m) * np.exp(
            -np.abs(s[:, None] - s) / LENGTH_M))[own]
    return out


def test_probabilities_hand_worked():
    """The second of two lines resembles the first: 3/4, then (3/4 + 1) / 2, and so on."""
    may = MayWander((0.0, 0.002), (0.75, 0.25))
    assert may.log_chance((0, 0)) == pytest.approx(math.log(3 / 4 * 1.75 / 2))
    for mixed in ((0, 1), (1, 0)):
        assert may.log_chance(mixed) == pytest.approx(math.log(3 / 4 * 0.25 / 2))
    assert may.log_chance((1, 1)) == pytest.approx(math.log(1 / 4 * 1.25 / 2))
    both = [(a, b) for a in (0, 1) for b in (0, 1)]
    assert sum(math.exp(may.log_chance(one)) for one in both) == pytest.approx(1)


def test_choices_follow_the_parameters():
    may = RoadPrior(wander_std_m=0.006, wander_probability=0.3).may_wander
    assert may.std_m == pytest.approx((0, 0.002, 0.006, 0.018))
    assert may.weight[0] / sum(may.weight) == pytest.approx(0.7)
    assert RoadPrior(wander_probability=0.0).may_wander.std_m == (0.0,)


@pytest.mark.parametrize('beyond', [0.0, 300.0], ids=['all told', 'more than squares tell'])
def test_evidence_against_the_dense_gaussian(beyond):
    """Unknowns eliminated, and the scatter of the picks optimised in another way."""
    rng = np.random.default_rng(0)
    s, per_m, ways = two_lines(rng)
    slope = np.column_stack([rng.normal(size=(COUNT, 2)), per_m * (np.arange(COUNT) % 2)])
    weak = np.eye(3)
    off = np.linalg.cholesky(dense(s, per_m, (0.002, 0.001)) + 1.5 * np.eye(COUNT)) @ rng.normal(
        size=COUNT)
    evidence = WanderEvidence(
        ways, np.append(off, np.zeros(3)), np.vstack([slope, weak]), beyond, 1e-4)

    def oracle(std_m):
        def unlikely(log_variance):
            return 0.5 * beyond * math.exp(-log_variance) - multivariate_normal(
                np.zeros(COUNT), slope @ slope.T + dense(s, per_m, std_m)
                + math.exp(log_variance) * np.eye(COUNT)).logpdf(off)
        return -minimize_scalar(unlikely, bounds=(-3, 3), method='bounded').fun
    tries = [(0.0, 0.0), (0.001, 0.0), (0.0, 0.003), (0.002, 0.001)]
    got = np.array([evidence.at(std_m) for std_m in tries])
    wanted = np.array([oracle(std_m) for std_m in tries])
    # the scatter is found to a few percent
    np.testing.assert_allclose(got - got[0], wanted - wanted[0], atol=0.4)
    assert np.ptp(wanted) > 5


def test_wandering_line_is_found_and_the_other_one_unchanged():
    rng = np.random.default_rng(1)
    s, per_m, ways = two_lines(rng)
    off = np.linalg.cholesky(dense(s, per_m, (0.0, 0.003)) + np.eye(COUNT)) @ rng.normal(
        size=COUNT)
    slope = np.column_stack([per_m * (np.arange(COUNT) % 2 == i) for i in (0, 1)])
    evidence = WanderEvidence(ways, off, slope, 0.0, 1e-4)
    still, moved = evidence.asked(RoadPrior().may_wander)[1]
    assert still < 0.001 < moved < 0.009
    assert evidence.asked(MayWander((0.0,), (1.0,)))[1] == (0.0, 0.0)


def test_modes_add_up_to_the_covariance_of_the_line():
    """The modes left out make less than a hundredth of a pick's variance."""
    s, per_m, ways = two_lines(np.random.default_rng(2))
    wander = wander_of(ways, (0.002, 0.0), COUNT)
    np.testing.assert_allclose(
        wander.off @ wander.off.T, dense(s, per_m, (0.002, 0.0)), atol=0.01)
    information = np.linalg.inv(wander.off.T @ wander.off + np.eye(wander.count))
    assert wander.told == pytest.approx(wander.count - np.trace(information))


def test_residuals_and_derivatives_of_wandering_lines(make_scene):
    """Amplitudes of the modes follow the other unknowns: linear, with a 1-sigma of 1."""
    scene = make_scene()
    model, x = guess_road(scene.rig, list(scene.lines.values()), 0)
    picks, rng = Picks.of(scene.lines), np.random.default_rng(3)
    rigid = RoadProblem(scene.rig, picks, model)
    off = rng.normal(size=(len(picks.line), 2))
    loose = RoadProblem(scene.rig, picks, model, wander=replace(
        wander_of([], (), len(picks.line)), off=off))
    unknowns = np.append(x, [0.5, -2.0])
    own, priors = np.split(rigid.residuals(x), [len(picks.line)])
    np.testing.assert_allclose(loose.residuals(unknowns), np.concatenate(
        [own - 0.5 * off[:, 0] + 2.0 * off[:, 1], priors, [0.5, -2.0]]))
    got, h = loose.jacobian(unknowns), 1e-5
    for i in range(len(unknowns)):
        step = h * np.eye(len(unknowns))[i]
        wanted = (loose.residuals(unknowns + step) - loose.residuals(unknowns - step)) / (2 * h)
        np.testing.assert_allclose(got[:, i], wanted, atol=2e-3 * np.abs(wanted).max())
