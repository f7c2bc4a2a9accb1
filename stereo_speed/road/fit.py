# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The joint fit of a road: all picks of all its lines, in both raw views, at once.

Lines of one road are parallel, so they share one heading and one surface. Each pick measures
how far it lies from its projected line, in its own 1-sigma; a far line thus weighs as little as
it should. How the road curves, climbs and is banked is decided by evidence: families of roads are
widened as long as the probability of the picks rises, each number weighed by what is known of
roads beforehand. Families that come close remain as rivals, and their disagreement is part of what
is uncertain.

A marking may be off its place over some metres, and its picks are then off together, which no road
explains. Where they ask for it, lines may wander (``wander.py``), and the road is looked for anew.

The right camera may have rotated since the calibration. Lines that are parallel in space show it:
they meet in one vanishing point in each view, and the two must be one direction. On demand its
three angles are unknowns as well.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Iterator, Mapping, NamedTuple, Optional, Sequence

import numpy as np
from scipy.optimize import least_squares

from .first_guess import guess_road, NoRoadError
from .model import RoadModel, RoadShape, RUN_OFF, TRANSITION, VERTICAL_CURVE, Weights
from .problem import DriftPrior, Feet, Picks, pixels, REACH, RoadPrior, RoadProblem
from .wander import Wander, wander_of, WanderEvidence, Ways
from ..core.records import Array
from ..estimation.robust import robust_std
from ..geometry.ray_plane import Plane
from ..geometry.rig import StereoRig

ROBUST = 3.3  # residuals beyond this many sigmas count less and less (soft L1)
# Numbers that may describe a road: a clothoid needs two, a hairpin some more, the ends of a
# parabola in the middle of a road five.
MOST = RoadShape(8, 2, 6, 6, VERTICAL_CURVE, RUN_OFF, TRANSITION)
MAX_STEPS = 40  # of the solver; fits that converge need 10
_BUILT_STEPS = 200  # of it, where the ends of ramps are looked for from afar
FOOT_PLACES = 8001  # places along the road among which a foot is looked up: some cm apart
# Times their 1-sigma, by which not even 30 picks scatter by chance: a longer road would tell more.
_ASTRAY = 1.5
# Times as far as the last node, up to which picks are met: so far the cubic through the last nodes
# goes on within 2 mm, even of an arc of 41 m.
_OVERREACH = 1.1
_LENGTHS = 3  # of the road that are tried, until it reaches its picks
_LONGER = REACH  # times as far as the second pick that a road which ended there has met
_NARROW = 0.7  # least ratio of the robust to the r.m.s. scatter: a few outliers are no excuse
_WIDER = RoadShape(curvature=2, tilt=2, vertical=2, twist=2)  # looked at in one step
_TRIED = 3  # of the families that promise most, until one keeps its promise
_LEAST_GAIN = 0.0  # in the logarithm of the evidence, of a family that is worth a step
_WANDER_ROUNDS = 3  # in which roads and by how much their lines wander are found by turns
_SAME_WANDER = 0.3  # share by which 1-sigmas of wandering may change that need no more of them
_RIVAL = 5e-3  # least odds against the best family of one that is kept in mind


