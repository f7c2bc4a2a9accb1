# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The least-squares problem of a road: picks, feet and priors, by hand and by brute force."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.road.model import RoadModel, RoadShape
from stereo_speed.road.problem import DriftPrior, Picks, RoadPrior, RoadProblem

FRAME = np.array([[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]])
MODEL = RoadModel(FRAME, np.array([0, 3.0, 40]), 25.0, 2)
X = np.array([0, 0, 0, 0, -2.0, 1.5])


def picks_on(rig, off_px=0.0):
    """Pick points of the two lines of MODEL at X, all displaced equally to the right."""
    z = np.linspace(60, 20, 9)
    lines = {}
    for name, across in (('a', -2.0), ('b', 1.5)):
        points = np.stack([np.full(9, across), np.full(9, 3.0), z], axis=-1)
        left, right = rig.project(points)[:2]
        lines[name] = left + [off_px, 0], right[::2] + [off_px, 0]
    return lines


@pytest.fixture
def rig(make_scene):
    """Return a parallel rig."""
    return make_scene().rig


def test_picks_know_line_view_and_sigma(rig):
    lines = picks_on(rig)
    picks = Picks.of(lines, {'b': (np.full(9, 0.1), np.full(5, 0.2))}, click_std_px=0.4)
    assert picks.names == ('a', 'b') and len(picks.line) == 28
    np.testing.assert_array_equal(picks.uv_px[picks.of_line(1, True)], lines['b'][1])
    assert [picks.of_line(n, r).sum() for n in (0, 1) for r in (False, True)] == [9, 5, 9, 5]
    stds = [set(picks.std_px[picks.of_line(n, r)]) for n in (0, 1) for r in (False, True)]
    assert stds == [{0.4}, {0.4}, {0.1}, {0.2}] and picks.median_std_px == pytest.approx(0.3)


def test_feet_are_where_the_picks_were_made(rig):
    """Exact picks have no residual; that of a pick beside the line is its distance."""
    problem = RoadProblem(rig, Picks.of(picks_on(rig)), MODEL)
    feet = problem.feet(X)
    np.testing.assert_allclose(feet.residual_px, 0, atol=1e-6)
    mine = problem.picks.of_line(0, False)
    np.testing.assert_allclose(feet.s_m[mine], 40 - np.linspace(60, 20, 9), atol=1e-4)
    beside = RoadProblem(rig, Picks.of(picks_on(rig, 2.0)), MODEL).feet(X)
    np.testing.assert_allclose(
        np.abs(beside.residual_px), np.abs(2.0 * beside.normal[:, 0]), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(beside.normal, axis=-1), 1)


def test_feet_by_brute_force(rig):
    """No point of the projected line is nearer than the foot."""
    problem = RoadProblem(rig, Picks.of(picks_on(rig, 1.5)), MODEL)
    feet, z = problem.feet(X), np.linspace(14, 70, 200001)
    for i in (0, 8, 14, 20):
        line = np.stack([np.full_like(z, (-2.0, 1.5)[problem.picks.line[i]]),
                         np.full_like(z, 3.0), z], axis=-1)
        uv = rig.project(line)[int(problem.picks.right[i])]
        nearest = np.linalg.norm(uv - problem.picks.uv_px[i], axis=-1).min()
        assert abs(feet.residual_px[i]) == pytest.approx(nearest, abs=1e-5)


def test_line_behind_the_camera_is_far_off(rig):
    behind = replace(MODEL, centre_m=np.array([0, 3.0, -200.0]))
    problem = RoadProblem(rig, Picks.of(picks_on(rig)), behind)
    assert np.all(problem.feet(X).residual_px == 1e3) and np.isfinite(problem.jacobian(X)).all()


def test_priors_hand_worked(rig):
    """Roll, curvature, grade, crossfall and crest, each over its sigma; then the drift."""
    prior = RoadPrior(roll_std_rad=0.2, grade_std_rad=0.01, crossfall_std_rad=0.02,
                      crest_std_per_m=0.001)
    model = replace(MODEL, shape=RoadShape(1, 2, 1))
    drift = DriftPrior(np.array([1e-4, 0, 0]), np.eye(3) / 1e-4)
    problem = RoadProblem(rig, Picks.of(picks_on(rig)), model, drift, prior)
    x = np.concatenate([X, [0.05], [0.03, 0.0, 0.05], [3e-4, -1e-4, 0.0]])
    np.testing.assert_allclose(
        problem.priors(x), [0, 0.1, 3, 0, 0.05 / (25 * 0.001), 2, -1, 0], atol=1e-9)
    assert problem.size == len(x) and problem.drift_rad(x).tolist() == [3e-4, -1e-4, 0.0]
    rolled = np.concatenate([X, np.zeros(7)])
    rolled[0] = 0.1  # about the direction of travel: the left axis rises
    assert abs(problem.priors(rolled)[0]) == pytest.approx(np.sin(0.1) / 0.2)


def test_priors_of_a_vertical_curve_hand_worked(rig):
    """Middle, log of length over the usual one, and change, each over its sigma."""
    prior = RoadPrior(vertical_curve_m=50.0, vertical_curve_log_std=0.5, crest_std_per_m=0.001)
    model = replace(MODEL, shape=RoadShape(vertical_curve=3))  # half of it is 25 m
    problem = RoadProblem(rig, Picks.of(picks_on(rig)), model, None, prior)
    x = np.concatenate([X, [0.5, np.log(4.0), 0.05]])
    np.testing.assert_allclose(
        problem.priors(x), [0, 0.5, np.log(2) / 0.5, 0.05 / (25 * 0.001)], atol=1e-9)


def test_prior_is_bounded_and_gives_the_calibrated_covariance():
    with pytest.raises(InputError, match='pick_std_px: found 0.0'):
        RoadPrior(pick_std_px=0.0)
    std = np.radians(0.001)
    np.testing.assert_allclose(
        RoadPrior(calibrated_std_deg=0.001).calibrated_covariance_rad2, std**2 * np.eye(3))
