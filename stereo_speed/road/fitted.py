# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A fitted road: its points, its uncertainty and its evidence."""
from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from .line_kernels import REACH
from .model import RoadShape, Weights
from .problem import Feet, pixels, RoadPrior, RoadProblem
from ..core.records import Array
from ..estimation.robust import robust_std
from ..geometry.ray_plane import Plane

ROBUST = 3.3  # residuals, in sigmas, beyond which the soft L1 loss reduces their weight
FOOT_PLACES = 8001  # places along the road, some cm apart, among which a foot is looked up
_FEW = 5  # picks beyond those that determine the road, from which their own scatter counts
_NARROW = 0.7  # lower bound of the robust scatter, as a share of the r.m.s. scatter
_SCALES = (1.0, 0.1, 0.01)  # of the prior 1-sigmas of changes of the curvature
_RUN_OFF_COUNTS = 2  # parameters as which a run-off counts in the prior probability of a family


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
        # A road that passes through nearly all of few picks does not show how these scatter.
        least = 1.0 if free < _FEW else float(np.sqrt(least_variance(self.problem)))
        # The robust estimate keeps one outlier from determining the scatter of the other picks.
        std = max(robust_std(off), _NARROW * float(np.sqrt(np.mean(off**2))), least)
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
        covariance = np.linalg.inv(normal)
        # At the minimum the pulls of picks and priors balance; with that variance picks pull less.
        count = len(self.problem.picks.line)
        pull = max(1 - 1 / variance, 0.0) * (jacobian[count:].T @ residual[count:])
        gain = float(pull @ covariance @ pull)
        fit = -0.5 * (float(residual @ residual) - gain)
        occam = -0.5 * float(np.linalg.slogdet(normal)[1]) - float(
            np.log(self.problem.prior_std).sum())
        changes = self.problem.changes(self.problem.model.shape)
        return (fit + occam + log_chance(self.problem.model.shape, self.problem.prior)
                + log_any_scale(self.x[changes], np.diag(covariance)[changes],
                                self.problem.change_std(changes)))

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


def least_variance(problem: RoadProblem) -> float:
    """Return the smallest credible variance of the picks, in units of their own."""
    return min((problem.prior.best_pick_std_px / problem.picks.median_std_px)**2, 1.0)


def log_any_scale(estimate: Array, variance: Array, std: Array) -> float:
    """
    Return the log evidence that coefficients gain if their prior 1-sigma may be smaller as well.

    The curvature of a road may change a lot or hardly.  With one prior of large changes alone,
    slight ones would be so improbable that a turned camera would explain them better.

    This takes the coefficients as independent, and as known far better than by the largest prior,
    which is so where picks are more precise than clicks.

    :param estimate: (n,) coefficients.
    :param variance: (n,) their posterior variances.
    :param std: (n,) their largest prior 1-sigmas; smaller ones by tens are equally probable.
    """
    spread = variance + np.outer(_SCALES, std)**2
    logs = -0.5 * (estimate**2 / spread + np.log(spread))
    return float(np.sum(np.logaddexp.reduce(logs, axis=0) - logs[0] - np.log(len(_SCALES))))


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
