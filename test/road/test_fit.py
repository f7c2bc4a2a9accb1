# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The joint fit against synthetic roads of known shape."""
from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp
from stereo_speed.lab.evaluation.roads import draw_road
from stereo_speed.lab.reference.straight_path import straight_path
from stereo_speed.lab.sim.scene import SimScene
from stereo_speed.lab.sim.sequence import picked_site
from stereo_speed.road import fit as fit_module
from stereo_speed.road.evidence import log_evidences
from stereo_speed.road.first_guess import guess_road
from stereo_speed.road.fit import fit_road, OVERREACH
from stereo_speed.road.fitted import log_chance, ROBUST
from stereo_speed.road.lanes import lane_of_road
from stereo_speed.road.model import RoadShape
from stereo_speed.road.problem import DriftPrior, Picks, RoadPrior, RoadProblem
from stereo_speed.road.run_off import RUN_OFF, TERMS
from stereo_speed.road.solving import same_family
from stereo_speed.road.wander_search import _Squares


def lane_of(scene):
    """Fit the road; return the fit and its first lane."""
    fit = fit_road(scene.rig, scene.lines)
    return fit, lane_of_road('lane', fit, (0, 1), 25.0)


def scale_error(path, scene, last_m=np.inf):
    """Return the relative error of arc length between the ends of the true lane's last stretch."""
    near = scene.s_m >= scene.s_m[-1] - last_m
    s, true = path.arc_length(scene.lane_m[near]), scene.s_m[near]
    return (s[-1] - s[0]) / (true[-1] - true[0]) - 1


@pytest.mark.parametrize('distorted', [False, True], ids=['ideal', 'distorted, not parallel'])
def test_straight_road(make_scene, distorted):
    """With picks of 0.3 px the direction is right to 0.05 degrees."""
    scene = make_scene(distorted=distorted, grade=-0.03)
    fit, lane = lane_of(scene)
    assert fit.problem.model.shape.curvature == 0
    assert np.degrees(np.arccos(lane.path.tangent(0.0) @ scene.tangent[0])) < 0.05
    assert 0.15 < lane.residual_px < 0.45
    gap = scene.lane_m - lane.path.position(lane.path.arc_length(scene.lane_m))
    assert np.linalg.norm(gap, axis=-1).max() < 0.15
    assert np.all(lane.path.frame(0.0)[:, 2][1] < -0.9)
    assert lane.heading_std_rad.shape == (2,)


@pytest.mark.parametrize('count', [2, 3, 4])
def test_road_through_few_clicks_is_as_uncertain_as_they_are(make_scene, count):
    """Two clicks in each view lie on one line whatever their errors are."""
    scene, rng = make_scene(), np.random.default_rng(count)
    along = np.linspace(0, len(scene.lane_m) - 1, count).round().astype(int)
    exact = scene.rig.project(scene.lane_m[along])[:2]
    scores = []
    for _ in range(30):
        fit = fit_road(scene.rig, {'line': tuple(
            uv + rng.normal(0, 0.3, uv.shape) for uv in exact)})
        lane = lane_of_road('lane', fit, (0,), None)
        middle, axes = lane.path.length_m / 2, lane.path.frame(lane.path.length_m / 2)
        near = int(np.argmin(np.linalg.norm(scene.lane_m - lane.path.position(middle), axis=-1)))
        scores.append((scene.tangent[near] @ axes[:, 1:]) / lane.heading_std_rad)
    assert (np.sqrt(np.mean(np.square(scores), axis=0)) < 1.4).all()
    assert np.abs(scores).max() < 4.0


@pytest.mark.parametrize('grade, bends', [(0.0, 0), (0.02, 1)], ids=['level', '2 % grade'])
def test_curve_of_41_m(make_scene, grade, bends):
    """A climbing curve is not planar; the fit detects that automatically."""
    scene = make_scene(curvature=1 / 41, grade=grade, seed=5)
    fit, lane = lane_of(scene)
    shape = fit.problem.model.shape
    assert shape.curvature >= 1 and sum(shape[1:]) >= bends
    assert abs(scale_error(lane.path, scene, 30.0)) < 0.001
    assert abs(scale_error(lane.path, scene)) < 0.01


