# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The joint fit of a road: all picks of all its lines, in both raw views, at once.

Lines of one road are parallel, so they share one heading and one surface. What each pick says is
how far it lies from its projected line, in px; a far line thus weighs as little as it should. The
data decide (BIC) how much the road turns and whether its surface bends; weak priors keep bends
from following the scatter of the picks.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Mapping

import numpy as np
from scipy.optimize import least_squares

from .road_guess import guess_road
from .road_model import BENDS, RoadModel, Weights
from ..geometry.rig import StereoRig
from ..records import Array

PICK_STD_PX = 0.3  # what a careful person reaches; only sets the weight of the priors
ROBUST_PX = 1.0  # residuals beyond this count less and less (soft L1)
MAX_TURNS = 6
ROLL_STD_RAD = 0.1  # of the road about its direction, against the camera's up
BEND_STD = (0.06, 0.04)  # grade and crossfall of a bent surface, rad
CREST_STD_PER_M = 1 / 800  # vertical curvature


@dataclass(frozen=True, eq=False)
class Picks:
    """
    All picks of a road's lines.

    :param uv_px: (n, 2) raw pixels.
    :param line: (n,) number of the line.
    :param right: (n,) whether it is of the right view.
    """

    uv_px: Array
    line: Array
    right: Array

    @classmethod
    def of(cls, lines: Mapping[str, tuple[Array, Array]]) -> Picks:
        """
        Gather the picks of named lines.

        :param lines: name to (left (n, 2), right (m, 2)).
        """
        parts = [(view, i, j) for i, pair in enumerate(lines.values())
                 for j, view in enumerate(pair)]
        return cls(np.concatenate([view for view, _, _ in parts]).astype(np.float64),
                   np.concatenate([np.full(len(view), i) for view, i, _ in parts]),
                   np.concatenate([np.full(len(view), j == 1) for view, _, j in parts]))


@dataclass(frozen=True, eq=False)
class _Feet:
    """
    Where the picks meet their lines.

    :param s_m: (n,) reference arc length of the foot of each pick.
    :param normal: (n, 2) unit normal of the projected line there.
    :param residual_px: (n,) signed distance of the pick from it.
    """

    s_m: Array
    normal: Array
    residual_px: Array