@dataclass(frozen=True, eq=False)
class RoadFit:
    """
    A fitted road.

    :param problem: picks and model.
    :param x: (size,) parameters.
    :param cost: robust sum of squares, in sigmas, priors included.
    :param rivals: roads of other families that the picks allow for as well, and their odds
        against this one.
    :param wander: (k,) how far the lines go each way that they may wander.
    """

    problem: RoadProblem
    x: Array
    cost: float
    rivals: tuple[tuple[float, RoadFit], ...] = ()
    wander: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its lines, in the order of their numbers."""
        return self.problem.picks.names

    def number(self, name: str) -> int:
        """Return the number of a named line."""
        return self.names.index(name)

    @cached_property
    def feet(self) -> Feet:
        """Where the picks meet the fitted lines."""
        return self.problem.feet(self.x)

    @cached_property
    def residual_px(self) -> Array:
        """Root mean square distance (lines,) of each line's picks from it."""
        square, line = self.feet.residual_px**2, self.problem.picks.line
        return np.sqrt(np.bincount(line, square) / np.bincount(line))

    @property
    def off(self) -> Array:
        """How far the picks (n,) are from their lines as these wander, in their own 1-sigmas."""
        return self._linear[0][:len(self.problem.picks.line)]

    @cached_property
    def scale(self) -> float:
        """Scatter of the picks against their 1-sigmas."""
        off, wander = self.off, self.problem.wander
        free = max(len(off) - len(self.x) - (0.0 if wander is None else wander.told), 1)
        # one stray pick is no measure of the others
        std = max(robust_std(off), _NARROW * float(np.sqrt(np.mean(off**2))),
                  float(np.sqrt(_least_variance(self.problem))))
        return std * float(np.sqrt(len(off) / free))

    @cached_property
    def covariance(self) -> Array:
        """Covariance (size, size) of the unknowns of road and rig, scaled by the residuals."""
        jacobian = self._linear[1]
        scale = np.ones(len(jacobian))
        scale[:len(self.feet.residual_px)] = self.scale  # priors are not scaled
        jacobian = jacobian / scale[:, None]
        size = len(self.x)
        return np.asarray(np.linalg.pinv(jacobian.T @ jacobian)[:size, :size], dtype=np.float64)

    def log_evidence(self, variance: float) -> float:
        """
        Return the logarithm of the probability of the picks in this family, but for a constant.

        Laplace's approximation, with the priors of all numbers that other families lack, about
        the road that would be fitted with that variance: precise picks that scatter more than
        they should have pulled this one further off its priors.

        :param variance: of the picks in units of their own; the same for families to be compared.
            Lines that wander otherwise have another one (:func:`log_evidences`).
        """
        residual, jacobian = self.weighted(variance)
        normal = jacobian.T @ jacobian
        # In the minimum the picks pull as much as the priors; with that variance they pull less.
        count = len(self.problem.picks.line)
        pull = max(1 - 1 / variance, 0.0) * (jacobian[count:].T @ residual[count:])
        gain = float(pull @ np.linalg.solve(normal, pull))
        fit = -0.5 * (float(residual @ residual) - gain)
        occam = -0.5 * float(np.linalg.slogdet(normal)[1]) - float(
            np.log(self.problem.prior_std).sum())
        return fit + occam + log_chance(self.problem.model.shape, self.problem.prior)

    @cached_property
    def _linear(self) -> tuple[Array, Array]:
        """Residuals and their derivatives."""
        unknowns = np.append(self.x, self.wander)
        return self.problem.residuals(unknowns), self.problem.jacobian(unknowns)

    def weighted(self, variance: float) -> tuple[Array, Array]:
        """
        Return residuals and derivatives whose squares are the robust cost near this road.

        :param variance: as for :meth:`log_evidence`.
        """
        residual, jacobian = self._linear
        count = len(self.problem.picks.line)
        root = np.sqrt(1 + (residual[:count] / ROBUST)**2)
        cost, slope = np.ones(len(residual)), np.ones(len(residual))
        # soft L1, 2 f^2 (root - 1), and the square root of its derivative by the square
        cost[:count] = np.sqrt(2 / (root + 1) / variance)
        slope[:count] = np.sqrt(1 / root / variance)
        return residual * cost, jacobian * slope[:, None]

    @property
    def slope(self) -> Array:
        """Return derivatives (n and more, size) of residuals by the unknowns of road and rig."""
        rows = len(self._linear[0]) - len(self.wander)
        return self._linear[1][:rows, :len(self.x)]

    @property
    def drift_rad(self) -> Array:
        """Pan, tilt and roll (3,) of the right camera since the calibration."""
        return self.problem.drift_rad(self.x)

    @property
    def families(self) -> list[RoadFit]:
        """Return the road and its rivals."""
        return [self, *(rival for _, rival in self.rivals)]

    @property
    def plane(self) -> Plane:
        """Return the plane that the road lies in, about its middle."""
        points, frames = self.problem.model.reference(self.x)
        middle = len(points) // 2
        n = frames[middle, :, 2]
        d = float(n @ points[middle])
        return Plane(n, d) if d > 0 else Plane(-n, -d)

    def spacing(self, a: int, b: int) -> tuple[float, float]:
        """
        Return the distance between two lines across the road, and its 1-sigma, in m.

        :param a: number of one line.
        :param b: number of the other.
        """
        apart = np.zeros(self.problem.model.lines)
        apart[a], apart[b] = 1.0, -1.0
        at = slice(4, 4 + len(apart))
        variance = apart @ self.covariance[at, at] @ apart
        return abs(float(apart @ self.problem.model.offsets(self.x))), float(np.sqrt(variance))

    def points(self, line: int, s_m: Array, across_m: Array) -> Array:
        """
        Return points of the surface beside a line: (..., 3), left optical frame.

        :param line: its number.
        :param s_m: (n,) reference arc lengths.
        :param across_m: (n, ...) distances from the line, m, positive to the left.
        """
        model = self.problem.model
        points, frames = model.reference(self.x)
        weights = Weights.at(model.s_m, s_m)
        place = model.offsets_at(self.x, np.full(len(s_m), line), np.asarray(s_m))
        offset = np.asarray(across_m) + place.reshape((-1,) + (1,) * (np.ndim(across_m) - 1))
        shape = (len(s_m),) + (1,) * (offset.ndim - 1) + (3,)
        return np.asarray(weights(points).reshape(shape)
                          + offset[..., None] * weights(frames[..., 1]).reshape(shape))

    def foot(self, line: int, right: bool, uv_px: Array) -> Array:
        """
        Return the reference arc lengths (n,) where pixels (n, 2) of a view are nearest a line.

        :param line: its number.
        :param right: the right view.
        """
        nodes = self.problem.model.s_m
        s = np.linspace(REACH * nodes[0], REACH * nodes[-1], FOOT_PLACES)
        seen = self.seen(self.points(line, s, np.zeros_like(s)), right)
        gap = np.linalg.norm(seen - np.asarray(uv_px)[:, None], axis=-1)
        return np.asarray(s[np.argmin(np.where(np.isnan(gap), np.inf, gap), axis=-1)])

    def seen(self, points_m: Array, right: bool) -> Array:
        """
        Return the raw pixels of points (..., 3) in a view as it stands now; NaN behind it.

        :param right: the right view.
        """
        rig = self.problem.rig
        if not right:
            return pixels(rig.left, points_m)
        return pixels(rig.right, self.problem.to_right(self.x, points_m))

    def line_range_m(self, line: int) -> tuple[float, float]:
        """Return the reference arc lengths of a line's first and last pick in either view."""
        s = self.feet.s_m[self.problem.picks.line == line]
        return float(s.min()), float(s.max())