def test_exact_picks_give_the_exact_road(make_scene):
    """Without scatter only the interpolation of the picks contributes an error."""
    scene = make_scene(curvature=1 / 80, std_px=0.0)
    _, lane = lane_of(scene)
    assert abs(scale_error(lane.path, scene)) < 1e-4
    gap = scene.lane_m - lane.path.position(lane.path.arc_length(scene.lane_m))
    assert np.linalg.norm(gap, axis=-1).max() < 0.02
    assert lane.residual_px < 0.02


@pytest.mark.slow
def test_claimed_scatter_is_the_scatter(make_scene):
    """Over 24 draws, errors in the middle have the claimed 1-sigma within sampling error."""
    scores = []
    for seed in range(24):
        scene = make_scene(seed=seed)
        fit, lane = lane_of(scene)
        path, middle = lane.path, lane.path.length_m / 2
        if fit.problem.model.shape.curvature:
            continue
        at = np.argmin(np.abs(path.arc_length(scene.lane_m) - middle))
        s = path.arc_length(scene.lane_m[at])
        axes = path.frame(s)[:, 1:]
        scores.append(scene.tangent[at] @ axes / lane.heading_std_rad)
    assert len(scores) >= 22  # a straight road is rarely taken for a curve
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all((rms > 0.6) & (rms < 1.5)), rms


def test_single_straight_line_equals_the_closed_form(make_scene):
    """Two image lines determine exactly its unknowns: the fit is that of 2012, eq. 19-21."""
    scene = make_scene(seed=2)
    left, right = scene.lines['line_0']
    fit = fit_road(scene.rig, {'line_0': (left, right)})
    path = lane_of_road('lane', fit, (0,), None).path
    alone = straight_path(scene.rig, left, right)
    assert fit.problem.model.shape.curvature == 0
    assert np.linalg.norm(np.cross(path.tangent(0.0), alone.tangent(0.0))) < 1e-4
    for s in (0.0, path.length_m):
        off = path.position(s) - alone.position(0.0)
        assert np.linalg.norm(np.cross(off, alone.tangent(0.0))) < 0.01  # at 85 m and nearer


def test_single_outlier_pick_has_little_influence(make_scene):
    """A pick 15 px off moves the direction by less than 0.1 degrees."""
    scene = make_scene(seed=3)
    lines = {name: (left.copy(), right.copy()) for name, (left, right) in scene.lines.items()}
    lines['line_0'][0][6] += [15.0, 0.0]
    lane = lane_of_road('lane', fit_road(scene.rig, lines), (0, 1), None)
    assert np.degrees(np.arccos(lane.path.tangent(0.0) @ scene.tangent[0])) < 0.1


@pytest.mark.parametrize('beside', [0.0, 1e-3], ids=['fit', 'beside it'])
def test_squares_are_tangent_to_the_robust_cost(make_scene, beside):
    """They equal that of the picks, and so do their gradients, with or without stray picks."""
    scene = make_scene(seed=3)
    lines = {name: (left.copy(), right.copy()) for name, (left, right) in scene.lines.items()}
    lines['line_0'][0][6] += [15.0, 0.0]
    fit = fit_road(scene.rig, lines)
    fit = replace(fit, x=fit.x + beside)
    count = len(fit.problem.picks.line)

    def cost(x):  # soft L1
        off = fit.problem.residuals(x)[:count]
        return 2 * ROBUST**2 * np.sum(np.sqrt(1 + (off / ROBUST)**2) - 1)
    squares = _Squares.at(fit)
    own = squares.own * fit.off
    assert np.abs(fit.off).max() > 3 * ROBUST and squares.own.min() < 0.6
    assert own @ own + squares.beyond == pytest.approx(cost(fit.x), rel=1e-12)
    weighted = squares.slope[:, None] * fit.slope[:count]
    steps = 1e-6 * np.eye(len(fit.x))
    by_differences = [(cost(fit.x + step) - cost(fit.x - step)) / 2e-6 for step in steps]
    share = (2 * own @ weighted - by_differences) / (2 * np.abs(own) @ np.abs(weighted))
    assert np.abs(share).max() < 1e-4  # of what adds up to the gradient


def test_single_line(make_scene):
    """One line determines its direction too; up is then the camera's."""
    scene = make_scene()
    fit = fit_road(scene.rig, {'line_0': scene.lines['line_0']})
    lane = lane_of_road('lane', fit, (0,), None)
    off = scene.tangent[0] @ lane.path.frame(0.0)[:, 1:]
    assert np.all(np.abs(off) < 4 * lane.heading_std_rad)
    assert np.all(lane.heading_std_rad < np.radians(1.0))


