# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The search for the family of a road.

A family is widened with further parameters, or narrowed, as long as the marginal likelihood of
the picks rises. A linear approximation tells beforehand which families are worth a fit.
"""
from __future__ import annotations

from itertools import product
from typing import Iterator, Optional

import numpy as np
from numpy.typing import NDArray

from .evidence import best_of, variance_of
from .fitted import log_any_scale, log_chance, RoadFit
from .model import RoadShape, VERTICAL_CURVE
from .problem import RoadProblem
from .run_off import axes_m, RUN_OFF
from .solving import fit_closely, rebuilt, reshaped
from ..core.records import Array

# Most parameters of a road's shape: a clothoid needs two of curvature, a hairpin some more; the
# ends of a parabola in the middle of a road need five of vertical curvature.
MOST = RoadShape(8, 2, 6, 6, VERTICAL_CURVE, RUN_OFF)
_WIDER = RoadShape(curvature=2, tilt=2, vertical=2, twist=2)  # most parameters added in one step
_TRIED = 3  # most families of one step that are fitted, in the order of their promise
_LEAST_GAIN = 0.0  # least promised gain of the log evidence for which a family is fitted


def explored(fits: list[RoadFit], most: int) -> list[RoadFit]:
    """
    Return roads of families that are widened as long as the evidence rises, with run-offs last.

    :param fits: roads to start from.
    :param most: largest number of curvature coefficients.
    """
    fits = _widened(fits, most)
    # A road that misses kinks makes its picks seem to scatter more.
    built = _with_run_off(best_of(fits), min(variance_of(fits), 1.0))
    if built is None:
        return fits
    fits.append(built)
    return _widened(fits, most) if best_of(fits) is built else fits


def as_built(shape: RoadShape) -> list[RoadShape]:
    """Return the family with a vertical curve in place of two or more vertical coefficients."""
    if shape.vertical < 2 or shape.vertical_curve:
        return []
    return [shape._replace(vertical=0, vertical_curve=VERTICAL_CURVE)]


def _with_run_off(fit: RoadFit, variance: float) -> Optional[RoadFit]:
    """
    Fit a road with a run-off if its evidence should be greater, by linear approximation.

    :param fit: best road without one, as far as is known.
    :param variance: see :meth:`RoadFit.log_evidence`.
    :return: None if the road is straight and plane or has a run-off already, if its picks are no
        more precise than clicks, which cannot show kinks, if it is farther from them than clicks
        would be, and thus more than kinks are amiss, or if a run-off promises nothing.
    """
    problem, shape = fit.problem, fit.problem.model.shape
    precise = problem.picks.are_precise(problem.prior)
    if shape.run_off or not any(shape) or not precise \
            or fit.residual_px.max() > problem.prior.pick_std_px:
        return None
    wide = shape._replace(curvature=max(shape.curvature, 1), tilt=2,
                          vertical=max(shape.vertical, 2), run_off=RUN_OFF)
    shapes = [wide._replace(curvature=1, twist=0, vertical=vertical, vertical_curve=curve)
              for vertical, curve in product({0, 1, 2, shape.vertical}, {0, shape.vertical_curve})]
    model, x = problem.model.reshaped(wide, fit.x, problem.model.tapered)
    wider = RoadProblem(problem.rig, problem.picks, model, problem.drift, problem.prior,
                        problem.wander)
    tries = []
    for axis_m in axes_m(model.offsets(x)):
        x[model.places.run_off.stop - 1] = axis_m
        near = _Nearby(RoadFit(wider, x.copy(), fit.cost, wander=fit.wander), variance)
        tries.append((near, {one: near.promise(one) for one in shapes}))
        least = near.promise(shape) + _LEAST_GAIN
    near, promises = max(tries, key=lambda known: max(known[1].values()))
    better = [one for one in promises if promises[one] > least]
    if not better:
        return None
    # The wider a family, the more often its fit ends beside the best one.
    return best_of([near.fitted(one) for one in {max(better, key=lambda one: promises[one]),
                                                 min(better, key=sum)}])


def _widened(fits: list[RoadFit], most: int) -> list[RoadFit]:
    """
    Return roads of families that are widened as long as the evidence rises.

    :param fits: roads to start from.
    :param most: largest number of curvature coefficients.
    """
    fits = list(fits)
    # Families with a vertical curve are fitted once more even if known, from a better start.
    built: set[RoadShape] = set()
    while True:
        best = best_of(fits)
        known = {fit.problem.model.shape for fit in fits}
        tries = _promising(best, known, most, variance_of(fits))
        curves = [one for one in as_built(best.problem.model.shape) if one not in built]
        for other in (*tries, *curves):
            built |= {other} & set(curves)
            fits.append(reshaped(best, other) if other in tries else rebuilt(best, other))
            if best_of(fits) is fits[-1]:
                break
        if best_of(fits) is best:
            return fits


def _promising(fit: RoadFit, known: set[RoadShape], most: int, variance: float
               ) -> list[RoadShape]:
    """
    Return families whose evidence should be greater, by linear approximation, the best first.

    :param known: families to leave out.
    :param most: largest number of curvature coefficients.
    :param variance: see :meth:`RoadFit.log_evidence`.
    """
    shape, problem = fit.problem.model.shape, fit.problem
    limit = MOST._replace(curvature=max(most, shape.curvature))
    wide = RoadShape(*(min(a + b, c) for a, b, c in zip(shape, _WIDER, limit)))
    model, x = problem.model.reshaped(wide, fit.x, problem.model.tapered)
    wider = RoadFit(RoadProblem(
        problem.rig, problem.picks, model, problem.drift, problem.prior, problem.wander), x,
        fit.cost, wander=fit.wander)
    near = _Nearby(wider, variance)
    more = (RoadShape(*map(sum, zip(shape, by))) for by in product(
        *(range(b - a + 1) for a, b in zip(shape, wide))))
    promises = {new: near.promise(new) for new in (*more, *_narrower(shape))
                if new.tilt != 1 and (new.curvature or not new.tilt)}
    least = promises[shape] + _LEAST_GAIN
    return sorted((p for p in promises if p not in known and promises[p] > least),
                  key=lambda p: -promises[p])[:_TRIED]


class _Nearby:
    """
    Narrower families about a road, by linear approximation.

    :param fit: the road.
    :param variance: see :meth:`RoadFit.log_evidence`.
    """

    def __init__(self, fit: RoadFit, variance: float) -> None:
        residual, jacobian = fit.weighted(variance)
        self.fit, model = fit, fit.problem.model
        self.gradient, self.normal = jacobian.T @ residual, jacobian.T @ jacobian
        self.std = np.ones(len(self.gradient))
        self.std[model.places.tapers.start:model.size] = fit.problem.prior_std
        self.x = fit.x.copy()
        self.x[model.places.run_off][-1:] = 0.0  # without effect in other families

    def _parts(self, shape: RoadShape
               ) -> tuple[NDArray[np.intp], NDArray[np.intp], Array, Array]:
        """Return the unknowns of a family, the others, and matrix and slope of the former."""
        count = len(self.gradient)
        kept = self.fit.problem.model.columns(shape, count)
        out = np.setdiff1d(np.arange(count), kept)
        slope = self.gradient[kept] - self.normal[np.ix_(kept, out)] @ self.x[out]
        return kept, out, self.normal[np.ix_(kept, kept)], slope

    def promise(self, shape: RoadShape) -> float:
        """Return the log evidence that a family should have, up to a constant."""
        kept, out, part, slope = self._parts(shape)
        rest, covariance = self.x[out], np.linalg.inv(part)
        gain = slope @ covariance @ slope + rest @ (
            2 * self.gradient[out] - self.normal[np.ix_(out, out)] @ rest)
        changes = self.fit.problem.changes(shape)
        estimate = self.fit.x[changes] - (covariance @ slope)[changes]
        return (0.5 * float(gain - np.linalg.slogdet(part)[1])
                - float(np.log(self.std[kept]).sum())
                + log_chance(shape, self.fit.problem.prior)
                + log_any_scale(estimate, np.diag(covariance)[changes], self.std[changes]))

    def fitted(self, shape: RoadShape) -> RoadFit:
        """Fit a family, starting from the road that should be its best one."""
        kept, _, part, slope = self._parts(shape)
        x, problem = self.fit.x.copy(), self.fit.problem
        mine = kept < len(x)
        x[kept[mine]] -= np.linalg.solve(part, slope)[mine]
        return fit_closely(problem, *problem.model.reshaped(shape, x, problem.model.tapered))


def _narrower(shape: RoadShape) -> Iterator[RoadShape]:
    """Yield the families with one parameter less, or without the tilt."""
    for name, less in (('curvature', 1), ('tilt', 2), ('vertical', 1), ('twist', 1),
                       ('run_off', RUN_OFF)):
        count = getattr(shape, name) - less
        if count >= 0 and not (name == 'curvature' and count == 0 and shape.tilt) and not (
                name == 'tilt' and shape.run_off):
            yield shape._replace(**{name: count})