def _least_variance(problem: RoadProblem) -> float:
    """Return, in their own sigmas, how well picks can agree with a road at best."""
    return min((problem.prior.best_pick_std_px / problem.picks.median_std_px)**2, 1.0)


def _solve(problem: RoadProblem, start: Array, most_steps: int = MAX_STEPS) -> RoadFit:
    """Fit one model from a start; lines that may wander begin in their places."""
    if problem.wander is not None:
        start = np.append(start[:problem.size], np.zeros(problem.wander.count))
    if not np.isfinite(problem.residuals(start)).all():
        raise NoRoadError('the picks give no road to start from')
    result = least_squares(
        problem.residuals, start, jac=problem.jacobian, loss='soft_l1', f_scale=ROBUST,
        x_scale='jac', method='trf', xtol=1e-9, ftol=1e-5, gtol=1e-9, max_nfev=most_steps)
    return RoadFit(problem, result.x[:problem.size], 2 * float(result.cost),
                   wander=result.x[problem.size:])


def _reshaped(fit: RoadFit, shape: RoadShape) -> RoadFit:
    """Fit another family, from the result of one."""
    problem = fit.problem
    model, start = problem.model.reshaped(shape, fit.x, problem.model.tapered)
    return _solve(RoadProblem(
        problem.rig, problem.picks, model, problem.drift, problem.prior, problem.wander), start)