@pytest.mark.parametrize('shape', [RoadShape(2, 2, 1, 1), RoadShape(2, 2, 0, 1, 3),
                                   RoadShape(1, 2, 0, 0, 3, RUN_OFF)])
def test_jacobian_against_differences(make_scene, shape):
    """The analytic elimination of the feet gives the derivative of the residuals."""
    scene = make_scene(curvature=1 / 60)
    model, x = guess_road(scene.rig, list(scene.lines.values()), 2)
    model, x = model.reshaped(shape, x, tapered=True)
    x[model.places.vertical_curve] = np.array([0.1, -0.3, 0.01])[:shape.vertical_curve]
    x[model.places.run_off] = np.linspace(0.01, 3.0, RUN_OFF)[:shape.run_off] * (
        np.append(np.full(2 * TERMS, 1e-3), 1.0)[:shape.run_off])
    problem = RoadProblem(scene.rig, Picks.of(scene.lines), model)
    got, h = problem.jacobian(x), 1e-5
    for i in range(model.size):
        step = np.zeros(model.size)
        step[i] = h
        wanted = (problem.residuals(x + step) - problem.residuals(x - step)) / (2 * h)
        np.testing.assert_allclose(
            got[:, i], wanted, atol=2e-3 * np.abs(wanted).max(), err_msg=f'parameter {i}')


def test_views_without_common_points_are_refused(make_scene):
    """Level lines under a level baseline give no road."""
    flat = np.stack([np.linspace(100, 900, 10), np.full(10, 400.0)], axis=-1)
    with pytest.raises(ValueError, match='fewer than 3 points in common'):
        fit_road(make_scene().rig, {'a': (flat, flat - [10, 0])})


@pytest.mark.parametrize('number', [43, 47])
def test_straight_road_through_a_sag_is_no_bend(number):
    """From a low camera precise points of a sag look much like those of a bend."""
    config, std_px = replace(draw_road(0, number).config, pick_std_px=0.02), 0.02
    scene = SimScene(config)
    site = picked_site(scene, np.random.default_rng(1))
    lines = {name: (np.array(line['left_image']), np.array(line['right_image']))
             for name, line in site['lines'].items()}
    fit = fit_road(scene.rig, lines, {name: tuple(np.full(len(view), std_px) for view in views)
                                      for name, views in lines.items()})
    assert fit.problem.model.shape.curvature == 0
    assert fit.residual_px.max() < 0.2


def banked_bend(s_m, left_m):
    """
    Return points (n, 3) of a bend whose crossfall builds up evenly from 20 to 80 of its 85 m.

    As in real roads the crossfall starts and stops changing abruptly, unlike a polynomial.
    """
    f = np.linspace(0.0, 85.0, 4001)
    curvature = np.interp(f, [0, 85], [0.006, 0.009])
    psi = np.append(0.0, np.cumsum((curvature[1:] + curvature[:-1]) / 2 * np.diff(f)))
    psi -= np.interp(55.0, f, psi)
    along = np.stack([np.sin(psi), -np.cos(psi)], axis=-1)
    plan = np.concatenate([np.zeros((1, 2)), np.cumsum(
        (along[1:] + along[:-1]) / 2 * np.diff(f)[:, None], axis=0)])
    plan += [-3.0, 8.0] - plan[-1]
    x, z, heading = (np.interp(s_m, f, values) for values in (*plan.T, psi))
    up = 0.02 * (s_m - 85.0) + left_m * np.interp(s_m, [20, 80], [-0.02, -0.055])
    return np.stack([x + left_m * np.cos(heading), 5.0 - up, z + left_m * np.sin(heading)], -1)


def banked_picks(rig):
    """Return exact picks of that bend's lines, and their 1-sigmas of 0.02 px."""
    s, lines = np.linspace(0.0, 85.0, 80), {}
    for name, left_m in (('right', -1.75), ('middle', 1.75), ('left', 5.25)):
        left, right, in_left, in_right = rig.project(banked_bend(s, left_m))
        lines[name] = left[in_left], right[in_right]
    return lines, {name: tuple(np.full(len(view), 0.02) for view in views)
                   for name, views in lines.items()}


