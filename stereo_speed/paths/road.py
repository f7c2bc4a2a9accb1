# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The joint fit of a road: all picks of all its lines, in both raw views, at once.

Lines of one road are parallel, so they share one heading and one surface. What each pick says is
how far it lies from its projected line, in its own 1-sigma; a far line thus weighs as little as
it should. The data decide (BIC) how much the road turns and whether its surface bends; weak
priors keep bends from following the scatter of the picks.

The right camera may have turned since the calibration. Lines that are parallel in space tell:
they meet in one vanishing point in each view, and the two must be one direction. On demand its
three angles are unknowns as well.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Mapping, Optional

import numpy as np
from scipy.optimize import least_squares

from .road_guess import guess_road
from .road_model import RoadModel, turn_matrix, Weights
from ..geometry.camera import Camera
from ..geometry.rig import StereoRig
from ..records import Array

PICK_STD_PX = 0.3  # what a careful person reaches; of picks that come without a 1-sigma
ROBUST = 3.3  # residuals beyond as many sigmas count less and less (soft L1)
MIN_STD_PX = 0.02  # no picks are better than this
PENALTY = 2.0  # times that of BIC; at 1 one straight road in fifteen was taken for a curve
MAX_TURNS = 8
TURN_STEP_RAD = 1e-6  # moves the picks by something like 1e-3 px
MAX_STEPS = 40
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
    :param std_px: (n,) 1-sigma across the line.
    """

    uv_px: Array
    line: Array
    right: Array
    std_px: Array

    @classmethod
    def of(cls, lines: Mapping[str, tuple[Array, Array]],
           std_px: Optional[Mapping[str, tuple[Array, Array]]] = None) -> Picks:
        """
        Gather the picks of named lines.

        :param lines: name to (left (n, 2), right (m, 2)).
        :param std_px: name to (left (n,), right (m,)) 1-sigmas; those of careful clicks for
            lines that are not named.
        """
        given = std_px or {}
        parts = [(view, i, j) for i, pair in enumerate(lines.values())
                 for j, view in enumerate(pair)]
        stds = [given[name][j] if name in given else np.full(len(pair[j]), PICK_STD_PX)
                for name, pair in lines.items() for j in (0, 1)]
        return cls(np.concatenate([view for view, _, _ in parts]).astype(np.float64),
                   np.concatenate([np.full(len(view), i) for view, i, _ in parts]),
                   np.concatenate([np.full(len(view), j == 1) for view, _, j in parts]),
                   np.concatenate(stds).astype(np.float64))


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


def _pixels(camera: Camera, points_m: Array) -> Array:
    """Project points (..., 3) of the camera's frame to raw pixels; NaN behind the camera."""
    z = points_m[..., 2:]
    return camera.distort(points_m[..., :2] / np.where(z > 0.1, z, np.nan))