def _rebuilt(fit: RoadFit, shape: RoadShape) -> RoadFit:
    """Fit a family that has what roads are built of in place of a polynomial, from one of one."""
    seen_m = float(fit.feet.s_m.min()), float(fit.feet.s_m.max())
    model, start = fit.problem.model.as_built(shape, fit.x, seen_m)
    starts = [start]
    if shape.run_off and shape.transition:
        # a bend is banked about where it begins
        without = shape._replace(run_off=fit.problem.model.shape.run_off)
        base, x = ((fit.problem.model, fit.x) if any(fit.problem.model.shape.built[1:])
                   else fit.problem.model.as_built(without, fit.x, seen_m))
        starts.append(fit.problem.model.as_built(shape, fit.x, seen_m, base.bend_ramp(x))[1])
    return min((_from_start(fit.problem, model, one) for one in starts), key=lambda it: it.cost)


def _from_start(problem: RoadProblem, model: RoadModel, start: Array) -> RoadFit:
    """Fit another family from afar, by way of clicks."""
    # Among precise picks there are many roads that no small step makes better.
    clicks = replace(problem.picks, std_px=np.maximum(
        problem.picks.std_px, problem.prior.pick_std_px))
    near = _solve(RoadProblem(problem.rig, clicks, model, problem.drift, problem.prior), start,
                  _BUILT_STEPS)
    if problem.wander is None and clicks.median_std_px == problem.picks.median_std_px:
        return near
    return _solve(RoadProblem(problem.rig, problem.picks, model, problem.drift, problem.prior,
                              problem.wander), near.x, _BUILT_STEPS)


def same_family(fit: RoadFit, problem: RoadProblem) -> RoadFit:
    """
    Fit the same family of roads again.

    :param fit: where to start.
    :param problem: with a model of the same shape; its rig, picks or drift prior may be others.
    """
    shape, tapered = problem.model.shape, problem.model.tapered
    start = fit.problem.model.reshaped(shape, fit.x[:fit.problem.model.size], tapered)[1]
    return _solve(problem, start if problem.drift is None else np.append(start, fit.drift_rad))


def fit_road(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]],
             std_px: Optional[Mapping[str, tuple[Array, Array]]] = None,
             drift: Optional[DriftPrior] = None, prior: RoadPrior = RoadPrior(), *,
             near: Optional[RoadFit] = None) -> RoadFit:
    """
    Fit one road to the picks of its lines; the data decide how it curves and climbs.

    :param lines: name to (left (n, 2), right (m, 2)) raw pixels in order along travel.
    :param std_px: name to (left (n,), right (m,)) 1-sigmas; see :meth:`Picks.of`.
    :param drift: see :class:`RoadProblem`.
    :param prior: what is known of any road.
    :param near: a road that is not far off, with the same lines.
    :raises NoRoadError: when the picks give no road to start from.
    """
    picks = Picks.of(lines, std_px, prior.pick_std_px)
    # a few picks, 2 a line, are only enough for a straight road
    most = min(MOST.curvature, len(picks.line) // 2 - 4 - len(lines))
    if near is not None:
        return _from_near(near, RoadProblem(rig, picks, near.problem.model, drift, prior), most)
    return _reaching(rig, lines, picks, drift, prior, most)


def _from_near(near: RoadFit, problem: RoadProblem, most: int) -> RoadFit:
    """Fit a road from one that is not far off; arguments as elsewhere."""
    fit = same_family(near, problem)
    return fit if most < 1 else _search([fit], most)


def _reaching(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]], picks: Picks,
              drift: Optional[DriftPrior], prior: RoadPrior, most: int) -> RoadFit:
    """
    Fit the road of greatest evidence of some that are longer and longer, up to all their picks.

    A guess lies in a plane, which may meet the rays of far picks too early.  Arguments are as for
    :func:`fit_road`.

    :param most: curvature coefficients.
    """
    tries = [_from_guesses(rig, lines, picks, drift, prior, most, 0.0)]
    while len(tries) < _LENGTHS and not _reaches(tries[-1]):
        half_m = _LONGER * _farthest_m(tries[-1])
        try:
            tries.append(_from_guesses(rig, lines, picks, drift, prior, most, half_m))
        except (NoRoadError, np.linalg.LinAlgError):  # of a road that is too long for its picks
            break
    return _best(tries)