def test_evenly_built_up_crossfall_is_modelled(make_scene):
    """Otherwise it would be explained by a turned camera, or by more bends."""
    rig = make_scene().rig
    fit = fit_road(rig, *banked_picks(rig), prior=RoadPrior(wander_probability=0.0))
    model = fit.problem.model
    assert model.shape._replace(curvature=1) == RoadShape(1, 2, run_off=RUN_OFF)
    changes = slice(model.places.curvature.start + 1, model.places.curvature.stop)
    assert changes.stop - changes.start <= 1  # a slight change is as probable as none
    assert np.all(np.abs(fit.x[changes]) < 3 * np.sqrt(np.diag(fit.covariance)[changes]))
    assert fit.residual_px.max() < 0.03


def test_residuals_of_a_built_crossfall_are_no_rotated_camera(make_scene):
    """A run-off explains them; polynomials without one demand a 2.5 sigma rotation."""
    rig = make_scene().rig
    fit = fit_road(rig, *banked_picks(rig), DriftPrior.loose(np.radians(0.05)))
    assert np.all(np.abs(fit.drift_rad) < 1.5 * np.sqrt(np.diag(fit.covariance)[-3:]))


def plain_picks(rig, rng, off_m, std_px=0.03, count=40):
    """
    Return lines of a flat straight road, some of them displaced, and their 1-sigmas.

    :param off_m: name of a line to a function that gives its displacement to the left at places
    along 85 m.
    """
    s, lines = np.linspace(0.0, 85.0, count), {}
    for name, left_m in (('right', -1.75), ('middle', 1.75), ('left', 5.25)):
        off = off_m[name](s) if name in off_m else np.zeros(count)
        points = np.stack([left_m - 3.0 + off, np.full(count, 5.0), 92.0 - s], axis=-1)
        left, right, in_left, in_right = rig.project(points)
        lines[name] = tuple(view[seen] + rng.normal(0, std_px, (int(seen.sum()), 2))
                            for view, seen in ((left, in_left), (right, in_right)))
    return lines, {name: tuple(np.full(len(view), std_px) for view in views)
                   for name, views in lines.items()}


@pytest.mark.parametrize('stepped', ['right', 'middle', 'left'])
def test_line_with_a_step_is_no_crest(make_scene, stepped):
    """A rigid road would explain 6 mm by false crests, banks and bends."""
    rig, rng = make_scene().rig, np.random.default_rng(3)
    picks = plain_picks(rig, rng, {stepped: lambda s: 0.006 * ((s > 20) & (s < 45))})
    rigid = fit_road(rig, *picks, prior=RoadPrior(wander_probability=0.0))
    fit = fit_road(rig, *picks)
    assert fit.problem.model.shape == RoadShape()
    assert fit.names[int(np.argmax(fit.problem.wander.std_m))] == stepped
    assert rigid.problem.model.shape != RoadShape() or rigid.scale > 1.3
    assert 0.8 < fit.scale < 1.2


def test_independent_errors_of_picks_are_no_wandering(make_scene):
    """The road is then that of rigid lines, to the bit."""
    rig, rng = make_scene().rig, np.random.default_rng(4)
    picks = plain_picks(rig, rng, {})
    fit, rigid = (fit_road(rig, *picks, prior=prior)
                  for prior in (RoadPrior(), RoadPrior(wander_probability=0.0)))
    assert fit.problem.wander is None and not fit.rivals
    assert fit.x.tolist() == rigid.x.tolist()


def wandering(rng, std_m, length_m):
    """Return a random function of place with a 1-sigma and a correlation length."""
    knots = np.linspace(0.0, 85.0, 341)
    alike = np.exp(-np.abs(knots[:, None] - knots) / length_m)
    values = std_m * np.linalg.cholesky(alike + 1e-9 * np.eye(len(knots))) @ rng.normal(
        size=len(knots))
    return lambda s: np.interp(s, knots, values)


