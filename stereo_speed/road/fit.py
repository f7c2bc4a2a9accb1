# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The joint fit of a road to all picks of all its lines, in both raw views.

The lines of a road are parallel, so they share one heading and one surface. The residual of a
pick is its distance from the projected line in units of its 1-sigma, so that far lines get their
proper weight. Evidence decides how the road curves, climbs and is banked: families of roads are
widened with further parameters as long as the marginal likelihood of the picks rises, given prior
knowledge of roads. Families of similar evidence remain as rivals, and their disagreement adds to
the uncertainty.

A marking may be displaced over some metres. The residuals of its picks are then correlated, which
no road explains. If the evidence supports it, lines may wander (``wander.py``), and the road is
searched again.

The right camera may have rotated since the calibration. Lines that are parallel in space reveal
this: they have one vanishing point in each view, and both must be the same direction. On demand
the three angles of the rotation are unknowns as well.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Iterator, Mapping, NamedTuple, Optional, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .first_guess import guess_road, NoRoadError
from .model import RoadModel, RoadShape, VERTICAL_CURVE, Weights
from .problem import DriftPrior, Feet, Picks, pixels, REACH, RoadPrior, RoadProblem
from .run_off import axes_m, RUN_OFF
from .wander import Wander, wander_of, WanderEvidence, Ways
from ..core.records import Array
from ..estimation.robust import robust_std
from ..geometry.ray_plane import Plane
from ..geometry.rig import StereoRig

ROBUST = 3.3  # residuals, in sigmas, beyond which the soft L1 loss reduces their weight
# Most parameters of a road's shape: a clothoid needs two of curvature, a hairpin some more; the
# ends of a parabola in the middle of a road need five of vertical curvature.
MOST = RoadShape(8, 2, 6, 6, VERTICAL_CURVE, RUN_OFF)
MAX_STEPS = 40  # limit of the solver's evaluations; fits that converge need 10
FOOT_PLACES = 8001  # places along the road, some cm apart, among which a foot is looked up
# Scatter in 1-sigmas that not even 30 picks reach by chance; a longer road may explain it.
_ASTRAY = 1.5
# Reach of the road in distances of the last node: up to there the cubic through the last nodes
# extrapolates within 2 mm, even on an arc of 41 m radius.
OVERREACH = 1.1
_LENGTHS = 3  # most lengths of the road that are tried until it reaches its picks
_LONGER = REACH  # next half length as a multiple of the farthest foot, see _farthest_m
_NARROW = 0.7  # lower bound of the robust scatter, as a share of the r.m.s. scatter
_WIDER = RoadShape(curvature=2, tilt=2, vertical=2, twist=2)  # most parameters added in one step
_TRIED = 3  # most families of one step that are fitted, in the order of their promise
_RUN_OFF_COUNTS = 2  # parameters as which a run-off counts in the prior probability of a family
_LEAST_GAIN = 0.0  # least promised gain of the log evidence for which a family is fitted
_WANDER_ROUNDS = 3  # most alternations between finding roads and how far their lines wander
_SAME_WANDER = 0.3  # relative change of the 1-sigmas of wandering at which these have converged
_RIVAL = 5e-3  # least odds of a rival family against the best one


