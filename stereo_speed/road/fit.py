# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The joint fit of a road: all picks of all its lines, in both raw views, at once.

Lines of one road are parallel, so they share one heading and one surface. Each pick measures
how far it lies from its projected line, in its own 1-sigma; a far line thus weighs as little as
it should. The data decide (BIC) how the road curves and whether its surface is bent; weak
priors keep both from following the scatter of the picks.

The right camera may have rotated since the calibration. Lines that are parallel in space show it:
they meet in one vanishing point in each view, and the two must be one direction. On demand its
three angles are unknowns as well.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Mapping, Optional

import numpy as np
from scipy.optimize import least_squares

from .first_guess import guess_road, NoRoadError
from .model import Weights
from .problem import DriftPrior, Feet, Picks, pixels, REACH, RoadPrior, RoadProblem
from ..core.records import Array
from ..estimation.robust import robust_std
from ..geometry.ray_plane import Plane
from ..geometry.rig import StereoRig

ROBUST = 3.3  # residuals beyond this many sigmas count less and less (soft L1)
AIC = 2.0  # Akaike's penalty for each number that describes a curved road, for precise picks
MAX_CURVATURE_TERMS = 8  # a clothoid needs two; what needs more is several curves
MAX_STEPS = 40  # of the solver; fits that converge need 10
FOOT_PLACES = 8001  # places along the road among which a foot is looked up: some cm apart
_NARROW = 0.7  # least ratio of the robust to the r.m.s. scatter: a few outliers are no excuse
_SETTLED = 10.0  # times the variance by which a straight road may be worse than any other
_PRECISE = 3.0  # times better than clicks: then a road too simple harms more than one too rich


@dataclass(frozen=True, eq=False)
class RoadFit:
    """
    A fitted road.

    :param problem: picks and model.
    :param x: (size,) parameters.
    :param cost: robust sum of squares, in sigmas, priors included.
    """

    problem: RoadProblem
    x: Array
    cost: float

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

    @cached_property
    def scale(self) -> float:
        """Scatter of the picks against their 1-sigmas."""
        picks = self.problem.picks
        off = self.feet.residual_px / picks.std_px
        free = max(len(off) - len(self.x), 1)
        # one stray pick is no measure of the others
        std = max(robust_std(off), _NARROW * float(np.sqrt(np.mean(off**2))),
                  float(np.sqrt(_least_variance(self.problem))))
        return std * float(np.sqrt(len(off) / free))

    @cached_property
    def covariance(self) -> Array:
        """Covariance (size, size) of the parameters, scaled by the residuals."""
        jacobian = self.problem.jacobian(self.x)
        scale = np.ones(len(jacobian))
        scale[:len(self.feet.residual_px)] = self.scale  # priors are not scaled
        jacobian = jacobian / scale[:, None]
        return np.asarray(np.linalg.pinv(jacobian.T @ jacobian), dtype=np.float64)

    @property
    def drift_rad(self) -> Array:
        """Pan, tilt and roll (3,) of the right camera since the calibration."""
        return self.problem.drift_rad(self.x)

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
        offset = np.asarray(across_m) + model.offsets(self.x)[line]
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


def _solve(problem: RoadProblem, start: Array) -> RoadFit:
    """Fit one model from a start."""
    if not np.isfinite(problem.residuals(start)).all():
        raise NoRoadError('the picks give no road to start from')
    result = least_squares(
        problem.residuals, start, jac=problem.jacobian, loss='soft_l1', f_scale=ROBUST,
        x_scale='jac', method='trf', xtol=1e-9, ftol=1e-5, gtol=1e-9, max_nfev=MAX_STEPS)
    return RoadFit(problem, result.x, 2 * float(result.cost))


def _widened(fit: RoadFit, curvature_terms: int, surface_terms: int) -> RoadFit:
    """Fit a wider model, from a narrower one's result."""
    problem = fit.problem
    model, start = problem.model.widened(curvature_terms, surface_terms, fit.x)
    return _solve(RoadProblem(
        problem.rig, problem.picks, model, problem.drift, problem.prior), start)