@pytest.mark.slow
def test_claimed_scatter_is_the_scatter_where_lines_wander(make_scene):
    """Over 6 roads whose lines wander by 2 mm, over other lengths than modelled."""
    rig, scores = make_scene().rig, []
    for seed in range(6):
        rng = np.random.default_rng([seed, 5])
        fit = fit_road(rig, *plain_picks(rig, rng, {
            name: wandering(rng, 0.002, rng.uniform(6, 20))
            for name in ('right', 'middle', 'left')}))
        lane = lane_of_road('lane', fit, (0, 1), None)
        off = np.array([0, 0, -1.0]) @ lane.path.frame(lane.path.length_m / 2)[:, 1:]
        scores.append(off / lane.heading_std_rad)
    # chi-square of 6, 1 in 1000 to either side; by lines that do not wander it is above 3
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all((rms > 0.25) & (rms < 1.93)), rms


def dense_log_probability(fit, choices):
    """
    Return the log probability of picks whose lines wander by any choice, by dense algebra.

    Soft L1 is replaced by Gaussians of equal probability; the scatter of the picks is optimised.
    """
    problem, count = fit.problem, len(fit.problem.picks.line)
    prior, line, s_m = problem.prior, problem.picks.line, fit.feet.s_m
    weight = np.sqrt(2 / (1 + np.sqrt(1 + (fit.off / 3.3)**2)))
    off, weak = np.split(problem.rigid(fit.x), [count])
    slope, before = np.split(fit.slope, [count])
    off, slope = weight * off, weight[:, None] * slope
    per_m = slope[np.arange(count), problem.model.places.offsets.start + line]
    alike = np.outer(per_m, per_m) * (line[:, None] == line) * np.exp(
        -np.abs(s_m[:, None] - s_m) / prior.wander_length_m)
    may = prior.may_wander

    def of(choice):
        wandering = alike * np.square(np.array(may.std_m)[list(choice)])[line]

        def unlikely(log_variance):
            total = wandering + np.exp(log_variance) * np.eye(count)
            inverse = np.linalg.inv(total)
            normal = slope.T @ inverse @ slope + before.T @ before
            pull = slope.T @ inverse @ off + before.T @ weak
            return 0.5 * (off @ inverse @ off + weak @ weak - pull @ np.linalg.solve(normal, pull)
                          + np.linalg.slogdet(total)[1] + np.linalg.slogdet(normal)[1])
        return may.log_chance(choice) - minimize_scalar(
            unlikely, bounds=(-3, 3), method='bounded').fun
    return (logsumexp([of(choice) for choice in choices]) - np.log(problem.prior_std).sum()
            + log_chance(problem.model.shape, prior))


@pytest.mark.parametrize('seed', [3, 4])
def test_probability_of_wandering_equals_dense_algebra(make_scene, seed):
    """With one scatter for both kinds of roads, wandering was thousands of times too probable."""
    rig, rng = make_scene().rig, np.random.default_rng([seed, 9])
    fit = fit_road(rig, *plain_picks(rig, rng, {'middle': wandering(rng, 0.006, 15.0)}, 0.1, 12))
    fits = sorted(fit.families, key=lambda one: one.problem.wander is None)
    assert [one.problem.wander is None for one in fits] == [False, True]
    wander, rigid = log_evidences(fits)
    still, *choices = product(range(4), repeat=3)
    wanted = dense_log_probability(fits[0], choices) - dense_log_probability(fits[1], [still])
    assert wander - rigid == pytest.approx(wanted, abs=0.7)


def test_wandering_clicked_lines_have_a_built_grade(make_scene):
    """With rigid lines it has less evidence than a polynomial with wandering lines."""
    rig, rng = make_scene().rig, np.random.default_rng(9)
    lines, _ = crest_picks(rig, rng, 30, 65, -0.05, {
        name: wandering(rng, 0.02, 15.0) for name in ('right', 'middle', 'left')})
    fit = fit_road(rig, {name: tuple(view + rng.normal(0, 0.3, view.shape) for view in views)
                         for name, views in lines.items()})
    assert fit.problem.model.shape == RoadShape(vertical_curve=3)
    assert fit.problem.wander is not None