def _reaches(fit: RoadFit) -> bool:
    """Return whether a road is long enough for its picks, or agrees with them as it is."""
    return (_farthest_m(fit) < _OVERREACH * float(fit.problem.model.s_m[-1])
            or fit.scale < _ASTRAY)


def _farthest_m(fit: RoadFit) -> float:
    """Return how far from the middle some line has two picks; one alone may be astray."""
    line = fit.problem.picks.line
    return max(float(np.sort(np.abs(fit.feet.s_m[line == i]))[-2]) for i in np.unique(line))


def _from_guesses(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]], picks: Picks,
                  drift: Optional[DriftPrior], prior: RoadPrior, most: int, least_half_m: float
                  ) -> RoadFit:
    """
    Fit one road from guesses, by way of clicks; arguments as for :func:`fit_road`.

    :param most: curvature coefficients.
    :param least_half_m: half the length of the road, at least.
    """
    if picks.median_std_px < prior.pick_std_px:
        # Among precise picks there are many roads that no small step makes better.
        clicks = Picks.of(lines, None, prior.pick_std_px)
        near = _from_guesses(rig, lines, clicks, drift, prior, most, least_half_m)
        return _from_near(near, RoadProblem(rig, picks, near.problem.model, drift, prior), most)
    rotated = np.zeros(0) if drift is None else drift.mean_rad
    fits = []
    for terms in range(max(min(most, 2), 0) + 1):  # each from its own guess
        model, start = guess_road(rig, list(lines.values()), terms, least_half_m)
        fits.append(_solve(RoadProblem(rig, picks, model, drift, prior),
                           np.append(start, rotated)))
    if most < 1:
        return fits[0]
    # straight roads go over crests and through sags, real bends climb and are banked
    for fit in tuple(fits):
        shape = fit.problem.model.shape
        fits.append(_reshaped(fit, shape._replace(tilt=2) if shape.curvature
                              else shape._replace(vertical=2)))
    return _search(fits, most)


def in_family(fit: RoadFit, family: RoadFit, drift: DriftPrior) -> RoadFit:
    """
    Fit the family of a road, with lines that may run off from each other a little.

    :param fit: where to start.
    :param family: a road of that family, where to start if only one of both has a vertical curve,
        a run-off or a transition.
    :param drift: what is known of the drift of the right camera.
    """
    shape = family.problem.model.shape
    if shape.built != fit.problem.model.shape.built:
        fit = family
    problem = fit.problem
    model, start = problem.model.reshaped(shape, fit.x[:problem.model.size], tapered=True)
    return _solve(RoadProblem(problem.rig, problem.picks, model, drift, problem.prior,
                              family.problem.wander), np.append(start, fit.drift_rad))


def _search(fits: list[RoadFit], most: int) -> RoadFit:
    """
    Return the road of greatest evidence, with its rivals.

    Where the picks of a line are off together, lines may wander, and the road is searched again.

    :param fits: roads to start from.
    :param most: curvature coefficients.
    """
    strict = _explored(fits, most)
    known = _best(strict)
    asked, found = _asked(known), None
    for _ in range(_WANDER_ROUNDS):
        if not any(asked.std_m):
            break
        found = _explored(_loosened(known, asked), most)
        known, before = _best(found), asked
        asked = _asked(known)
        if (np.allclose(asked.std_m, before.std_m, rtol=_SAME_WANDER, atol=0.0)
                and any(asked.shape == fit.problem.model.shape for fit in found)):
            break
    return with_rivals(strict) if found is None else _either(with_rivals(strict),
                                                             with_rivals(found))


def _explored(fits: list[RoadFit], most: int) -> list[RoadFit]:
    """
    Return roads of families that are widened as long as the evidence rises.

    :param fits: roads to start from.
    :param most: curvature coefficients.
    """
    fits = list(fits)
    built: set[RoadShape] = set()  # once more than they are known: their starts may be bad ones
    while True:
        best = _best(fits)
        known = {fit.problem.model.shape for fit in fits}
        tries = _promising(best, known, most, variance_of(fits))
        as_built = [one for one in _as_built(best.problem.model.shape) if one not in built]
        for other in (*tries, *as_built):
            built |= {other} & set(as_built)
            fits.append(_reshaped(best, other) if other in tries else _rebuilt(best, other))
            if _best(fits) is fits[-1]:
                break
        if _best(fits) is best:
            return fits