@dataclass(frozen=True, eq=False)
class RoadFit:
    """
    A fitted road.

    :param problem: picks and model.
    :param x: (size,) parameters.
    :param cost: robust sum of squares of the residuals in sigmas, including the priors.
    :param rivals: other roads that explain the picks, each with its odds against this one.
    :param wander: (k,) coefficients of the ways in which the lines wander, see :class:`Wander`.
    """

    problem: RoadProblem
    x: Array
    cost: float
    rivals: tuple[tuple[float, RoadFit], ...] = ()
    wander: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the lines, in the order of their numbers."""
        return self.problem.picks.names

    def number(self, name: str) -> int:
        """Return the number of a named line."""
        return self.names.index(name)

    @cached_property
    def feet(self) -> Feet:
        """Return the feet of the picks on the fitted lines."""
        return self.problem.feet(self.x)

    @cached_property
    def residual_px(self) -> Array:
        """Return the r.m.s. distance (lines,) of each line's picks from the line, px."""
        square, line = self.feet.residual_px**2, self.problem.picks.line
        return np.sqrt(np.bincount(line, square) / np.bincount(line))

    @property
    def off(self) -> Array:
        """Return the residuals (n,) of the picks from their wandering lines, in 1-sigmas."""
        return self._linear[0][:len(self.problem.picks.line)]

    @cached_property
    def scale(self) -> float:
        """Return the scatter of the picks, in units of their 1-sigmas."""
        off, wander = self.off, self.problem.wander
        free = max(len(off) - self.told - (0.0 if wander is None else wander.told), 1)
        # The robust estimate keeps one outlier from determining the scatter of the other picks.
        std = max(robust_std(off), _NARROW * float(np.sqrt(np.mean(off**2))),
                  float(np.sqrt(_least_variance(self.problem))))
        return std * float(np.sqrt(len(off) / free))

    @cached_property
    def told(self) -> float:
        """Return the number of unknowns of road and rig that the picks determine."""
        place = self.problem.model.places.run_off
        count = place.stop - place.start
        if not count:
            return float(len(self.x))
        # Most coefficients of a run-off are as their priors say.
        jacobian = self.slope
        known = np.diag(np.linalg.pinv(jacobian.T @ jacobian))[place]
        return float(len(self.x) - np.sum(known / self.problem.prior_std[-count:]**2))

    @cached_property
    def covariance(self) -> Array:
        """Return the covariance of road and rig (size, size), scaled by the residuals."""
        jacobian = self._linear[1]
        scale = np.ones(len(jacobian))
        scale[:len(self.feet.residual_px)] = self.scale  # picks only, not priors
        jacobian = jacobian / scale[:, None]
        size = len(self.x)
        return np.asarray(np.linalg.pinv(jacobian.T @ jacobian)[:size, :size], dtype=np.float64)

    def log_evidence(self, variance: float) -> float:
        """
        Return the log evidence of this family, up to a constant.

        This is Laplace's approximation, including the priors of all parameters that other families
        lack.  It is taken about the road that would be fitted with the given variance, because
        picks that scatter by more than their 1-sigmas have pulled this one too far off its priors.

        :param variance: variance of the picks in units of their own; it must be the same for all
            families that are compared.  Families whose lines wander differently have different
            ones (:func:`log_evidences`).
        """
        residual, jacobian = self.weighted(variance)
        normal = jacobian.T @ jacobian
        # At the minimum the pulls of picks and priors balance; with that variance picks pull less.
        count = len(self.problem.picks.line)
        pull = max(1 - 1 / variance, 0.0) * (jacobian[count:].T @ residual[count:])
        gain = float(pull @ np.linalg.solve(normal, pull))
        fit = -0.5 * (float(residual @ residual) - gain)
        occam = -0.5 * float(np.linalg.slogdet(normal)[1]) - float(
            np.log(self.problem.prior_std).sum())
        return fit + occam + log_chance(self.problem.model.shape, self.problem.prior)

    @cached_property
    def _linear(self) -> tuple[Array, Array]:
        """Return the residuals and their derivatives."""
        unknowns = np.append(self.x, self.wander)
        return self.problem.residuals(unknowns), self.problem.jacobian(unknowns)

    def weighted(self, variance: float) -> tuple[Array, Array]:
        """
        Return residuals and derivatives, weighted so that their squares equal the robust cost.

        :param variance: see :meth:`log_evidence`.
        """
        residual, jacobian = self._linear
        count = len(self.problem.picks.line)
        root = np.sqrt(1 + (residual[:count] / ROBUST)**2)
        cost, slope = np.ones(len(residual)), np.ones(len(residual))
        # Soft L1 is 2 f^2 (root - 1); slopes take the root of its derivative by the square.
        cost[:count] = np.sqrt(2 / (root + 1) / variance)
        slope[:count] = np.sqrt(1 / root / variance)
        return residual * cost, jacobian * slope[:, None]

    @property
    def slope(self) -> Array:
        """Return the derivatives (n + m, size) of picks and priors by road and rig."""
        rows = len(self._linear[0]) - len(self.wander)
        return self._linear[1][:rows, :len(self.x)]

    @property
    def drift_rad(self) -> Array:
        """Return pan, tilt and roll (3,) of the right camera since the calibration, rad."""
        return self.problem.drift_rad(self.x)

    @property
    def families(self) -> list[RoadFit]:
        """Return the road and its rivals."""
        return [self, *(rival for _, rival in self.rivals)]

    @property
    def plane(self) -> Plane:
        """Return the tangent plane of the road in its middle."""
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
        Return (n, ..., 3) points of the road surface beside a line, left optical frame, m.

        :param line: number of the line.
        :param s_m: (n,) reference arc lengths, m.
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
        Return the reference arc lengths (n,) at which a line is nearest to pixels (n, 2), m.

        :param line: number of the line.
        :param right: whether the pixels are of the right view.
        """
        nodes = self.problem.model.s_m
        s = np.linspace(REACH * nodes[0], REACH * nodes[-1], FOOT_PLACES)
        seen = self.seen(self.points(line, s, np.zeros_like(s)), right)
        gap = np.linalg.norm(seen - np.asarray(uv_px)[:, None], axis=-1)
        return np.asarray(s[np.argmin(np.where(np.isnan(gap), np.inf, gap), axis=-1)])

    def seen(self, points_m: Array, right: bool) -> Array:
        """
        Return the raw pixels of points (..., 3), with the drift applied; NaN behind the camera.

        :param right: whether to project into the right view.
        """
        rig = self.problem.rig
        if not right:
            return pixels(rig.left, points_m)
        return pixels(rig.right, self.problem.to_right(self.x, points_m))

    def line_range_m(self, line: int) -> tuple[float, float]:
        """Return the reference arc lengths of a line's first and last pick in any view, m."""
        s = self.feet.s_m[self.problem.picks.line == line]
        return float(s.min()), float(s.max())