class RoadProblem:
    """
    The residuals of a road model and their derivatives.

    :param rig: the calibrated rig.
    :param picks: of all lines.
    :param model: the family of roads.
    :param turn_std_rad: (3,) 1-sigma by which the right camera may have panned, tilted and
        rolled; these angles are then the last three unknowns. None: not at all.
    """

    def __init__(self, rig: StereoRig, picks: Picks, model: RoadModel,
                 turn_std_rad: Optional[Array] = None) -> None:
        self.rig, self.picks, self.model = rig, picks, model
        self.turn_std_rad = turn_std_rad
        self.steps = model.steps if turn_std_rad is None else np.append(
            model.steps, np.full(3, TURN_STEP_RAD))
        self._last: Optional[tuple[Array, _Feet]] = None

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.steps)

    def turn_rad(self, x: Array) -> Array:
        """Take pan, tilt and roll (..., 3) of the right camera; zeros where they are fixed."""
        if self.turn_std_rad is None:
            return np.zeros(x.shape[:-1] + (3,))
        return x[..., -3:]

    def to_right(self, x: Array, points_m: Array) -> Array:
        """Carry points (..., n, 3) into the frame of the right camera as it stands now."""
        right = self.rig.to_right(points_m)
        return right if self.turn_std_rad is None else right @ turn_matrix(self.turn_rad(x))

    def at(self, x: Array, weights: Weights) -> Array:
        """Give the pixels (..., n, 2) of the lines at fixed arc lengths, one for each pick."""
        points, frames = self.model.reference(x)
        return self._seen(x, (points, frames[..., 1]), weights)

    def _seen(self, x: Array, reference: tuple[Array, Array], weights: Weights) -> Array:
        """Place a point on the line of each pick and project it into the view of the pick."""
        points, left = (weights(values) for values in reference)
        points = points + self.model.offsets(x)[..., self.picks.line, None] * left
        uv_px, right = np.empty(points.shape[:-1] + (2,)), self.picks.right
        uv_px[..., ~right, :] = _pixels(self.rig.left, points[..., ~right, :])
        uv_px[..., right, :] = _pixels(
            self.rig.right, self.to_right(x, points[..., right, :]))
        return uv_px

    def feet(self, x: Array) -> _Feet:
        """Find where each pick meets its projected line."""
        if self._last is not None and np.array_equal(self._last[0], x):
            return self._last[1]
        points, frames = self.model.reference(x)
        reference = points, frames[..., 1]
        nodes, h = self.model.s_m, 0.01
        s, reach = nodes[self._nearest_nodes(x, reference)], 3 * (nodes[1] - nodes[0])
        for _ in range(3):
            here, after = (self._seen(x, reference, Weights.at(nodes, s + d))
                           for d in (-h, h))
            tangent, off = (after - here) / (2 * h), self.picks.uv_px - (here + after) / 2
            step = np.sum(off * tangent, -1) / np.sum(tangent * tangent, -1)
            s = np.clip(s + np.nan_to_num(np.clip(step, -reach, reach)),
                        1.3 * nodes[0], 1.3 * nodes[-1])
        length = np.linalg.norm(tangent, axis=-1, keepdims=True)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / length
        off = self.picks.uv_px - self._seen(x, reference, Weights.at(nodes, s))
        residual = np.sum(normal * off, axis=-1)
        lost = ~np.isfinite(residual)  # behind a camera: far off, and no slope
        feet = _Feet(s, np.where(lost[:, None], 0.0, normal), np.where(lost, 1e3, residual))
        self._last = x.copy(), feet
        return feet

    def _nearest_nodes(self, x: Array, reference: tuple[Array, Array]) -> Array:
        """Give the node (n,) whose projection is nearest to each pick."""
        lines = reference[0] + self.model.offsets(x)[:, None, None] * reference[1]
        views = (_pixels(self.rig.left, lines), _pixels(self.rig.right, self.to_right(x, lines)))
        nearest = np.zeros(len(self.picks.line), dtype=int)
        for i in range(self.model.lines):
            for right in (False, True):
                mine = (self.picks.line == i) & (self.picks.right == right)
                gap = self.picks.uv_px[mine, None] - views[int(right)][i]
                square = np.sum(gap * gap, axis=-1)
                nearest[mine] = np.argmin(np.where(np.isnan(square), np.inf, square), axis=-1)
        return nearest

    def priors(self, x: Array) -> Array:
        """
        Give weak constraints as (..., 4 or 7) residuals in sigmas.

        They are roll, grade, crossfall and crest, and the turn of the right camera.
        """
        up = (self.model.reference(x)[1])[..., len(self.model.s_m) // 2, :, :]
        bend = self.model.bend(x)
        roll = up[..., 1, 1]  # how far the left axis dips below the camera's horizontal
        crest = bend[..., 2] / (self.model.half_length_m * CREST_STD_PER_M)
        weak = np.stack([roll / ROLL_STD_RAD, bend[..., 0] / BEND_STD[0],
                         bend[..., 1] / BEND_STD[1], crest], axis=-1)
        if self.turn_std_rad is None:
            return weak
        return np.concatenate([weak, self.turn_rad(x) / self.turn_std_rad], axis=-1)

    def residuals(self, x: Array) -> Array:
        """Give all residuals in sigmas."""
        return np.append(self.feet(x).residual_px / self.picks.std_px, self.priors(x))

    def jacobian(self, x: Array) -> Array:
        """Differentiate; moving a foot along its line changes nothing, so feet stay."""
        feet, steps = self.feet(x), self.steps
        weights = Weights.at(self.model.s_m, feet.s_m)
        both = x + np.concatenate([np.diag(steps), -np.diag(steps)])
        uv = self.at(both, weights)
        moved = np.concatenate(
            [-np.sum(np.nan_to_num(uv) * feet.normal, axis=-1) / self.picks.std_px,
             self.priors(both)], axis=-1)
        return ((moved[:len(steps)] - moved[len(steps):]) / (2 * steps[:, None])).T


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
    def scale(self) -> float:
        """Scatter of the picks against their 1-sigmas."""
        picks = self.problem.picks
        off = self.feet.residual_px / picks.std_px
        free = max(len(off) - len(self.x), 1)
        # a robust scale: one pick gone astray says nothing of the others
        std = max(1.4826 * float(np.median(np.abs(off))), 0.7 * float(np.sqrt(np.mean(off**2))),
                  float(np.sqrt(_least_variance(picks))))
        return std * float(np.sqrt(len(off) / free))

    @cached_property
    def covariance(self) -> Array:
        """Covariance (size, size) of the parameters, scaled by the residuals."""
        jacobian = self.problem.jacobian(self.x)
        scale = np.ones(len(jacobian))
        scale[:len(self.feet.residual_px)] = self.scale  # priors say what they say
        jacobian = jacobian / scale[:, None]
        return np.linalg.pinv(jacobian.T @ jacobian)

    @property
    def turn_rad(self) -> Array:
        """Pan, tilt and roll (3,) of the right camera since the calibration."""
        return self.problem.turn_rad(self.x)

    def points(self, line: int, s_m: Array, across_m: Array) -> Array:
        """
        Give points (..., 3) of the surface beside a line, left optical frame.

        :param line: its number.
        :param s_m: (n,) reference arc lengths.
        :param across_m: (n, ...) distances from the line, m, positive to the left.
        """
        model = self.problem.model
        points, frames = model.reference(self.x)
        weights = Weights.at(model.s_m, s_m)
        offset = np.asarray(across_m) + model.offsets(self.x)[line]
        shape = (len(s_m),) + (1,) * (offset.ndim - 1) + (3,)
        return (weights(points).reshape(shape)
                + offset[..., None] * weights(frames[..., 1]).reshape(shape))

    def seen(self, points_m: Array, right: bool) -> Array:
        """
        Project points (..., 3) into a raw view, the right one as turned; NaN behind the camera.

        :param right: the right view.
        """
        rig = self.problem.rig
        if not right:
            return _pixels(rig.left, points_m)
        return _pixels(rig.right, self.problem.to_right(self.x, points_m))

    def line_range_m(self, line: int) -> tuple[float, float]:
        """Give the reference arc lengths of a line's first and last pick, both views together."""
        s = self.feet.s_m[self.problem.picks.line == line]
        return float(s.min()), float(s.max())


def _least_variance(picks: Picks) -> float:
    """Bound from below, in their own sigmas, how well picks can agree with a road."""
    return min(float((MIN_STD_PX / np.median(picks.std_px))**2), 1.0)


def _solve(problem: RoadProblem, start: Array) -> RoadFit:
    """Fit one model from a start."""
    result = least_squares(
        problem.residuals, start, jac=problem.jacobian, loss='soft_l1', f_scale=ROBUST,
        x_scale='jac', method='trf', xtol=1e-9, ftol=1e-5, gtol=1e-9, max_nfev=MAX_STEPS)
    return RoadFit(problem, result.x, 2 * float(result.cost))


def _widened(fit: RoadFit, turns: int, bends: int) -> RoadFit:
    """Fit a wider model, from a narrower one's result."""
    problem = fit.problem
    model, start = problem.model.within(turns, bends, fit.x)
    return _solve(RoadProblem(problem.rig, problem.picks, model, problem.turn_std_rad), start)


def refit(fit: RoadFit, picks: Picks, turn_std_rad: Optional[Array] = None) -> RoadFit:
    """
    Fit the same family of roads to other picks, or with the right camera free to turn.

    :param fit: where to start.
    :param picks: of the same lines.
    :param turn_std_rad: see :class:`RoadProblem`.
    """
    problem = fit.problem
    start = fit.x[:problem.model.size]
    if turn_std_rad is not None:
        start = np.append(start, fit.turn_rad)
    return _solve(RoadProblem(problem.rig, picks, problem.model, turn_std_rad), start)


def fit_road(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]],
             std_px: Optional[Mapping[str, tuple[Array, Array]]] = None,
             turn_std_rad: Optional[Array] = None) -> RoadFit:
    """
    Fit one road to the picks of its lines; the data decide how it turns and bends.

    :param lines: name to (left (n, 2), right (m, 2)) raw pixels in order along travel.
    :param std_px: name to (left (n,), right (m,)) 1-sigmas; see :meth:`Picks.of`.
    :param turn_std_rad: see :class:`RoadProblem`.
    :raises ValueError: when the picks give no road to start from.
    """
    picks = Picks.of(lines, std_px)
    turn = np.zeros(0 if turn_std_rad is None else 3)
    flat: list[RoadFit] = []
    # a few picks, 2 a line, are only enough for a straight road
    most = min(MAX_TURNS, len(picks.line) // 2 - 4 - len(lines))
    for turns in range(max(min(most, 2), 0) + 1):  # each from its own guess
        model, start = guess_road(rig, list(lines.values()), turns)
        flat.append(_solve(RoadProblem(rig, picks, model, turn_std_rad), np.append(start, turn)))
    while len(flat) <= most and not _settled(flat):
        flat.append(_widened(flat[-1], len(flat), 0))
    fits = flat + [_widened(fit, fit.problem.model.turns, 1) for fit in flat[1:]]
    if most < 1:
        return flat[0]
    fits.append(_widened(flat[0], 0, 3))  # a straight road over a crest or through a dip
    for fit in _best(fits, 2):
        fits += [_widened(fit, fit.problem.model.turns, bends) for bends in (2, 3)
                 if bends > fit.problem.model.bends]
    return _best(fits, 1)[0]


def _settled(flat: list[RoadFit]) -> bool:
    """Say whether a straight road already explains what wider ones do."""
    picks = flat[-1].problem.picks
    variance = max(flat[-1].cost / len(picks.line), _least_variance(picks))
    return flat[0].cost - flat[-1].cost < 10 * variance


def _best(fits: list[RoadFit], count: int) -> list[RoadFit]:
    """Sort by BIC, with the scatter of the picks from the closest fit."""
    picks = fits[0].problem.picks
    number = len(picks.line)
    variance = max(min(f.cost / max(number - f.problem.size, 1) for f in fits),
                   _least_variance(picks))
    return sorted(fits, key=lambda f: f.cost / variance
                  + PENALTY * f.problem.size * np.log(number))[:count]
