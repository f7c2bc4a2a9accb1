# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Roads that are turned along a run-off: by hand, by quadrature, and found among others."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from stereo_speed.lab.evaluation.roads import draw_road
from stereo_speed.lab.sim.scene import SimScene
from stereo_speed.lab.sim.sequence import picked_site
from stereo_speed.road.fit import fit_road
from stereo_speed.road.model import NODES, RoadModel, RoadShape
from stereo_speed.road.problem import DriftPrior
from stereo_speed.road.run_off import axes_m, changes, prior_std, RUN_OFF, TERMS

FRAME = np.array([[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]])
U = np.linspace(-1.1, 1.1, 161)
STD_PX = 0.02


def numbers_of(rng, axis_m=2.0):
    """Return random parameters of usual size."""
    return np.append(rng.normal(0, prior_std(0.2, 0.04)[:-1]), axis_m)


def test_evenly_changing_crossfall_turns_about_the_axis():
    """At a constant rate the axis stays level, and lines 3 m beside it rise and fall evenly."""
    model = RoadModel(FRAME, np.array([0, 2.0, 40]), 30.0, 2, RoadShape(1, 2, run_off=RUN_OFF))
    x, rate = np.zeros(model.size), 0.003
    x[model.places.run_off.start], x[-1] = rate, 4.0
    points, frames = model.reference(x)
    for beside in (-3.0, 0.0, 3.0):
        height = 2 - (points + (4.0 + beside) * frames[..., 1])[:, 1]
        np.testing.assert_allclose(height, beside * rate * model.s_m / 30, atol=1e-6)


def test_changes_equal_the_integrals_of_the_series():
    """Heading and crossfall by quadrature of the cosines; the grade is the rate times the axis."""
    numbers = numbers_of(np.random.default_rng(0))
    turn, climb, fall = changes(numbers, U, 25.0)

    def series(u, coefficients, first):
        k = np.arange(first, first + TERMS)
        return coefficients @ np.cos(k * np.pi * (u + 1.1) / 2.2)
    for i in (0, 40, 80, 133, 160):
        for got, part, first in ((fall, numbers[:TERMS], 0), (turn, numbers[TERMS:-1], 1)):
            want = quad(series, 0.0, U[i], args=(part, first), limit=200)[0]
            assert got[i] == pytest.approx(want, abs=1e-8)
        assert climb[i] == pytest.approx(-2.0 / 25.0 * series(U[i], numbers[:TERMS], 0))


def test_changes_are_linear_about_each_axis_and_none_without_parameters():
    rng = np.random.default_rng(1)
    one, other = numbers_of(rng), numbers_of(rng)
    both = np.append((one + 2 * other)[:-1], 2.0)
    for a, b, total in zip(*(changes(n, U, 25.0) for n in (one, other, both))):
        np.testing.assert_allclose(a + 2 * b, total, atol=1e-12)
    for stacked, alone in zip(changes(np.stack([one, other]), U, 25.0), changes(other, U, 25.0)):
        np.testing.assert_allclose(stacked[1], alone, atol=1e-15)
    assert not np.any(changes(np.zeros((3, 0)), U, 25.0))


def test_priors_and_axes_by_hand():
    """Those of the rate as 1/n, of the curvature as 1/n^2; axes are lines, or their middle."""
    std = prior_std(0.5, 0.04)
    np.testing.assert_allclose(std[[0, 1, 2, 23]], [0.04, 0.04, 0.02, 0.04 / 23])
    np.testing.assert_allclose(std[[24, 25, 47, 48]], [0.5, 0.125, 0.5 / 576, 5.0])
    assert len(std) == RUN_OFF
    assert axes_m(np.array([3.7, 0.0, 7.0])).tolist() == [0.0, 3.5, 7.0]


def traced(config, rng):
    """Return points of the lines of a simulated road as precise as traced ones, and 1-sigmas."""
    scene = SimScene(config)
    site = picked_site(scene, rng)
    lines = {name: (np.array(line['left_image']), np.array(line['right_image']))
             for name, line in site['lines'].items()}
    return scene, lines, {name: tuple(np.full(len(view), STD_PX) for view in views)
                          for name, views in lines.items()}


def fitted(number, run_off, pan_deg=0.0):
    """Fit a drawn road with a free pan; return the fit, and error and 1-sigma of its pan, deg."""
    config = replace(draw_road(1, number, pan_deg, run_off).config, picks=40, pick_std_px=STD_PX)
    scene, lines, std_px = traced(config, np.random.default_rng(number))
    free = DriftPrior(np.zeros(3), np.diag(1 / np.radians([1.0, 0.0003, 0.002])))
    fit = fit_road(scene.rig, lines, std_px, free)
    return (fit, np.degrees(fit.drift_rad[0]) - config.rig_moved_deg[0],
            np.degrees(np.sqrt(fit.covariance[-3, -3])))


@pytest.mark.parametrize('number, pan_deg', [(0, 0.0), (6, 0.0), (21, 0.02)])
def test_run_off_is_not_taken_for_a_pan(number, pan_deg):
    """Evidence finds the run-off; the lines lie on the road, and the pan is right."""
    fit, off_deg, std_deg = fitted(number, True, pan_deg)
    assert fit.problem.model.shape.run_off == RUN_OFF
    assert fit.residual_px.max() < 1.5 * STD_PX
    assert abs(off_deg) < 3 * std_deg and std_deg < 0.003


@pytest.mark.parametrize('number', [0, 2, 5])
def test_other_roads_have_no_run_off(number):
    """Neither a straight road nor an arc or a crest."""
    assert not fitted(number, False)[0].problem.model.shape.run_off


def test_fitted_road_can_be_narrowed_again():
    """A family without a run-off drops its parameters; those of the others stay."""
    fit = fitted(0, True)[0]
    model, shape = fit.problem.model, fit.problem.model.shape._replace(run_off=0)
    other, x = model.reshaped(shape, fit.x)
    kept = model.columns(shape, len(fit.x))
    assert other.size == model.size - RUN_OFF and len(kept) == len(x)
    np.testing.assert_array_equal(fit.x[kept], x)
    assert len(model.s_m) == NODES and len(fit.problem.prior_std) == model.size - 4 - model.lines