def same_family(fit: RoadFit, problem: RoadProblem) -> RoadFit:
    """
    Fit the same family of roads again.

    :param fit: where to start.
    :param problem: with the model of ``fit``; its rig, picks or drift prior may be others.
    """
    start = fit.x[:problem.model.size]
    return _solve(problem, start if problem.drift is None else np.append(start, fit.drift_rad))


def fit_road(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]],
             std_px: Optional[Mapping[str, tuple[Array, Array]]] = None,
             drift: Optional[DriftPrior] = None, prior: RoadPrior = RoadPrior()) -> RoadFit:
    """
    Fit one road to the picks of its lines; the data decide how it curves and climbs.

    :param lines: name to (left (n, 2), right (m, 2)) raw pixels in order along travel.
    :param std_px: name to (left (n,), right (m,)) 1-sigmas; see :meth:`Picks.of`.
    :param drift: see :class:`RoadProblem`.
    :param prior: what is known of any road.
    :raises NoRoadError: when the picks give no road to start from.
    """
    picks = Picks.of(lines, std_px, prior.pick_std_px)
    rotated = np.zeros(0) if drift is None else drift.mean_rad
    flat: list[RoadFit] = []
    # a few picks, 2 a line, are only enough for a straight road
    most = min(MAX_CURVATURE_TERMS, len(picks.line) // 2 - 4 - len(lines))
    for terms in range(max(min(most, 2), 0) + 1):  # each from its own guess
        model, start = guess_road(rig, list(lines.values()), terms)
        flat.append(_solve(RoadProblem(rig, picks, model, drift, prior),
                           np.append(start, rotated)))
    while len(flat) <= most and not _settled(flat) and not _past(flat):
        flat.append(_widened(flat[-1], len(flat), 0))
    if most < 1:
        return flat[0]
    bent = [_widened(flat[1], 1, 1)]
    while len(bent) < len(flat) - 1 and not _past(bent):
        bent.append(_widened(flat[len(bent) + 1], len(bent) + 1, 1))
    # and a straight road over a crest or through a dip
    fits = flat + bent + [_widened(flat[0], 0, 3)]
    for fit in _best(fits, 2):
        model = fit.problem.model
        fits += [_widened(fit, model.curvature_terms, terms) for terms in (2, 3)
                 if terms > model.surface_terms]
    return _best(fits, 1)[0]


def _settled(flat: list[RoadFit]) -> bool:
    """Return whether a straight road already explains what wider ones do."""
    problem = flat[-1].problem
    variance = max(flat[-1].cost / len(problem.picks.line), _least_variance(problem))
    return flat[0].cost - flat[-1].cost < _SETTLED * variance


def _past(fits: list[RoadFit]) -> bool:
    """Return whether the last two curvature terms were both of no use."""
    return len(fits) > 3 and all(fit is not _best(fits, 1)[0] for fit in fits[-2:])


def _best(fits: list[RoadFit], count: int) -> list[RoadFit]:
    """
    Return the best by BIC, with the scatter of the picks from the closest fit.

    Where picks are precise and BIC decides that the road is curved, AIC decides how.
    """
    problem = fits[0].problem
    number = len(problem.picks.line)
    variance = max(min(f.cost / max(number - f.problem.size, 1) for f in fits),
                   _least_variance(problem))

    def score(fit: RoadFit, penalty: float) -> float:
        return fit.cost / variance + penalty * fit.problem.size

    penalty = problem.prior.curvature_penalty * float(np.log(number))
    strict = sorted(fits, key=lambda f: score(f, penalty))
    if not strict[0].problem.model.curvature_terms or not _precise(problem):
        return strict[:count]
    return sorted(fits, key=lambda f: (
        not f.problem.model.curvature_terms, score(f, AIC)))[:count]


def _precise(problem: RoadProblem) -> bool:
    """Return whether picks are far better than clicks."""
    return problem.picks.median_std_px < problem.prior.pick_std_px / _PRECISE
