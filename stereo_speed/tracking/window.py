# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Photometric refinement of a pass: all observations of a front as one least-squares problem.

A filter that keeps only the newest reference drifts, and one that fixes the depth at the start is
wrong by the error of that start.  Here the poses of all pairs so far, the speeds between them and
the error of the path's heading are unknowns together.  What the images say of them comes from
``photometry``, what is known without images from ``motion_prior``.

Gauss-Newton on this gives the mean and covariance of the newest state, from this pair and
earlier ones only, and at the end of the pass the smoothed profile.  A live reading is solved from
a window of keyframes; older ones become inactive until the pass is solved as a whole.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Iterable, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .motion_prior import (
    headings, lateral_rates, motion_models, MotionModel, PassMotion, PassPrior, StateIndex)
from .observation import Observation, ObservationSampler
from .photometry import PassPhotometry, Photometry
from ..core.config import TrackerConfig
from ..core.records import Array, StereoPair
from ..estimation.gaussian import condition
from ..estimation.weights import normalise_log_weights

_FAR_PX = 0.5  # observations that have moved this far are made again, however many
_MOST_JUDGEMENTS = 3  # rounds, at most, until it is settled which observations are occluded
_MAX_MOVE_PX = 3.0  # a step beyond the patch's linear range is cut
_HALF_WIDTH_M = 0.8  # lever by which a change of heading moves the edges of a front
_NEGLIGIBLE = 1e-4  # weight of a motion model that counts for nothing in this pair


@dataclass(frozen=True)
class _Effort:
    """
    What is spent on an answer.

    :param iterations: usual number of them, and
    :param most: number while poses still move far, as when a change of lanes is noticed.
    :param moved_px: an observation is made again when its pose has moved further than this.
    :param remade: observations made again in one iteration, the most moved first.
    """

    iterations: int
    most: int
    moved_px: float
    remade: int