def _least_variance(problem: RoadProblem) -> float:
    """Return the smallest credible variance of the picks, in units of their own."""
    return min((problem.prior.best_pick_std_px / problem.picks.median_std_px)**2, 1.0)


def _solve(problem: RoadProblem, start: Array) -> RoadFit:
    """Fit one model from a start, at which no line wanders."""
    if problem.wander is not None:
        start = np.append(start[:problem.size], np.zeros(problem.wander.count))
    if not np.isfinite(problem.residuals(start)).all():
        raise NoRoadError('the picks give no road to start from')
    result = least_squares(
        problem.residuals, start, jac=problem.jacobian, loss='soft_l1', f_scale=ROBUST,
        x_scale='jac', method='trf', xtol=1e-9, ftol=1e-5, gtol=1e-9, max_nfev=MAX_STEPS)
    return RoadFit(problem, result.x[:problem.size], 2 * float(result.cost),
                   wander=result.x[problem.size:])


def _reshaped(fit: RoadFit, shape: RoadShape) -> RoadFit:
    """Fit another family, starting from a fitted road."""
    problem = fit.problem
    model, start = problem.model.reshaped(shape, fit.x, problem.model.tapered)
    return _solve(RoadProblem(
        problem.rig, problem.picks, model, problem.drift, problem.prior, problem.wander), start)


def _rebuilt(fit: RoadFit, shape: RoadShape) -> RoadFit:
    """Fit a family with a vertical curve, starting from a road with vertical curvature."""
    problem, seen_m = fit.problem, fit.feet.s_m
    model, start = problem.model.as_built(
        shape, fit.x, (float(seen_m.min()), float(seen_m.max())))
    return _closely(problem, model, start)


