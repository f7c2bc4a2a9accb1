# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Photometric refinement of a pass: all looks of a front, both views, one least-squares problem.

A filter that keeps only the newest reference drifts, and one that fixes the depth at the start is
wrong by the error of that start.  Here the poses of all pairs so far, the speeds between them and
the error of the path's heading are unknowns together.  What the images say of them is written
down in ``photometry``, what is known without images in ``motion``.

Gauss-Newton on this gives the mean and covariance of the newest state, from this pair and
earlier ones only, and at the end of the pass the smoothed profile.
"""
from __future__ import annotations

import bisect
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from .motion_prior import (
    headings, lateral_rates, Layout, motion_models, MotionModel, PassMotion, PassPrior)
from .observation import lag_s, Observation, ObservationSampler
from .photometry import PassPhotometry, Photometry
from ..core.config import TrackerConfig
from ..core.records import Array, StereoPair
from ..estimation.gaussian import condition
from ..estimation.weights import normalise_log_weights

_FAR_PX = 0.5  # looks that have moved this far are taken again, however many
_MOST_JUDGEMENTS = 3  # of which looks are hidden, at the end of a pass
_MAX_MOVE_PX = 3.0  # a step beyond the patch's linear range is cut
_HALF_WIDTH_M = 0.8  # lever by which a change of heading moves the edges of a front
_NEGLIGIBLE = 1e-4  # weight of a motion model that counts for nothing in this pair


class _Effort(NamedTuple):
    """
    What is spent on an answer.

    :param iterations: usual number of them, and
    :param most: number while looks still move far, as when a change of lanes is noticed.
    :param moved_px: a look is taken again when its pose has moved further than this.
    :param retakes: looks retaken in one iteration, the most moved first.
    """

    iterations: int
    most: int
    moved_px: float
    retakes: int


_LIVE = _Effort(iterations=2, most=4, moved_px=0.10, retakes=2)
_AGAIN = _Effort(iterations=5, most=8, moved_px=0.05, retakes=2)  # after a gap guesses are poor
_FINAL = _Effort(iterations=8, most=8, moved_px=0.01, retakes=1000)


@dataclass(frozen=True, eq=False)
class Posterior:
    """
    Gaussian posterior of a whole pass.

    :param first_ns: stamp of the first pair, ns.
    :param stamps_s: (n,) time of each pair since the first, s.
    :param mean: (n, 4) s, a, b in m and the speed along the path in m/s.
    :param covariance: (4 n, 4 n) of the rows of ``mean`` in order.
    :param lateral_mps: (n,) rates at which the front moves across the path, m/s.
    :param heading_rad: (n,) headings against the path.
    :param stretch: (n,) metres that the front travels per metre of the path.
    :param cross_ncc: (n,) left-right NCC of each look.
    :param clear: (n,) whether the look shows the whole front: those hidden in part do not count.
    :param seen: (n,) whether it shows the vehicle at all.
    """

    first_ns: int
    stamps_s: Array
    mean: Array
    covariance: Array
    lateral_mps: Array
    heading_rad: Array
    stretch: Array
    cross_ncc: Array
    clear: Array
    seen: Array

    def at(self, k: int) -> tuple[Array, Array]:
        """Mean (4,) and covariance (4, 4) of pair ``k``."""
        n = range(len(self.mean))[k]
        block = slice(4 * n, 4 * n + 4)
        return self.mean[n], self.covariance[block, block]

    def ground_speeds(self) -> Array:
        """Give the speeds (n,) over ground, m/s."""
        along = self.mean[:, 3] * self.stretch
        return np.copysign(np.hypot(along, self.lateral_mps), along)

    def ground_ratio(self) -> Array:
        """Ground speed (n,) per speed along the path: carries the sigma of one to the other."""
        along = self.mean[:, 3]
        return self.ground_speeds() / np.where(along == 0, 1.0, along)


@dataclass(frozen=True, eq=False)
class _Solution:
    """Moments of the mixture of the motion models, their weights, and what the looks say."""

    mean: Array
    covariance: Array
    weights: Array
    photometry: Photometry


class PhotometricWindow:
    """Grows with every pair of a pass; see the module's docstring."""

    def __init__(self, sampler: ObservationSampler, prior: PassPrior, config: TrackerConfig) -> None:
        self.sampler, self.config = sampler, config
        self.photometry = PassPhotometry(sampler.relief_basis)
        self.nodes = sampler.relief_basis.shape[1]
        self.motion = PassMotion(prior, config, config.stamp_std_s, self.nodes)
        self.relief = np.zeros(self.nodes)
        self.models = motion_models(config)
        self.pairs: list[StereoPair] = []
        self.looks: list[Observation] = []
        self.state = np.zeros((0, 4))
        self.resting: list[StereoPair] = []
        self.hidden: frozenset[int] = frozenset()  # stamps of looks that do not count
        self.changing_lanes = 0.0  # probability that it does
        self._before = ([], [], self.state, self.relief, [], self.hidden, 0.0)

    def add(self, pair: StereoPair, guess: Array, *, again: bool = False) -> Posterior | None:
        """
        Take in a pair and refine everything.

        :param guess: (4,) s, a, b, v where the particles say the front is.
        :param again: whether the front was not wholly seen in the pair before.
        :return: None when the front is not wholly seen at the guess.
        """
        self._before = (self.pairs.copy(), self.looks.copy(), self.state, self.relief,
                        self.resting.copy(), self.hidden, self.changing_lanes)
        rate, heading = self._drift()
        look = self.sampler.look(pair, guess[:3], np.array([guess[3], rate, 0.0]), heading,
                                 self.relief)
        if look is None:
            return None
        self.pairs.append(pair)
        self.looks.append(look)
        self.state = np.vstack([self.state, guess])
        if len(self.looks) > self.config.effort.live_observations:
            self._rest()
        return self._refine(_AGAIN if again else _LIVE)

    def finish(self) -> Posterior:
        """Refine the whole pass, the resting pairs among it, without the looks hidden in part."""
        self._recall()
        for _ in range(_MOST_JUDGEMENTS):
            hidden = self.hidden
            posterior = self._refine(_FINAL)
            if self.hidden == hidden:
                break
        self.hidden = hidden  # those of this answer, should they not have settled
        return posterior

    def exact_speeds(self) -> tuple[Array, Array]:
        """
        Give the covariance of the speeds for better stamps and paths than there are.

        :return: (n, n), were the stamps exact, and (n, n), were the path's heading exact as well.
        """
        at = self._layout()
        exact = PassMotion(self.motion.prior, self.config, 0.0, self.nodes)
        covariance = self._solve(self.models, exact).covariance
        return covariance[np.ix_(at.speeds, at.speeds)], _given_tilt(covariance, at)

    def _layout(self) -> Layout:
        return Layout(len(self.looks), self.nodes)

    def drop_last(self) -> None:
        """Take the newest pair out again, and all it has moved: it was not the vehicle."""
        (self.pairs, self.looks, self.state, self.relief, self.resting, self.hidden,
         self.changing_lanes) = self._before

    def _rest(self) -> None:
        """Put the pair to rest, not the first or the newest two, that leaves the least gap."""
        effort = self.config.effort
        worst = _crowded(self.pairs[:-1])
        self.resting.append(self.pairs.pop(worst))
        del self.looks[worst]
        self.state = np.delete(self.state, worst, axis=0)
        self.resting.sort(key=lambda pair: pair.stamp_ns)
        if len(self.resting) > effort.pass_observations - effort.live_observations:
            self.resting.pop(_crowded(self.resting))

    def _recall(self) -> None:
        """Take the resting pairs in again, where the others say the front was."""
        times, first = self._times(), self.pairs[0].stamp_ns
        between = self.state.copy()
        for pair in self.resting:
            at = (pair.stamp_ns - first) * 1e-9
            guess = np.array([np.interp(at, times, column) for column in between.T])
            look = self.sampler.look(
                pair, guess[:3], np.array([guess[3], 0.0, 0.0]), 0.0, self.relief)
            if look is not None:
                k = bisect.bisect([p.stamp_ns for p in self.pairs], pair.stamp_ns)
                self.pairs.insert(k, pair)
                self.looks.insert(k, look)
                self.state = np.insert(self.state, k, guess, axis=0)
        self.resting = []

    def _refine(self, effort: _Effort) -> Posterior:
        """Iterate Gauss-Newton; looks are retaken only where their pose has moved."""
        models = self.models
        for done in range(1, effort.most + 1):
            solution = self._solve(models, self.motion)
            self.changing_lanes = float(sum(
                w for m, w in zip(models, solution.weights) if m.changes_lanes))
            models = [m for m, w in zip(models, solution.weights) if w > _NEGLIGIBLE]
            moved_px = self._step(solution.mean, effort)
            if not moved_px or (done >= effort.iterations and moved_px < _FAR_PX):
                break
        self._judge(solution.photometry)
        return self._posterior(solution)

    def _judge(self, photometry: Photometry) -> None:
        """Decide which looks count from now on, if any would."""
        clear = photometry.clear()
        if clear.any():
            asleep = self.hidden - {pair.stamp_ns for pair in self.pairs}
            self.hidden = asleep.union(
                pair.stamp_ns for pair, counts in zip(self.pairs, clear) if not counts)

    def _counts(self) -> Array:
        """Tell which looks (n,) count."""
        return np.array([pair.stamp_ns not in self.hidden for pair in self.pairs])

    def _posterior(self, solution: _Solution) -> Posterior:
        """Put the solution in the order of the pairs."""
        at = self._layout()
        order = np.column_stack([at.poses, at.speeds]).ravel()
        rates, stretch, heading = self._directions()
        seen = solution.photometry
        return Posterior(
            self.pairs[0].stamp_ns, self._times(), self.state.copy(),
            solution.covariance[np.ix_(order, order)], rates, heading, stretch, seen.cross_ncc,
            seen.clear(), seen.seen())

    def _solve(self, models: list[MotionModel], motion: PassMotion) -> _Solution:
        """
        Solve for poses, speeds, accelerations and tilt at the present looks.

        The evidence of the images for each model of motion is Gaussian and closed; the answer is
        the moments of the mixture, so that a steady pass is not made noisy for the sake of a
        braking one, nor a braking one biased.
        """
        seen, times = self.photometry(self.looks, self._counts()), self._times()
        answers = [condition(prior, seen.H, seen.right)
                   for prior in motion.equations(times, self.state, models)]
        weights = normalise_log_weights(np.array(
            [math.log(model.share) + answer.log_evidence
             for model, answer in zip(models, answers)]))
        likely = [(w / weights[weights > _NEGLIGIBLE].sum(), a)
                  for w, a in zip(weights, answers) if w > _NEGLIGIBLE]
        mean = sum(w * a.mean for w, a in likely)
        covariance = sum(w * (a.covariance + np.outer(a.mean - mean, a.mean - mean))
                         for w, a in likely)
        return _Solution(mean, covariance, weights, seen)

    def _times(self) -> Array:
        first = self.pairs[0].stamp_ns
        return np.array([(p.stamp_ns - first) * 1e-9 for p in self.pairs])

    def _directions(self) -> tuple[Array, Array, Array]:
        """
        Lateral rates, stretches and headings (n,) of the present state.

        A vehicle that keeps its lane points along it.  Taken from its lateral rates, a wrong
        heading would foreshorten the front, feign another range and so feed on itself.
        """
        rates = lateral_rates(self._times(), self.state[:, 1])
        stretch = self.sampler.front.stretch(self.state[:, :3])
        return rates, stretch, self.changing_lanes * headings(self.state, rates, stretch)

    def _drift(self) -> tuple[float, float]:
        """Newest lateral rate and heading, for the next look."""
        if len(self.looks) < 2:
            return 0.0, 0.0
        rates, _, heading = self._directions()
        return float(rates[-1]), float(heading[-1])

    def _step(self, solution: Array, effort: _Effort) -> float:
        """Move to the solution and retake the looks that moved most; by how much, px."""
        at = self._layout()
        self.state = np.column_stack([solution[at.poses], solution[at.speeds]])
        self.relief = solution[at.relief]
        rates, _, heading = self._directions()
        changes = self.state[:, :3] - np.stack([look.pose for look in self.looks])
        right_m = self.state[:, 3] * [
            lag_s(pair, self.config.trigger_tolerance_s) for pair in self.pairs]
        px = np.array([
            max(np.abs(look.shift_px * change).max(),
                look.shift_px[:, 0].max() * (_HALF_WIDTH_M * abs(psi - look.heading_rad)
                                             + np.abs(self.relief - look.relief).max()
                                             + abs(later - look.right_m)))
            for look, change, psi, later in zip(self.looks, changes, heading, right_m)])
        moved_px = 0.0
        count = max(effort.retakes, int(np.sum(px > _FAR_PX)))
        for k in np.argsort(-px, kind='stable')[:count]:
            if px[k] > effort.moved_px:
                change = changes[k] * min(1.0, _MAX_MOVE_PX / px[k])
                again = self.sampler.look(
                    self.pairs[k], self.looks[k].pose + change,
                    np.array([self.state[k, 3], rates[k], 0.0]), float(heading[k]),
                    self.relief)
                if again is not None:
                    self.looks[k], moved_px = again, max(moved_px, float(px[k]))
        return moved_px


def _crowded(pairs: list[StereoPair]) -> int:
    """Index of the pair, not the first or the last, whose going leaves the least gap."""
    times = np.array([pair.stamp_ns for pair in pairs])
    return 1 + int(np.argmin(times[2:] - times[:-2]))


def _given_tilt(covariance: Array, at: Layout) -> Array:
    """Covariance (n, n) of the speeds, were the path's heading known."""
    shared = covariance[np.ix_(at.speeds, at.tilt)]
    tilt = covariance[np.ix_(at.tilt, at.tilt)]
    return covariance[np.ix_(at.speeds, at.speeds)] - shared @ np.linalg.solve(tilt, shared.T)