class _Asked(NamedTuple):
    """
    Which road the picks ask for, if lines may wander, were all linear.

    :param log_evidence: of it, but for a constant that all roads of these picks share.
    :param shape: of it.
    :param std_m: (lines,) by how much each line wanders.
    """

    log_evidence: float
    shape: RoadShape
    std_m: tuple[float, ...]


def _asked(fit: RoadFit) -> _Asked:
    """Return what the picks ask for, about a road or one that lacks what they may not ask for."""
    squares = _Squares.about(fit)
    return max((_asked_of(fit, shape, squares) for shape in _plainer(fit.problem.model.shape)),
               key=lambda one: one.log_evidence)


def _plainer(shape: RoadShape) -> Iterator[RoadShape]:
    """Yield a family, and those that lack kinds of its numbers."""
    for curvature, *rest in product(sorted({shape.curvature, min(shape.curvature, 1), 0}), *(
            sorted({count, 0}) for count in shape[2:])):
        yield RoadShape(curvature, shape.tilt if curvature else 0, *rest)


class _Squares(NamedTuple):
    """
    The robust cost near a road, as squares.

    :param own: (n,) weights of the picks' residuals.
    :param slope: (n,) weights of their derivatives.
    :param beyond: what the squares lack of the cost.
    :param ways: in which each line may wander, by picks of that weight.
    """

    own: Array
    slope: Array
    beyond: float
    ways: list[Ways]

    @classmethod
    def at(cls, fit: RoadFit) -> _Squares:
        """
        Return the cost near a road in its minimum, which it stays with them.

        With squares that are no steeper there than the cost, a road that is far from its picks
        would seem to have a far better one nearby.
        """
        root = np.sqrt(1 + (fit.off / ROBUST)**2)
        weight, beyond = np.sqrt(1 / root), np.sum(fit.off**2 * (2 / (root + 1) - 1 / root))
        return cls(weight, weight, float(beyond), ways_of(fit, weight))

    @classmethod
    def about(cls, fit: RoadFit) -> _Squares:
        """Return the cost of roads that may meet the picks far better, so that none is lost."""
        root = np.sqrt(1 + (fit.off / ROBUST)**2)
        slope = np.sqrt(1 / root)
        return cls(np.sqrt(2 / (root + 1)), slope, 0.0, ways_of(fit, slope))


def ways_of(fit: RoadFit, weight: Array) -> list[Ways]:
    """
    Return the ways in which each line may wander about a road.

    :param weight: (n,) of the picks.
    """
    problem, slope = fit.problem, fit.slope
    picks, first = problem.picks, problem.model.places.offsets.start
    mine = [np.flatnonzero(picks.line == line) for line in range(problem.model.lines)]
    return [Ways.of(own, weight[own] * slope[own, first + line], fit.feet.s_m[own],
                    problem.prior.wander_length_m) for line, own in enumerate(mine)]


def _evidence(fit: RoadFit, shape: RoadShape, squares: _Squares) -> WanderEvidence:
    """Return the probability of picks on lines that wander, about a road of a narrower family."""
    model, count = fit.problem.model, len(fit.problem.picks.line)
    size, first = len(fit.x), model.places.tapers.start
    kept = model.columns(shape, size)
    out = np.setdiff1d(np.arange(size), kept)
    rest = np.zeros(size)
    rest[out] = fit.x[out]
    rest[model.idle] = 0.0
    residual, jacobian = fit.problem.rigid(fit.x), fit.slope
    residual = residual - jacobian @ rest
    residual[:count] *= squares.own
    rows = np.setdiff1d(np.arange(len(residual)), count + 1 + out - first)
    weighted = jacobian[:, kept].copy()
    weighted[:count] *= squares.slope[:, None]
    return WanderEvidence(
        squares.ways, residual[rows], weighted[rows], squares.beyond, _least_variance(fit.problem))