_LIVE = _Effort(iterations=2, most=4, moved_px=0.10, remade=2)
_REACQUIRED = _Effort(iterations=5, most=8, moved_px=0.05, remade=2)  # from a poor guess
_WHOLE_PASS = _Effort(iterations=8, most=8, moved_px=0.01, remade=1000)


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
    :param path_scale: (n,) metres that the front travels per metre of the path.
    :param cross_ncc: (n,) left-right NCC of each observation.
    :param unoccluded: (n,) whether the observation shows the whole front; others do not count.
    :param seen: (n,) whether it shows the vehicle at all.
    """

    first_ns: int
    stamps_s: Array
    mean: Array
    covariance: Array
    lateral_mps: Array
    heading_rad: Array
    path_scale: Array
    cross_ncc: Array
    unoccluded: NDArray[np.bool_]
    seen: NDArray[np.bool_]

    def at(self, k: int) -> tuple[Array, Array]:
        """Return the mean (4,) and the covariance (4, 4) of pair ``k``."""
        n = range(len(self.mean))[k]
        block = slice(4 * n, 4 * n + 4)
        return self.mean[n], self.covariance[block, block]

    def ground_speeds(self) -> Array:
        """Return the speeds (n,) over ground, m/s."""
        along = self.mean[:, 3] * self.path_scale
        return np.asarray(np.copysign(np.hypot(along, self.lateral_mps), along))

    def ground_ratio(self) -> Array:
        """Return the ground speeds (n,) per speed along the path, which carry over its sigma."""
        along = self.mean[:, 3]
        return np.asarray(self.ground_speeds() / np.where(along == 0, 1.0, along))


@dataclass(frozen=True, eq=False)
class SolvedPass:
    """
    A pass solved from all its keyframes.

    :param posterior: of all of them.
    :param occluded_ns: stamps of those that show the front occluded in part.
    :param exact_stamps: (n, n) covariance of the speeds, were the stamps exact.
    :param exact_path: (n, n) the same, were the path's heading exact as well.
    """

    posterior: Posterior
    occluded_ns: frozenset[int]
    exact_stamps: Array
    exact_path: Array


@dataclass(frozen=True, eq=False)
class _Keyframe:
    """A pair and what the sampler made of it."""

    pair: StereoPair
    observation: Observation


@dataclass(frozen=True, eq=False)
class _Window:
    """
    All that is known of a pass so far.

    :param keyframes: the active ones, in order of stamps.
    :param state: (n, 4) s, a, b and speed in each of them.
    :param relief: (m,) relief of the front at its nodes, m.
    :param inactive: pairs that wait for the end of the pass, in order of stamps.
    :param occluded_ns: stamps of the pairs, active or not, that do not count.
    :param changing_lanes: probability that the vehicle does.
    """

    keyframes: tuple[_Keyframe, ...]
    state: Array
    relief: Array
    inactive: tuple[StereoPair, ...] = ()
    occluded_ns: frozenset[int] = frozenset()
    changing_lanes: float = 0.0

    @property
    def pairs(self) -> list[StereoPair]:
        """Return the active pairs."""
        return [keyframe.pair for keyframe in self.keyframes]

    @property
    def observations(self) -> list[Observation]:
        """Return the active observations."""
        return [keyframe.observation for keyframe in self.keyframes]

    @property
    def times_s(self) -> Array:
        """Return the times (n,) since the first pair, s."""
        first = self.keyframes[0].pair.stamp_ns
        return np.array([(k.pair.stamp_ns - first) * 1e-9 for k in self.keyframes])

    @property
    def index(self) -> StateIndex:
        """Return where the unknowns are."""
        return StateIndex(len(self.keyframes), len(self.relief))

    def counts(self) -> NDArray[np.bool_]:
        """Return which observations (n,) count."""
        return np.array([pair.stamp_ns not in self.occluded_ns for pair in self.pairs])

    def inserted(self, k: int, keyframe: _Keyframe, state: Array) -> _Window:
        """Return the window with a keyframe and its state (4,) before number ``k``."""
        return replace(
            self, keyframes=(*self.keyframes[:k], keyframe, *self.keyframes[k:]),
            state=np.insert(self.state, k, state, axis=0))

    def deactivated(self, k: int, most: int) -> _Window:
        """Return the window with keyframe ``k`` inactive, and at most so many of these."""
        inactive = sorted((*self.inactive, self.keyframes[k].pair), key=lambda p: p.stamp_ns)
        if len(inactive) > most:
            del inactive[_least_gap(inactive)]
        return replace(
            self, keyframes=self.keyframes[:k] + self.keyframes[k + 1:],
            state=np.delete(self.state, k, axis=0), inactive=tuple(inactive))

    def judged(self, unoccluded: NDArray[np.bool_]) -> _Window:
        """Return the window with what counts from now on, if anything would."""
        if not unoccluded.any():
            return self
        elsewhere = self.occluded_ns.difference(pair.stamp_ns for pair in self.pairs)
        return replace(self, occluded_ns=elsewhere.union(
            pair.stamp_ns for pair, counts in zip(self.pairs, unoccluded) if not counts))


@dataclass(frozen=True, eq=False)
class _Solution:
    """Moments of the mixture of the motion models, their weights, and what the images say."""

    mean: Array
    covariance: Array
    weights: Array
    photometry: Photometry


class PhotometricWindow:
    """
    Grows with every pair of a pass; see the module's docstring.

    :param sampler: makes observations of the front.
    :param prior: what is known of the pass before them.
    :param config: precision of the images, models of motion, effort.
    """

    def __init__(self, sampler: ObservationSampler, prior: PassPrior, config: TrackerConfig
                 ) -> None:
        self.sampler, self.config = sampler, config
        self.photometry = PassPhotometry(sampler.relief_basis, config.noise, config.visibility)
        nodes = sampler.relief_basis.shape[1]
        self.motion = PassMotion(prior, config, config.stamp_std_s, nodes)
        self.exact_motion = PassMotion(prior, config, 0.0, nodes)
        self.models = motion_models(config)
        self._window = _Window((), np.zeros((0, 4)), np.zeros(nodes))

    def add(self, pair: StereoPair, guess: Array, *, reacquires: bool = False
            ) -> Optional[Posterior]:
        """
        Take in a pair and refine everything.

        A pair that does not show the whole front leaves no trace in later answers.

        :param guess: (4,) s, a, b, v where the particles say the front is.
        :param reacquires: whether the front was not wholly seen in the pair before.
        :return: None when the front is not wholly in both images at the guess.
        """
        rate, heading = self._newest_drift()
        observation = self.sampler.observe(
            pair, guess[:3], np.array([guess[3], rate, 0.0]), heading, self._window.relief)
        if observation is None:
            return None
        n, effort = len(self._window.keyframes), self.config.effort
        window = self._window.inserted(n, _Keyframe(pair, observation), guess)
        if n + 1 > effort.live_observations:
            # Neither the first nor one of the newest two.
            window = window.deactivated(_least_gap(window.pairs[:-1]),
                                        effort.pass_observations - effort.live_observations)
        window, posterior = self._refined(window, _REACQUIRED if reacquires else _LIVE)
        if posterior.unoccluded[-1]:
            self._window = window
        return posterior

    def solve_pass(self) -> SolvedPass:
        """Return the pass solved from all keyframes, the inactive ones among them."""
        window = self._recalled(self._window)
        for _ in range(_MOST_JUDGEMENTS):
            occluded_ns = window.occluded_ns
            window, posterior = self._refined(window, _WHOLE_PASS)
            if window.occluded_ns == occluded_ns:
                break
        # The observations that this answer rests on, should the judgement not have settled.
        window, at = replace(window, occluded_ns=occluded_ns), window.index
        covariance = self._solve(window, self.models, self.exact_motion).covariance
        return SolvedPass(posterior, occluded_ns, covariance[np.ix_(at.speeds, at.speeds)],
                          _given_heading(covariance, at))

    def _recalled(self, window: _Window) -> _Window:
        """Return a window with the inactive pairs active, where the others say the front was."""
        times, known, first = window.times_s, window.state.T, window.pairs[0].stamp_ns
        for pair in window.inactive:
            at = (pair.stamp_ns - first) * 1e-9
            guess = np.array([np.interp(at, times, column) for column in known])
            observation = self.sampler.observe(
                pair, guess[:3], np.array([guess[3], 0.0, 0.0]), 0.0, window.relief)
            if observation is not None:
                k = int(np.searchsorted([p.stamp_ns for p in window.pairs], pair.stamp_ns))
                window = window.inserted(k, _Keyframe(pair, observation), guess)
        return replace(window, inactive=())

    def _refined(self, window: _Window, effort: _Effort) -> tuple[_Window, Posterior]:
        """Iterate Gauss-Newton; observations are made again only where their pose has moved."""
        models: Sequence[MotionModel] = self.models
        for done in range(1, effort.most + 1):
            solution = self._solve(window, models, self.motion)
            window = replace(window, changing_lanes=float(sum(
                w for m, w in zip(models, solution.weights) if m.changes_lanes)))
            models = [m for m, w in zip(models, solution.weights) if w > _NEGLIGIBLE]
            window, moved_px = self._moved(window, solution.mean, effort)
            if not moved_px or (done >= effort.iterations and moved_px < _FAR_PX):
                break
        window = window.judged(solution.photometry.unoccluded)
        return window, self._posterior(window, solution)

    def _posterior(self, window: _Window, solution: _Solution) -> Posterior:
        """Return the solution in the order of the pairs."""
        at, seen = window.index, solution.photometry
        order = np.column_stack([at.poses, at.speeds]).ravel()
        rates, path_scale, heading = self._directions(window)
        return Posterior(
            window.pairs[0].stamp_ns, window.times_s, window.state.copy(),
            solution.covariance[np.ix_(order, order)], rates, heading, path_scale,
            seen.cross_ncc, seen.unoccluded, seen.seen)

    def _solve(self, window: _Window, models: Sequence[MotionModel], motion: PassMotion
               ) -> _Solution:
        """
        Solve for poses, speeds, accelerations and heading error at the present observations.

        The evidence of the images for each model of motion is Gaussian and closed; the answer is
        the moments of the mixture, so that a steady pass is not made noisy for the sake of a
        braking one, nor a braking one biased.
        """
        seen = self.photometry(window.observations, window.counts())
        answers = [condition(prior, seen.H, seen.right)
                   for prior in motion.equations(window.times_s, window.state, models)]
        weights = normalise_log_weights(np.array(
            [math.log(model.share) + answer.log_evidence
             for model, answer in zip(models, answers)]))
        likely = [(w / weights[weights > _NEGLIGIBLE].sum(), a)
                  for w, a in zip(weights, answers) if w > _NEGLIGIBLE]
        mean = _total(w * a.mean for w, a in likely)
        covariance = _total(w * (a.covariance + np.outer(a.mean - mean, a.mean - mean))
                            for w, a in likely)
        return _Solution(mean, covariance, weights, seen)

    def _directions(self, window: _Window) -> tuple[Array, Array, Array]:
        """
        Return the lateral rates, path scales and headings (n,) of the present state.

        A vehicle that keeps its lane points along it.  Taken from its lateral rates, a wrong
        heading would foreshorten the front, which looks like another range, and so feed on itself.
        """
        rates = lateral_rates(window.times_s, window.state[:, 1])
        path_scale = self.sampler.front.path_scale(window.state[:, :3])
        return rates, path_scale, window.changing_lanes * headings(
            window.state, rates, path_scale)

    def _newest_drift(self) -> tuple[float, float]:
        """Return the newest lateral rate and heading, for the next observation."""
        if len(self._window.keyframes) < 2:
            return 0.0, 0.0
        rates, _, heading = self._directions(self._window)
        return float(rates[-1]), float(heading[-1])

    def _moved(self, window: _Window, solution: Array, effort: _Effort) -> tuple[_Window, float]:
        """Return the window at a solution, and how far the observations made again moved, px."""
        at = window.index
        state = np.column_stack([solution[at.poses], solution[at.speeds]])
        window = replace(window, state=state, relief=solution[at.relief])
        rates, _, heading = self._directions(window)
        changes = state[:, :3] - np.stack([o.pose for o in window.observations])
        right_m = state[:, 3] * [pair.right_lag_s for pair in window.pairs]
        px = np.array([
            max(np.abs(o.shift_px * change).max(),
                o.shift_px[:, 0].max() * (_HALF_WIDTH_M * abs(psi - o.heading_rad)
                                          + np.abs(window.relief - o.relief).max()
                                          + abs(later - o.right_m)))
            for o, change, psi, later in zip(window.observations, changes, heading, right_m)])
        keyframes, moved_px = list(window.keyframes), 0.0
        count = max(effort.remade, int(np.sum(px > _FAR_PX)))
        for k in np.argsort(-px, kind='stable')[:count]:
            if px[k] > effort.moved_px:
                old = keyframes[k]
                change = changes[k] * min(1.0, _MAX_MOVE_PX / px[k])
                remade = self.sampler.observe(
                    old.pair, old.observation.pose + change,
                    np.array([state[k, 3], rates[k], 0.0]), float(heading[k]), window.relief)
                if remade is not None:
                    keyframes[k] = _Keyframe(old.pair, remade)
                    moved_px = max(moved_px, float(px[k]))
        return replace(window, keyframes=tuple(keyframes)), moved_px


def _least_gap(pairs: Sequence[StereoPair]) -> int:
    """Return the index of the pair, not the first or last of many, that leaves the least gap."""
    times = np.array([pair.stamp_ns for pair in pairs])
    return 1 + int(np.argmin(times[2:] - times[:-2])) if len(times) > 2 else len(times) - 1


def _given_heading(covariance: Array, at: StateIndex) -> Array:
    """Return the covariance (n, n) of the speeds, were the path's heading known."""
    shared = covariance[np.ix_(at.speeds, at.heading_error)]
    error = covariance[np.ix_(at.heading_error, at.heading_error)]
    return np.asarray(covariance[np.ix_(at.speeds, at.speeds)]
                      - shared @ np.linalg.solve(error, shared.T))


def _total(terms: Iterable[Array]) -> Array:
    """Return the sum of arrays."""
    return np.asarray(sum(terms))
