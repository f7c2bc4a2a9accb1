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

from .first_guess import guess_road
from .model import Weights
from .problem import Feet, PICK_STD_PX, Picks, pixels, RoadProblem, TurnPrior
from ..core.records import Array
from ..geometry.rig import StereoRig

ROBUST = 3.3  # residuals beyond as many sigmas count less and less (soft L1)
MIN_STD_PX = 0.02  # no picks are better than this
PENALTY = 2.0  # times that of BIC; at 1 one straight road in fifteen was taken for a curve
AIC = 2.0  # for each number that describes a curved road, where picks are precise
MAX_TURNS = 8
MAX_STEPS = 40
FOOT_PLACES = 8001  # along the road, where one is looked up


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
        Find points of the surface beside a line: (..., 3), left optical frame.

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

    def foot(self, line: int, right: bool, uv_px: Array) -> Array:
        """
        Give the reference arc lengths (n,) where pixels (n, 2) of a view are nearest a line.

        :param line: its number.
        :param right: the right view.
        """
        nodes = self.problem.model.s_m
        s = np.linspace(1.3 * nodes[0], 1.3 * nodes[-1], FOOT_PLACES)
        seen = self.seen(self.points(line, s, np.zeros_like(s)), right)
        gap = np.linalg.norm(seen - np.asarray(uv_px)[:, None], axis=-1)
        return s[np.argmin(np.where(np.isnan(gap), np.inf, gap), axis=-1)]

    def seen(self, points_m: Array, right: bool) -> Array:
        """
        Project points (..., 3) into a raw view, the right one as turned; NaN behind the camera.

        :param right: the right view.
        """
        rig = self.problem.rig
        if not right:
            return pixels(rig.left, points_m)
        return pixels(rig.right, self.problem.to_right(self.x, points_m))

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
    return _solve(RoadProblem(problem.rig, problem.picks, model, problem.turn), start)


def same_family(fit: RoadFit, problem: RoadProblem) -> RoadFit:
    """
    Fit the same family of roads again.

    :param fit: where to start.
    :param problem: with the model of ``fit``; its rig, picks or prior of a turn may be others.
    """
    start = fit.x[:problem.model.size]
    return _solve(problem, start if problem.turn is None else np.append(start, fit.turn_rad))


def fit_road(rig: StereoRig, lines: Mapping[str, tuple[Array, Array]],
             std_px: Optional[Mapping[str, tuple[Array, Array]]] = None,
             turn: Optional[TurnPrior] = None) -> RoadFit:
    """
    Fit one road to the picks of its lines; the data decide how it turns and bends.

    :param lines: name to (left (n, 2), right (m, 2)) raw pixels in order along travel.
    :param std_px: name to (left (n,), right (m,)) 1-sigmas; see :meth:`Picks.of`.
    :param turn: see :class:`RoadProblem`.
    :raises ValueError: when the picks give no road to start from.
    """
    picks = Picks.of(lines, std_px)
    turned = np.zeros(0) if turn is None else turn.mean_rad
    flat: list[RoadFit] = []
    # a few picks, 2 a line, are only enough for a straight road
    most = min(MAX_TURNS, len(picks.line) // 2 - 4 - len(lines))
    for turns in range(max(min(most, 2), 0) + 1):  # each from its own guess
        model, start = guess_road(rig, list(lines.values()), turns)
        flat.append(_solve(RoadProblem(rig, picks, model, turn), np.append(start, turned)))
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
        fits += [_widened(fit, fit.problem.model.turns, bends) for bends in (2, 3)
                 if bends > fit.problem.model.bends]
    return _best(fits, 1)[0]


def _settled(flat: list[RoadFit]) -> bool:
    """Say whether a straight road already explains what wider ones do."""
    picks = flat[-1].problem.picks
    variance = max(flat[-1].cost / len(picks.line), _least_variance(picks))
    return flat[0].cost - flat[-1].cost < 10 * variance


def _past(fits: list[RoadFit]) -> bool:
    """Say whether the last two turns more were both of no use."""
    return len(fits) > 3 and all(fit is not _best(fits, 1)[0] for fit in fits[-2:])


def _best(fits: list[RoadFit], count: int) -> list[RoadFit]:
    """
    Sort by BIC, with the scatter of the picks from the closest fit.

    Where picks are precise and BIC says that the road is curved, AIC says how.
    """
    picks = fits[0].problem.picks
    number = len(picks.line)
    variance = max(min(f.cost / max(number - f.problem.size, 1) for f in fits),
                   _least_variance(picks))

    def score(fit: RoadFit, penalty: float) -> float:
        return fit.cost / variance + penalty * fit.problem.size

    strict = sorted(fits, key=lambda f: score(f, PENALTY * float(np.log(number))))
    if not strict[0].problem.model.turns or not _precise(picks):
        return strict[:count]
    return sorted(fits, key=lambda f: (not f.problem.model.turns, score(f, AIC)))[:count]


def _precise(picks: Picks) -> bool:
    """Say whether picks are so good that a road too simple does more harm than one too rich."""
    return bool(np.median(picks.std_px) < PICK_STD_PX / 3)