def crest_picks(rig, rng, begin_m, end_m, change, off_m=None, *, grade=0.0, curvature=0.0):
    """
    Return lines of 0.02 px of a road whose grade changes evenly over part of its 85 m.

    :param off_m: as for :func:`plain_picks`.
    :param grade: grade of its far end.
    :param curvature: of its reference line, positive to the left, 1/m.
    """
    s, lines = np.linspace(0.0, 85.0, 80), {}
    f = np.linspace(0.0, 85.0, 8501)
    climb = grade + change * np.clip((f - begin_m) / (end_m - begin_m), 0, 1)
    turn = curvature * (f - 60.0)
    height, ahead, aside = (np.interp(s, f, along - along[-1]) for along in (
        np.append(0.0, np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(f)))
        for rate in (climb, np.cos(turn), np.sin(turn))))
    heading = np.interp(s, f, turn)
    for name, left_m in (('right', -1.75), ('middle', 1.75), ('left', 5.25)):
        off = left_m + (off_m[name](s) if off_m else np.zeros(80))
        points = np.stack([off * np.cos(heading) - 3.0 + aside, 5.0 - height,
                           7.0 - ahead + off * np.sin(heading)], axis=-1)
        left, right, in_left, in_right = rig.project(points)
        lines[name] = tuple(view[seen] + rng.normal(0, 0.02, (int(seen.sum()), 2))
                            for view, seen in ((left, in_left), (right, in_right)))
    return lines, {name: tuple(np.full(len(view), 0.02) for view in views)
                   for name, views in lines.items()}


@pytest.mark.parametrize('begin_m, end_m, change', [(40, 65, -0.04), (30, 65, 0.05)],
                         ids=['crest', 'sag'])
def test_vertical_curve_is_found_as_built(make_scene, begin_m, end_m, change):
    """A polynomial leaves millimetres at its ends, which a rolled camera would also explain."""
    rig, rng = make_scene().rig, np.random.default_rng(1)
    lines, std_px = crest_picks(rig, rng, begin_m, end_m, change)
    fit = fit_road(rig, lines, std_px)
    model = fit.problem.model
    assert model.shape == RoadShape(vertical_curve=3)
    middle, log_length, found = fit.x[model.places.vertical_curve]
    std = np.sqrt(np.diag(fit.covariance))[model.places.vertical_curve]
    length_m = model.half_length_m * np.exp(log_length)
    assert abs(found - change) < 4 * std[2] < 0.002
    assert abs(np.log(length_m / (end_m - begin_m))) < 4 * std[1] < 0.2


@pytest.mark.parametrize('curvature, grade, change, begin_m, end_m', [
    (-0.005, 0.025, -0.036, 10, 80), (-0.011, 0.024, -0.039, 10, 80), (0.01, 0.03, -0.05, 30, 70),
    (0.007, -0.03, 0.05, 10, 80)], ids=['crest', 'sharp bend', 'short crest', 'sag'])
def test_bend_over_a_crest_is_found_as_built(make_scene, curvature, grade, change, begin_m, end_m):
    """Crossfall and curvature that change many times explain it too."""
    rig, rng = make_scene().rig, np.random.default_rng(1)
    fit = fit_road(rig, *crest_picks(rig, rng, begin_m, end_m, change, grade=grade,
                                     curvature=curvature))
    shape = fit.problem.model.shape
    assert shape == RoadShape(shape.curvature, tilt=2, vertical_curve=3) and shape.curvature < 3
    assert np.abs(fit.feet.residual_px).max() < 5 * 0.02


def test_bend_is_fitted_though_none_over_a_crest_can_be(make_scene, monkeypatch):
    def fail(*_):
        raise np.linalg.LinAlgError('Singular matrix')
    scene = make_scene(curvature=1 / 60, std_px=0.02)
    std_px = {name: tuple(np.full(len(view), 0.02) for view in views)
              for name, views in scene.lines.items()}
    wanted = fit_road(scene.rig, scene.lines, std_px)
    monkeypatch.setattr(fit_module, '_over_crests', fail)
    fit = fit_road(scene.rig, scene.lines, std_px)
    assert fit.problem.model.shape == wanted.problem.model.shape
    np.testing.assert_allclose(fit.x, wanted.x)


def test_road_ends_beyond_far_picks_that_lie_astray(make_scene):
    """What lies beyond the end of a road as guessed must not pass for scatter of the picks."""
    rig, rng = make_scene().rig, np.random.default_rng(0)
    lines, std_px = crest_picks(rig, rng, 10, 80, -0.063, grade=0.034, curvature=0.007)
    for views in std_px.values():
        for std in views:
            std[:2] = 1.0  # ends that were not found but clicked
    fit = fit_road(rig, lines, std_px)
    assert np.abs(fit.feet.s_m).max() < OVERREACH * fit.problem.model.s_m[-1]
    assert np.abs(fit.feet.residual_px).max() < 5 * 0.02