class RoadProblem:
    """The residuals of a road model and their derivatives."""

    def __init__(self, rig: StereoRig, picks: Picks, model: RoadModel) -> None:
        self.rig, self.picks, self.model = rig, picks, model

    def _seen(self, lines_m: Array) -> Array:
        """Project points (..., n, 3), one for each pick, into the view of the pick."""
        left = self.rig.left.project(lines_m)[0]
        right = self.rig.right.project(self.rig.to_right(lines_m))[0]
        return np.where(self.picks.right[:, None], right, left)

    def at(self, x: Array, weights: Weights) -> Array:
        """Give the pixels (..., n, 2) of the lines at fixed arc lengths, one for each pick."""
        points, frames = self.model.reference(x)
        offsets = self.model.offsets(x)[..., self.picks.line, None]
        return self._seen(weights(points) + offsets * weights(frames[..., 1]))

    def feet(self, x: Array) -> _Feet:
        """Find where each pick meets its projected line."""
        nodes, h = self.model.s_m, 0.01
        s = nodes[self._nearest_nodes(x)]
        for _ in range(4):
            here, after = (self.at(x, Weights.at(nodes, s + d)) for d in (-h, h))
            tangent, off = (after - here) / (2 * h), self.picks.uv_px - (here + after) / 2
            step = np.sum(off * tangent, -1) / np.sum(tangent * tangent, -1)
            step = np.nan_to_num(np.clip(step, -3 * (nodes[1] - nodes[0]), 3 * (nodes[1] - nodes[0])))
            s = np.clip(s + step, 1.3 * nodes[0], 1.3 * nodes[-1])
        length = np.linalg.norm(tangent, axis=-1, keepdims=True)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / length
        residual = np.sum(normal * (self.picks.uv_px - self.at(x, Weights.at(nodes, s))), axis=-1)
        lost = ~np.isfinite(residual)  # behind a camera: far off, and no slope
        return _Feet(s, np.where(lost[:, None], 0.0, normal), np.where(lost, 1e3, residual))

    def _nearest_nodes(self, x: Array) -> Array:
        """Give the node (n,) whose projection is nearest to each pick."""
        points, frames = self.model.reference(x)
        lines = points + self.model.offsets(x)[:, None, None] * frames[..., 1]
        views = self.rig.project(lines)[:2]
        nearest = np.zeros(len(self.picks.line), dtype=int)
        for i in range(self.model.lines):
            for right in (False, True):
                mine = (self.picks.line == i) & (self.picks.right == right)
                gap = self.picks.uv_px[mine, None] - views[int(right)][i]
                square = np.nan_to_num(np.sum(gap * gap, axis=-1), nan=np.inf)
                nearest[mine] = np.argmin(square, axis=-1)
        return nearest

    def priors(self, x: Array) -> Array:
        """Give the weak priors (..., 4) as residuals in px: roll, grade, crossfall, crest."""
        up = (self.model.reference(x)[1])[..., len(self.model.s_m) // 2, :, :]
        bend = self.model.bend(x)
        roll = up[..., 1, 1]  # how far the left axis dips below the camera's horizontal
        crest = bend[..., 2] / (self.model.half_length_m * CREST_STD_PER_M)
        return PICK_STD_PX * np.stack([
            roll / ROLL_STD_RAD, bend[..., 0] / BEND_STD[0], bend[..., 1] / BEND_STD[1], crest],
            axis=-1)

    def residuals(self, x: Array) -> Array:
        """Give all residuals in px."""
        return np.append(self.feet(x).residual_px, self.priors(x))

    def jacobian(self, x: Array) -> Array:
        """Differentiate; moving a foot along its line changes nothing, so feet stay."""
        feet, steps = self.feet(x), self.model.steps
        weights = Weights.at(self.model.s_m, feet.s_m)
        both = x + np.concatenate([np.diag(steps), -np.diag(steps)])
        uv = self.at(both, weights)
        moved = np.concatenate(
            [-np.sum(np.nan_to_num(uv) * feet.normal, axis=-1), self.priors(both)], axis=-1)
        return ((moved[:len(steps)] - moved[len(steps):]) / (2 * steps[:, None])).T


@dataclass(frozen=True, eq=False)
class RoadFit:
    """
    A fitted road.

    :param problem: picks and model.
    :param x: (size,) parameters.
    :param cost_px2: robust sum of squares, priors included.
    """

    problem: RoadProblem
    x: Array
    cost_px2: float

    @cached_property
    def feet(self) -> _Feet:
        """Where the picks meet the fitted lines."""
        return self.problem.feet(self.x)

    @cached_property
    def residual_px(self) -> Array:
        """Root mean square distance (lines,) of each line's picks from it."""
        square, line = self.feet.residual_px**2, self.problem.picks.line
        return np.sqrt(np.bincount(line, square) / np.bincount(line))

    @cached_property
    def covariance(self) -> Array:
        """Covariance (size, size) of the parameters, scaled by the residuals."""
        jacobian = self.problem.jacobian(self.x)
        free = max(len(self.feet.residual_px) - len(self.x), 1)
        # a robust scale: one pick gone astray says nothing of the others
        std = max(1.4826 * float(np.median(np.abs(self.feet.residual_px))),
                  0.7 * float(np.sqrt(np.mean(self.feet.residual_px**2))), 0.02)
        scale = std**2 * len(self.feet.residual_px) / free
        return scale * np.linalg.pinv(jacobian.T @ jacobian)

    def line_range_m(self, line: int) -> tuple[float, float]:
        """Give the reference arc lengths of a line's first and last pick, both views together."""
        s = self.feet.s_m[self.problem.picks.line == line]
        return float(s.min()), float(s.max())


def _solve(problem: RoadProblem, start: Array) -> RoadFit:
    """Fit one model from a start."""
    result = least_squares(
        problem.residuals, start, jac=problem.jacobian, loss='soft_l1', f_scale=ROBUST_PX,
        x_scale='jac', method='trf', xtol=1e-9, ftol=1e-9, gtol=1e-9, max_nfev=60)
    return RoadFit(problem, result.x, 2 * float(result.cost))


def fit_road(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]]) -> RoadFit:
    """
    Fit one road to the picks of its lines; the data decide how it turns and bends.

    :param lines: name to (left (n, 2), right (m, 2)) raw pixels in order along travel.
    :raises ValueError: when the picks give no road to start from.
    """
    picks = Picks.of(lines)
    fits = []
    for turns in range(MAX_TURNS + 1):
        model, start = guess_road(rig, list(lines.values()), turns, 0)
        fits.append(_solve(RoadProblem(rig, picks, model), start))
    bent = [_bent(fit) for fit in _best(fits, 3)]
    return _best(fits + bent, 1)[0]


def _bent(fit: RoadFit) -> RoadFit:
    """Let the surface of a fitted road bend."""
    old = fit.problem.model
    model = RoadModel(old.frame, old.centre_m, old.half_length_m, old.lines, old.turns, BENDS)
    problem = RoadProblem(fit.problem.rig, fit.problem.picks, model)
    return _solve(problem, np.append(fit.x, np.zeros(BENDS)))


def _best(fits: list[RoadFit], count: int) -> list[RoadFit]:
    """Sort by BIC, with the scatter of the picks from the richest model."""
    free = [len(f.feet.residual_px) - f.problem.model.size for f in fits]
    variance = max(min(f.cost_px2 / max(k, 1) for f, k in zip(fits, free)), 0.02**2)
    picks = len(fits[0].feet.residual_px)
    return sorted(fits, key=lambda f: f.cost_px2 / variance
                  + f.problem.model.size * np.log(picks))[:count]