def _closely(problem: RoadProblem, model: RoadModel, start: Array) -> RoadFit:
    """Fit another model to the picks of a problem, first with the 1-sigma of clicks."""
    # With precise picks the cost has many local minima.
    clicks = replace(problem.picks, std_px=np.maximum(
        problem.picks.std_px, problem.prior.pick_std_px))
    near = _solve(RoadProblem(problem.rig, clicks, model, problem.drift, problem.prior), start)
    if problem.wander is None and clicks.median_std_px == problem.picks.median_std_px:
        return near
    return _solve(RoadProblem(problem.rig, problem.picks, model, problem.drift, problem.prior,
                              problem.wander), near.x)


def same_family(fit: RoadFit, problem: RoadProblem) -> RoadFit:
    """
    Fit the same family of roads to another problem.

    :param fit: road to start from.
    :param problem: problem of the same shape; its rig, picks and drift prior may differ.
    """
    shape, tapered = problem.model.shape, problem.model.tapered
    start = fit.problem.model.reshaped(shape, fit.x[:fit.problem.model.size], tapered)[1]
    return _solve(problem, start if problem.drift is None else np.append(start, fit.drift_rad))


def fit_road(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]],
             std_px: Optional[Mapping[str, tuple[Array, Array]]] = None,
             drift: Optional[DriftPrior] = None, prior: RoadPrior = RoadPrior(), *,
             near: Optional[RoadFit] = None) -> RoadFit:
    """
    Fit one road to the picks of its lines; the evidence decides how it curves and climbs.

    :param lines: maps names to raw pixels (left (n, 2), right (m, 2)), in order along travel.
    :param std_px: maps names to 1-sigmas (left (n,), right (m,)), px; see :meth:`Picks.of`.
    :param drift: see :class:`RoadProblem`.
    :param prior: prior knowledge of any road.
    :param near: approximate road with the same lines to start from; None finds a start.
    :raises NoRoadError: the picks give no road to start from.
    """
    picks = Picks.of(lines, std_px, prior.pick_std_px)
    # Few picks, such as 2 per line, suffice only for a straight road.
    most = min(MOST.curvature, len(picks.line) // 2 - 4 - len(lines))
    if near is not None:
        return _from_near(near, RoadProblem(rig, picks, near.problem.model, drift, prior), most)
    return _reaching(rig, lines, picks, drift, prior, most)


def _from_near(near: RoadFit, problem: RoadProblem, most: int) -> RoadFit:
    """Fit a road from an approximate one; ``most`` as for :func:`_reaching`."""
    fit = same_family(near, problem)
    return fit if most < 1 else _search([fit], most)


def _reaching(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]], picks: Picks,
              drift: Optional[DriftPrior], prior: RoadPrior, most: int) -> RoadFit:
    """
    Fit roads of increasing length until one reaches its picks; return that of greatest evidence.

    The initial guess lies in a plane, which may intersect the rays of far picks too early and so
    be too short.  The other arguments are those of :func:`fit_road`.

    :param most: largest number of curvature coefficients.
    """
    tries = [_from_guesses(rig, lines, picks, drift, prior, most, 0.0)]
    while len(tries) < _LENGTHS and not _reaches(tries[-1]):
        half_m = _LONGER * _farthest_m(tries[-1])
        try:
            tries.append(_from_guesses(rig, lines, picks, drift, prior, most, half_m))
        except (NoRoadError, np.linalg.LinAlgError):  # the road is too long for its picks
            break
    return _best(tries)


def _reaches(fit: RoadFit) -> bool:
    """Return whether a road is long enough for its picks, or agrees with them anyway."""
    return (_farthest_m(fit) < OVERREACH * float(fit.problem.model.s_m[-1])
            or fit.scale < _ASTRAY)


def _farthest_m(fit: RoadFit) -> float:
    """Return the second largest distance of a line's feet from the middle, of any line, m."""
    line = fit.problem.picks.line
    return max(float(np.sort(np.abs(fit.feet.s_m[line == i]))[-2]) for i in np.unique(line))