def test_grade_that_changes_evenly_all_along_is_no_transition(make_scene):
    """Without either end in view its ends cannot be determined."""
    rig, rng = make_scene().rig, np.random.default_rng(2)
    fit = fit_road(rig, *crest_picks(rig, rng, -20.0, 105.0, 0.08))
    assert fit.problem.model.shape == RoadShape(vertical=1)


@pytest.mark.parametrize('shape, numbers', [
    (RoadShape(), 0), (RoadShape(vertical=1), 1), (RoadShape(1, 2), 1), (RoadShape(2, 2), 1),
    (RoadShape(3, 2), 2), (RoadShape(1), 2), (RoadShape(2, 2, 1, 3), 5),
    (RoadShape(vertical_curve=3), 3), (RoadShape(1, 2, run_off=RUN_OFF), 3)])
def test_each_additional_number_is_an_exception_but_the_second_of_a_bend(shape, numbers):
    """A clothoid is as common as an arc; a bend that lies in a plane is one more exception."""
    prior = RoadPrior(bent_probability=0.01)
    assert log_chance(shape, prior) == pytest.approx(numbers * np.log(0.01))


def test_evidence_uses_the_fit_with_the_actual_scatter(make_scene):
    """Picks with too small a 1-sigma have pulled a road too far from its priors."""
    rig, rng, factor = make_scene().rig, np.random.default_rng(0), 2.0
    lines, std_px = banked_picks(rig)
    lines = {name: tuple(view + rng.normal(0.0, 0.03, view.shape) for view in views)
             for name, views in lines.items()}
    picks, rough = (Picks.of(lines, {name: tuple(view * times for view in views)
                                     for name, views in std_px.items()}, 0.3)
                    for times in (1.0, factor))
    near, prior = fit_road(rig, lines, std_px), RoadPrior(twist_std_rad=0.002)
    model = near.problem.model.reshaped(RoadShape(2, 2, 0, 6), near.x)[0]
    pulled, mode = (same_family(near, RoadProblem(rig, some, model, None, prior))
                    for some in (picks, rough))
    # Far picks count a little less in one of the two; priors would make 130 of a difference.
    assert pulled.log_evidence(factor ** 2) == pytest.approx(mode.log_evidence(1.0), abs=50.0)


def found_in_part(line, share):
    """Return the far end of a line's picks, and many points after a share of it."""
    return tuple(np.concatenate([view[:1], np.stack([
        np.interp(np.linspace(share, 1, 30), np.linspace(0, 1, len(view)), column)
        for column in view.T], axis=-1)]) for view in line)


@pytest.mark.parametrize('std_px', [None, 0.02], ids=['clicked', 'precise'])
@pytest.mark.parametrize('grade, twist', [(-0.03, 0.05), (0.0, 0.1)])
def test_road_reaches_the_end_of_partly_found_lines(make_scene, grade, twist, std_px):
    """The plane of the found part of a bend with changing bank meets the far ends too early."""
    scene = make_scene(curvature=-0.0063, grade=grade, twist=twist, std_px=0.0)
    lines = {name: found_in_part(line, share) for (name, line), share in zip(
        scene.lines.items(), (0.6, 0.65, 0.1))}
    fit = fit_road(scene.rig, lines, std_px and {
        name: tuple(np.full(len(view), std_px) for view in line) for name, line in lines.items()})
    assert fit.residual_px.max() < 0.3
    assert np.abs(fit.feet.s_m).max() < OVERREACH * fit.problem.model.s_m[-1]


@pytest.mark.parametrize('curvature', [0.0, -0.0063])
def test_far_outlier_picks_do_not_affect_the_other_lines(make_scene, curvature):
    """They may favour a longer road; the most probable of those tried is taken."""
    scene = make_scene(curvature=curvature)
    lines = {name: tuple(view.copy() for view in line) for name, line in scene.lines.items()}
    astray, *others = lines
    for view, off_px in zip(lines[astray], (-40.0, -24.0)):
        view[0] += [off_px, -5.0]
    fit = fit_road(scene.rig, lines)
    assert max(fit.residual_px[fit.number(name)] for name in others) < 0.45
    assert abs(scale_error(lane_of_road('lane', fit, (0, 1), 25.0).path, scene, 30.0)) < 0.002
