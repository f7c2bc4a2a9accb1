# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Fits of one family of roads to picks, from an approximate road or one of another family."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from .first_guess import NoRoadError
from .fitted import RoadFit, ROBUST
from .model import RoadModel, RoadShape
from .problem import DriftPrior, RoadProblem
from ..core.records import Array

MAX_STEPS = 40  # limit of the solver's evaluations; fits that converge need 10


def solve(problem: RoadProblem, start: Array) -> RoadFit:
    """Fit one model from a start, at which no line wanders."""
    if problem.wander is not None:
        start = np.append(start[:problem.size], np.zeros(problem.wander.count))
    if not (np.isfinite(start).all() and np.isfinite(problem.residuals(start)).all()):
        raise NoRoadError('the picks give no road to start from')
    result = least_squares(
        problem.residuals, start, jac=problem.jacobian, loss='soft_l1', f_scale=ROBUST,
        x_scale='jac', method='trf', xtol=1e-9, ftol=1e-5, gtol=1e-9, max_nfev=MAX_STEPS)
    return RoadFit(problem, result.x[:problem.size], 2 * float(result.cost),
                   wander=result.x[problem.size:])


def reshaped(fit: RoadFit, shape: RoadShape) -> RoadFit:
    """Fit another family, starting from a fitted road."""
    problem = fit.problem
    model, start = problem.model.reshaped(shape, fit.x, problem.model.tapered)
    return solve(RoadProblem(
        problem.rig, problem.picks, model, problem.drift, problem.prior, problem.wander), start)


def rebuilt(fit: RoadFit, shape: RoadShape) -> RoadFit:
    """Fit a family with a vertical curve, starting from a road with vertical curvature."""
    problem, seen_m = fit.problem, fit.feet.s_m
    model, start = problem.model.as_built(
        shape, fit.x, (float(seen_m.min()), float(seen_m.max())))
    return fit_closely(problem, model, start)


def fit_closely(problem: RoadProblem, model: RoadModel, start: Array) -> RoadFit:
    """Fit another model to the picks of a problem, first with the 1-sigma of clicks."""
    # With precise picks the cost has many local minima.
    clicks = replace(problem.picks, std_px=np.maximum(
        problem.picks.std_px, problem.prior.pick_std_px))
    near = solve(RoadProblem(problem.rig, clicks, model, problem.drift, problem.prior), start)
    if problem.wander is None and clicks.median_std_px == problem.picks.median_std_px:
        return near
    return solve(RoadProblem(problem.rig, problem.picks, model, problem.drift, problem.prior,
                             problem.wander), near.x)


def same_family(fit: RoadFit, problem: RoadProblem) -> RoadFit:
    """
    Fit the same family of roads to another problem.

    :param fit: road to start from.
    :param problem: problem of the same shape; its rig, picks and drift prior may differ.
    """
    shape, tapered = problem.model.shape, problem.model.tapered
    start = fit.problem.model.reshaped(shape, fit.x[:fit.problem.model.size], tapered)[1]
    return solve(problem, start if problem.drift is None else np.append(start, fit.drift_rad))


def in_family(fit: RoadFit, family: RoadFit, drift: DriftPrior) -> RoadFit:
    """
    Fit the family of a road, with tapered lines and the drift of the right camera.

    :param fit: road to start from.
    :param family: road of that family; the start if only one of the two has a vertical curve or
        a run-off.
    :param drift: prior knowledge of the drift of the right camera.
    """
    shape = family.problem.model.shape
    if shape[4:] != fit.problem.model.shape[4:]:
        fit = family
    problem = fit.problem
    model, start = problem.model.reshaped(shape, fit.x[:problem.model.size], tapered=True)
    return solve(RoadProblem(problem.rig, problem.picks, model, drift, problem.prior,
                             family.problem.wander), np.append(start, fit.drift_rad))