def _from_guesses(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]], picks: Picks,
                  drift: Optional[DriftPrior], prior: RoadPrior, most: int, least_half_m: float
                  ) -> RoadFit:
    """
    Fit one road from guesses; the other arguments are those of :func:`fit_road`.

    :param most: largest number of curvature coefficients.
    :param least_half_m: smallest half length of the road, m.
    """
    if picks.median_std_px < prior.pick_std_px:
        # With precise picks the cost has many local minima; fit with the 1-sigma of clicks first.
        clicks = Picks.of(lines, None, prior.pick_std_px)
        near = _from_guesses(rig, lines, clicks, drift, prior, most, least_half_m)
        return _from_near(near, RoadProblem(rig, picks, near.problem.model, drift, prior), most)
    rotated = np.zeros(0) if drift is None else drift.mean_rad
    fits = []
    for terms in range(max(min(most, 2), 0) + 1):  # each from a guess of its own
        model, start = guess_road(rig, list(lines.values()), terms, least_half_m)
        fits.append(_solve(RoadProblem(rig, picks, model, drift, prior),
                           np.append(start, rotated)))
    if most < 1:
        return fits[0]
    # Straight roads have crests and sags; real bends climb and are banked.
    for fit in tuple(fits):
        shape = fit.problem.model.shape
        fits.append(_reshaped(fit, shape._replace(tilt=2) if shape.curvature
                              else shape._replace(vertical=2)))
    return _search(fits, most)


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
    return _solve(RoadProblem(problem.rig, problem.picks, model, drift, problem.prior,
                              family.problem.wander), np.append(start, fit.drift_rad))


def _search(fits: list[RoadFit], most: int) -> RoadFit:
    """
    Return the road of greatest evidence, with its rivals.

    If the residuals of a line are correlated, lines may wander, and the road is searched again.

    :param fits: roads to start from.
    :param most: largest number of curvature coefficients.
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
    Return roads of families that are widened as long as the evidence rises, with run-offs last.

    :param fits: roads to start from.
    :param most: largest number of curvature coefficients.
    """
    fits = _widened(fits, most)
    # A road that misses kinks makes its picks seem to scatter more.
    built = _with_run_off(_best(fits), min(variance_of(fits), 1.0))
    if built is None:
        return fits
    fits.append(built)
    return _widened(fits, most) if _best(fits) is built else fits


def _with_run_off(fit: RoadFit, variance: float) -> Optional[RoadFit]:
    """
    Fit a road with a run-off if its evidence should be greater, by linear approximation.

    :param fit: best road without one, as far as is known.
    :param variance: see :meth:`RoadFit.log_evidence`.
    :return: None if the road is straight and plane or has a run-off already, if its picks are no
        more precise than clicks, which cannot show kinks, or if a run-off promises nothing.
    """
    problem, shape = fit.problem, fit.problem.model.shape
    precise = problem.picks.median_std_px < problem.prior.pick_std_px
    if shape.run_off or not any(shape) or not precise:
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
        tries += [(near.promise(one), near, one) for one in shapes]
        least = near.promise(shape) + _LEAST_GAIN
    promise, near, one = max(tries, key=lambda known: known[0])
    return near.fitted(one) if promise > least else None


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
    The family that the picks support if lines may wander, by linear approximation.

    :param log_evidence: its log evidence, up to a constant that all roads of these picks share.
    :param shape: its shape.
    :param std_m: (lines,) 1-sigma of how far each line wanders, m.
    """

    log_evidence: float
    shape: RoadShape
    std_m: tuple[float, ...]


def _asked(fit: RoadFit) -> _Asked:
    """Return the best supported one of a road's family and plainer ones, by linearisation."""
    squares = _Squares.about(fit)
    return max((_asked_of(fit, shape, squares) for shape in _plainer(fit.problem.model.shape)),
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
        squares.ways, residual[rows], weighted[rows], squares.beyond, _least_variance(fit.problem),
        size - fit.told if shape.run_off else 0.0)


def _log_beforehand(fit: RoadFit, shape: RoadShape) -> float:
    """Return the log prior of a narrower family, including the 1-sigmas of its parameters."""
    model = fit.problem.model
    std = np.ones(model.size)
    std[model.places.tapers.start:] = fit.problem.prior_std
    kept = model.columns(shape, model.size)
    return log_chance(shape, fit.problem.prior) - float(np.log(std[kept]).sum())


