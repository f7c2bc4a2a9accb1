# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How far the lines of a road wander, as the evidence says.

A marking may be displaced over some metres. The residuals of its picks are then correlated, which
no road explains; see ``wander.py``. A family of roads and how far lines wander are weighed
together, because a plainer road whose lines wander may explain picks as well as a richer one.
"""
from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Iterator, NamedTuple

import numpy as np

from .fitted import least_variance, log_chance, RoadFit, ROBUST
from .model import RoadShape
from .problem import RoadProblem
from .solving import reshaped
from .wander import wander_of, WanderEvidence, Ways
from ..core.records import Array


class Asked(NamedTuple):
    """
    The family that the picks support if lines may wander, by linear approximation.

    :param log_evidence: its log evidence, up to a constant that all roads of these picks share.
    :param shape: its shape.
    :param std_m: (lines,) 1-sigma of how far each line wanders, m.
    """

    log_evidence: float
    shape: RoadShape
    std_m: tuple[float, ...]


def asked_of(fit: RoadFit) -> Asked:
    """Return the best supported one of a road's family and plainer ones, by linearisation."""
    squares = _Squares.about(fit)
    return max((_asked_family(fit, shape, squares) for shape in _plainer(fit.problem.model.shape)),
               key=lambda one: one.log_evidence)


def _plainer(shape: RoadShape) -> Iterator[RoadShape]:
    """Yield a family and those without some kinds of its parameters."""
    for curvature, *rest in product(sorted({shape.curvature, min(shape.curvature, 1), 0}), *(
            sorted({count, 0}) for count in shape[2:])):
        if curvature or not rest[-1]:  # a run-off belongs to a bend
            yield RoadShape(curvature, shape.tilt if curvature else 0, *rest)


class _Squares(NamedTuple):
    """
    A sum of squares that stands for the robust cost near a road.

    :param own: (n,) weights of the picks' residuals.
    :param slope: (n,) weights of their derivatives.
    :param beyond: difference of the cost and the sum of squares at the road.
    :param ways: ways in which each line may wander, with picks of these weights.
    """

    own: Array
    slope: Array
    beyond: float
    ways: list[Ways]

    @classmethod
    def at(cls, fit: RoadFit) -> _Squares:
        """
        Return squares for a road at its minimum, which is then the minimum of the squares too.

        Otherwise a road that is far from its picks would seem to have a far better one nearby.
        """
        root = np.sqrt(1 + (fit.off / ROBUST)**2)
        weight, beyond = np.sqrt(1 / root), np.sum(fit.off**2 * (2 / (root + 1) - 1 / root))
        return cls(weight, weight, float(beyond), ways_of(fit, weight))

    @classmethod
    def about(cls, fit: RoadFit) -> _Squares:
        """Return squares that do not miss roads nearby that agree with the picks far better."""
        root = np.sqrt(1 + (fit.off / ROBUST)**2)
        slope = np.sqrt(1 / root)
        return cls(np.sqrt(2 / (root + 1)), slope, 0.0, ways_of(fit, slope))


def ways_of(fit: RoadFit, weight: Array) -> list[Ways]:
    """
    Return the ways in which each line may wander about a road.

    :param weight: (n,) weights of the picks.
    """
    problem, slope = fit.problem, fit.slope
    picks, first = problem.picks, problem.model.places.offsets.start
    mine = [np.flatnonzero(picks.line == line) for line in range(problem.model.lines)]
    return [Ways.of(own, weight[own] * slope[own, first + line], fit.feet.s_m[own],
                    problem.prior.wander_length_m) for line, own in enumerate(mine)]


def _evidence(fit: RoadFit, shape: RoadShape, squares: _Squares) -> WanderEvidence:
    """Return the evidence of a narrower family, as a function of how far its lines wander."""
    model, count = fit.problem.model, len(fit.problem.picks.line)
    size, first = len(fit.x), model.places.tapers.start
    kept = model.columns(shape, size)
    out = np.setdiff1d(np.arange(size), kept)
    rest = np.zeros(size)
    rest[out] = fit.x[out]
    rest[model.places.vertical_curve][:2] = 0.0  # without effect when the change of grade is 0
    rest[model.places.run_off][-1:] = 0.0  # nor has an axis about which nothing turns
    residual, jacobian = fit.problem.rigid(fit.x), fit.slope
    residual = residual - jacobian @ rest
    residual[:count] *= squares.own
    rows = np.setdiff1d(np.arange(len(residual)), count + 1 + out - first)
    weighted = jacobian[:, kept].copy()
    weighted[:count] *= squares.slope[:, None]
    return WanderEvidence(
        squares.ways, residual[rows], weighted[rows], squares.beyond, least_variance(fit.problem),
        size - fit.told if shape.run_off else 0.0)


def _log_beforehand(fit: RoadFit, shape: RoadShape) -> float:
    """Return the log prior of a narrower family, including the 1-sigmas of its parameters."""
    model = fit.problem.model
    std = np.ones(model.size)
    std[model.places.tapers.start:] = fit.problem.prior_std
    kept = model.columns(shape, model.size)
    return log_chance(shape, fit.problem.prior) - float(np.log(std[kept]).sum())


def _asked_family(fit: RoadFit, shape: RoadShape, squares: _Squares) -> Asked:
    """Return how far lines wander on a road of a narrower family, and its evidence."""
    best, std_m = _evidence(fit, shape, squares).asked(fit.problem.prior.may_wander)
    return Asked(best + _log_beforehand(fit, shape), shape, std_m)


def loosened(fit: RoadFit, asked: Asked) -> list[RoadFit]:
    """Return roads whose lines may wander, of the road's own family and the supported one."""
    problem = fit.problem
    ways = ways_of(fit, np.ones(len(problem.picks.line)))
    loose = replace(fit, problem=RoadProblem(
        problem.rig, problem.picks, problem.model, problem.drift, problem.prior,
        wander_of(ways, asked.std_m, len(problem.picks.line))))
    return [reshaped(loose, shape) for shape in sorted({asked.shape, problem.model.shape})]


def log_probability(fit: RoadFit) -> float:
    """Return the log probability of a road, comparable between all roads of the same picks."""
    shape, may = fit.problem.model.shape, fit.problem.prior.may_wander
    evidence = _evidence(fit, shape, _Squares.at(fit))
    if fit.problem.wander is not None:
        return evidence.wandering(may)[0] + _log_beforehand(fit, shape)
    still = (0,) * fit.problem.model.lines
    return evidence.at(still) + may.log_chance(still) + _log_beforehand(fit, shape)