def _log_beforehand(fit: RoadFit, shape: RoadShape) -> float:
    """Return the logarithm of the chance of a narrower family, and of its numbers' 1-sigmas."""
    model = fit.problem.model
    std = np.ones(model.size)
    std[model.places.tapers.start:] = fit.problem.prior_std
    kept = model.columns(shape, model.size)
    return log_chance(shape, fit.problem.prior) - float(np.log(std[kept]).sum())


def _asked_of(fit: RoadFit, shape: RoadShape, squares: _Squares) -> _Asked:
    """Return by how much lines wander on a road of a narrower family."""
    best, std_m = _evidence(fit, shape, squares).asked(fit.problem.prior.may_wander)
    return _Asked(best + _log_beforehand(fit, shape), shape, std_m)


def _loosened(fit: RoadFit, asked: _Asked) -> list[RoadFit]:
    """Return roads with lines that wander, of a family as it is and as it is asked for."""
    problem = fit.problem
    ways = ways_of(fit, np.ones(len(problem.picks.line)))
    loose = replace(fit, problem=RoadProblem(
        problem.rig, problem.picks, problem.model, problem.drift, problem.prior,
        wander_of(ways, asked.std_m, len(problem.picks.line))))
    return [_reshaped(loose, shape) for shape in sorted({asked.shape, problem.model.shape})]


def _log_probability(fit: RoadFit) -> float:
    """Return that of a road, which can be compared with that of others of the same picks."""
    shape, may = fit.problem.model.shape, fit.problem.prior.may_wander
    evidence = _evidence(fit, shape, _Squares.at(fit))
    if fit.problem.wander is not None:
        return evidence.wandering(may)[0] + _log_beforehand(fit, shape)
    still = (0,) * fit.problem.model.lines
    return evidence.at(still) + may.log_chance(still) + _log_beforehand(fit, shape)


def _either(strict: RoadFit, loose: RoadFit) -> RoadFit:
    """Return the more probable one of two roads, with the other one among its rivals."""
    gain = _log_probability(loose) - _log_probability(strict)
    best, other = (loose, strict) if gain > 0 else (strict, loose)
    odds = float(np.exp(-abs(gain)))
    rivals = [(odds * share, fit) for share, fit in ((1.0, other), *other.rivals)]
    return replace(best, rivals=(*best.rivals, *(r for r in rivals if r[0] > _RIVAL)))


def with_rivals(fits: list[RoadFit]) -> RoadFit:
    """Return the road of greatest evidence, with those of other families that come near it."""
    logs = log_evidences(fits)
    top = max(logs)
    best = fits[logs.index(top)]
    odds: dict[RoadShape, tuple[float, RoadFit]] = {}
    for fit, log in zip(fits, logs):
        shape, chance = fit.problem.model.shape, float(np.exp(log - top))
        if shape != best.problem.model.shape and chance > odds.get(shape, (_RIVAL, fit))[0]:
            odds[shape] = chance, fit
    return replace(best, rivals=tuple(odds.values()))


def log_chance(shape: RoadShape, prior: RoadPrior) -> float:
    """
    Return the logarithm of the probability of a family, but for a constant.

    A bend that lies in a plane is the exception, as is each number more; but a bend whose
    curvature changes evenly, as where it begins and ends, is as common as an arc.
    """
    plane_bend = bool(shape.curvature) and not shape.tilt
    numbers = sum(shape) - shape.tilt - (shape.curvature > 1)
    return (numbers + plane_bend) * float(np.log(prior.bent_probability))