def _asked_of(fit: RoadFit, shape: RoadShape, squares: _Squares) -> _Asked:
    """Return how far lines wander on a road of a narrower family, and its evidence."""
    best, std_m = _evidence(fit, shape, squares).asked(fit.problem.prior.may_wander)
    return _Asked(best + _log_beforehand(fit, shape), shape, std_m)


def _loosened(fit: RoadFit, asked: _Asked) -> list[RoadFit]:
    """Return roads whose lines may wander, of the road's own family and the supported one."""
    problem = fit.problem
    ways = ways_of(fit, np.ones(len(problem.picks.line)))
    loose = replace(fit, problem=RoadProblem(
        problem.rig, problem.picks, problem.model, problem.drift, problem.prior,
        wander_of(ways, asked.std_m, len(problem.picks.line))))
    return [_reshaped(loose, shape) for shape in sorted({asked.shape, problem.model.shape})]


def _log_probability(fit: RoadFit) -> float:
    """Return the log probability of a road, comparable between all roads of the same picks."""
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
    """Return the road of greatest evidence, with roads of other families as its rivals."""
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
    Return the log prior probability of a family, up to a constant.

    A plane bend is an exception, and so is each further parameter; but a bend whose curvature
    changes linearly, as at its beginning and end, is as common as an arc.
    """
    plane_bend = bool(shape.curvature) and not shape.tilt
    numbers = sum(shape) - shape.tilt - (shape.curvature > 1)
    if shape.run_off:
        numbers += _RUN_OFF_COUNTS - shape.run_off
    return (numbers + plane_bend) * float(np.log(prior.bent_probability))


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
        rest = self.x[out]
        gain = slope @ np.linalg.solve(part, slope) + rest @ (
            2 * self.gradient[out] - self.normal[np.ix_(out, out)] @ rest)
        return (0.5 * float(gain - np.linalg.slogdet(part)[1])
                - float(np.log(self.std[kept]).sum())
                + log_chance(shape, self.fit.problem.prior))

    def fitted(self, shape: RoadShape) -> RoadFit:
        """Fit a family, starting from the road that should be its best one."""
        kept, _, part, slope = self._parts(shape)
        x, problem = self.fit.x.copy(), self.fit.problem
        mine = kept < len(x)
        x[kept[mine]] -= np.linalg.solve(part, slope)[mine]
        return _closely(problem, *problem.model.reshaped(shape, x, problem.model.tapered))


def _as_built(shape: RoadShape) -> list[RoadShape]:
    """Return the family with a vertical curve in place of two or more vertical coefficients."""
    if shape.vertical < 2 or shape.vertical_curve:
        return []
    return [shape._replace(vertical=0, vertical_curve=VERTICAL_CURVE)]


def _narrower(shape: RoadShape) -> Iterator[RoadShape]:
    """Yield the families with one parameter less, or without the tilt."""
    for name, less in (('curvature', 1), ('tilt', 2), ('vertical', 1), ('twist', 1),
                       ('run_off', RUN_OFF)):
        count = getattr(shape, name) - less
        if count >= 0 and not (name == 'curvature' and count == 0 and shape.tilt) and not (
                name == 'tilt' and shape.run_off):
            yield shape._replace(**{name: count})


def variance_of(fits: list[RoadFit]) -> float:
    """Return the variance of the picks, in units of their own, about the closest of some roads."""
    problem = fits[0].problem
    count = len(problem.picks.line)
    return max(min(f.cost / max(count - f.told, 1) for f in fits),
               _least_variance(problem))


def log_evidences(fits: Sequence[RoadFit]) -> list[float]:
    """
    Return the log evidences (n,) of some roads, up to a constant.

    Roads whose lines wander alike share one variance of the picks, that about the closest of
    them.  Groups of roads whose lines wander differently have different variances, and how far
    lines wander has a prior of its own, so groups are compared by the probabilities of their best
    roads.

    :param fits: roads of the same picks, with the same unknowns of the rig.
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