def _promising(fit: RoadFit, known: set[RoadShape], most: int, variance: float
               ) -> list[RoadShape]:
    """
    Return other families whose evidence would be greater, the best first, were all linear.

    :param known: families that need not be looked at.
    :param most: curvature coefficients.
    """
    shape, problem = fit.problem.model.shape, fit.problem
    limit = MOST._replace(curvature=max(most, shape.curvature))
    wide = RoadShape(*(min(a + b, c) for a, b, c in zip(shape, _WIDER, limit)))
    model, x = problem.model.reshaped(wide, fit.x, problem.model.tapered)
    wider = RoadFit(RoadProblem(
        problem.rig, problem.picks, model, problem.drift, problem.prior, problem.wander), x,
        fit.cost, wander=fit.wander)
    residual, jacobian = wider.weighted(variance)
    gradient, normal = jacobian.T @ residual, jacobian.T @ jacobian
    count = len(gradient)
    std = np.ones(count)
    std[model.places.tapers.start:model.size] = wider.problem.prior_std

    telling = x.copy()
    telling[model.idle] = 0.0

    def promise(new: RoadShape) -> float:
        kept = model.columns(new, count)
        out = np.setdiff1d(np.arange(count), kept)
        part, rest = normal[np.ix_(kept, kept)], telling[out]
        slope = gradient[kept] - normal[np.ix_(kept, out)] @ rest
        gain = slope @ np.linalg.solve(part, slope) + rest @ (
            2 * gradient[out] - normal[np.ix_(out, out)] @ rest)
        return (0.5 * float(gain - np.linalg.slogdet(part)[1]) - float(np.log(std[kept]).sum())
                + log_chance(new, problem.prior))
    more = (RoadShape(*map(sum, zip(shape, by))) for by in product(
        *(range(b - a + 1) for a, b in zip(shape, wide))))
    promises = {new: promise(new) for new in (*more, *_narrower(shape))
                if new.tilt != 1 and (new.curvature or not new.tilt)}
    least = promises[shape] + _LEAST_GAIN
    return sorted((p for p in promises if p not in known and promises[p] > least),
                  key=lambda p: -promises[p])[:_TRIED]


def _as_built(shape: RoadShape) -> list[RoadShape]:
    """Return families with more of what is built, for several numbers of a polynomial."""
    options: list[dict[str, int]] = []
    if shape.vertical > 1 and not shape.vertical_curve:
        options.append({'vertical': 0, 'vertical_curve': VERTICAL_CURVE})
    if shape.twist > 1 and not shape.run_off:
        options.append({'twist': 0, 'run_off': RUN_OFF})
    if shape.curvature > 2 and not shape.transition:
        options.append({'curvature': 1, 'transition': TRANSITION})
    chosen = sorted(product((True, False), repeat=len(options)), key=sum, reverse=True)
    return [shape._replace(**{key: count for option, one in zip(options, taken) if one
                              for key, count in option.items()})
            for taken in chosen if any(taken)]


def _narrower(shape: RoadShape) -> Iterator[RoadShape]:
    """Yield the families that lack one number, or all that belong together."""
    for name, less in (('curvature', 1), ('tilt', 2), ('vertical', 1), ('twist', 1),
                       ('vertical_curve', VERTICAL_CURVE), ('run_off', RUN_OFF),
                       ('transition', TRANSITION)):
        count = getattr(shape, name) - less
        if count >= 0 and not (name == 'curvature' and count == 0 and shape.tilt):
            yield shape._replace(**{name: count})


def variance_of(fits: list[RoadFit]) -> float:
    """Return the variance of the picks, in their own, about the closest of some roads."""
    problem = fits[0].problem
    count = len(problem.picks.line)
    return max(min(f.cost / max(count - f.problem.size, 1) for f in fits),
               _least_variance(problem))


def log_evidences(fits: Sequence[RoadFit]) -> list[float]:
    """
    Return the logarithms (n,) of the probabilities of the picks on some roads, but for a constant.

    The picks scatter as they do about the closest road.  About lines that do not wander they
    scatter more, which is as likely then, and that lines wander, and how far, has a probability
    of its own: roads whose lines wander otherwise have their own scatter, and the best ones of
    them tell how much more probable the ones are than the others.

    :param fits: of the same picks, with the same unknowns of the rig.
    """
    alike: dict[Optional[Wander], list[int]] = {}
    for number, fit in enumerate(fits):
        alike.setdefault(fit.problem.wander, []).append(number)
    out = np.zeros(len(fits))
    for mine in alike.values():
        variance = variance_of([fits[i] for i in mine])
        out[mine] = [fits[i].log_evidence(variance) for i in mine]
        if len(alike) > 1:
            best = mine[int(np.argmax(out[mine]))]
            out[mine] += _log_probability(fits[best]) - out[best]
    return [float(log) for log in out]


def _best(fits: list[RoadFit]) -> RoadFit:
    """Return the road of greatest evidence."""
    logs = log_evidences(fits)
    return fits[logs.index(max(logs))]
