# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Photometric refinement of a pass: all observations of a front as one least-squares problem.

A filter that keeps only the newest reference drifts, and one that fixes the depth at the start
keeps the error of that start.  Here the poses and speeds in all pairs so far and the error of the
path's heading are unknowns of one problem.  ``photometry`` gives the equations of the images,
``motion_prior`` those of the prior.

Gauss-Newton iterations give the mean and covariance of the newest state, from this pair and
earlier ones only, and at the end of the pass the smoothed profile.  A live reading is solved from
a window of keyframes; older ones become inactive until the pass is solved as a whole.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
import math
from typing import Callable, Iterable, Mapping, Optional, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from .blur_doubt import doubt_of_blur
from .hypotheses import hypotheses_of, Hypothesis, of_kin, PassOnsets, with_onset_to_come
from .motion_answers import answers
from .motion_prior import (
    headings, Indices, lateral_rates, PassMotion, PassPrior, rates_by_offsets, StateIndex)
from .observation import Observation, ObservationSampler
from .onset import Moments, Unnoticed
from .photometry import Equations, PassPhotometry, Photometry, views_agree
from .posterior import Posterior, SolvedPass
from .relief import node_variances, node_weights
from .sharpness import blur_log_likelihoods, equal_blurs_px, trial_blurs_px
from ..core.records import Array, StereoPair
from ..core.right_of_way import give_way
from ..core.tracker_config import TrackerConfig
from ..estimation.weights import normalise_log_weights

_FAR_PX = 0.5  # iterations go on while observations move further than this
_MOST_JUDGEMENTS = 3  # rounds, at most, of deciding which observations are occluded
_MAX_MOVE_PX = 3.0  # limit of a step, the linear range of a patch
_HALF_WIDTH_M = 0.8  # lever by which a change of heading moves the edges of a front
# 1-sigma of how far a right view may be off its epipolar line, more than any calibration error, so
# that this does not influence the speed (`steadying.view_lag` finds the lag from it).
_ACROSS_PX = 3.0
_ANYWHERE_M = 10.0  # 1-sigma of the first place where only the images are to determine it
_FEWEST_KEYFRAMES = 4  # least number for a pass, that of the shortest measured one
_BLUR_PAIRS = 4  # first pairs that decide which view is sharper, as many as the shortest pass has
_LIKELY = 0.01  # least weight of a hypothesis that unnoticed braking must be covered for
_NEGLIGIBLE = 1e-4  # weight below which a hypothesis is left out in this pair


@dataclass(frozen=True)
class _Effort:
    """
    Computing effort of a solution.

    :param iterations: usual number of iterations.
    :param most: greatest number, while poses still move far, as when a lane change is noticed.
    :param near_px: iterations stop early once observations move by no more than this, as they are
        linear in that range.
    :param moved_px: an observation is remade when its samples have moved further than this, by its
        pose and, in the r.m.s., by the relief.
    """

    iterations: int
    most: int
    near_px: float
    moved_px: float


_LIVE = _Effort(iterations=2, most=4, near_px=0.20, moved_px=0.05)
# The newest observation starts from a poor guess and moves far; the others are solved already.
_REACQUIRED = _Effort(iterations=5, most=8, near_px=0.0, moved_px=0.10)
_WHOLE_PASS = _Effort(iterations=8, most=8, near_px=0.0, moved_px=0.01)


@dataclass(frozen=True, eq=False)
class _Keyframe:
    """A pair and the observation of the front in it."""

    pair: StereoPair
    observation: Observation


@dataclass(frozen=True, eq=False)
class _Window:
    """
    The state of a pass so far.

    :param keyframes: active keyframes, in order of stamps.
    :param state: (n, 4) s, a, b and speed in each of them.
    :param relief: (m,) relief of the front at its nodes, m.
    :param inactive: pairs that wait for the end of the pass, in order of stamps.
    :param occluded_ns: stamps of the pairs, active or not, that do not count.
    :param changing_lanes: probability that the vehicle changes lanes.
    :param more_px: scatter of the disparities beyond the usual one, px.
    :param relief_weights: (m,) factors on the usual information that holds nodes to the plane.
    """

    keyframes: tuple[_Keyframe, ...]
    state: Array
    relief: Array
    relief_weights: Array
    inactive: tuple[StereoPair, ...] = ()
    occluded_ns: frozenset[int] = frozenset()
    changing_lanes: float = 0.0
    more_px: float = 0.0

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
        """Return the indices of the unknowns except the relief."""
        return StateIndex(len(self.keyframes))

    def counts(self) -> NDArray[np.bool_]:
        """Return which observations (n,) count."""
        return np.array([pair.stamp_ns not in self.occluded_ns for pair in self.pairs])

    def inserted(self, k: int, keyframe: _Keyframe, state: Array) -> _Window:
        """Return the window with a keyframe and its state (4,) before number ``k``."""
        return replace(
            self, keyframes=(*self.keyframes[:k], keyframe, *self.keyframes[k:]),
            state=np.insert(self.state, k, state, axis=0))

    def deactivated(self, k: int, most: int) -> _Window:
        """Return the window with keyframe ``k`` inactive, and at most ``most`` inactive ones."""
        inactive = sorted((*self.inactive, self.keyframes[k].pair), key=lambda p: p.stamp_ns)
        if len(inactive) > most:
            del inactive[_least_gap(inactive)]
        return replace(
            self, keyframes=self.keyframes[:k] + self.keyframes[k + 1:],
            state=np.delete(self.state, k, axis=0), inactive=tuple(inactive))

    def since(self, k: int) -> _Window:
        """Return the window, which has no inactive pairs, from keyframe ``k`` on."""
        return replace(self, keyframes=self.keyframes[k:], state=self.state[k:])

    def unshown(self, fewest: int) -> int:
        """Return how many leading keyframes do not count; 0 if fewer than ``fewest`` follow."""
        first = int(np.argmax(self.counts()))
        return first if first <= len(self.keyframes) - fewest else 0

    def judged(self, unoccluded: NDArray[np.bool_]) -> _Window:
        """Return the window with a new choice of what counts, unless that left nothing."""
        if not unoccluded.any():
            return self
        elsewhere = self.occluded_ns.difference(pair.stamp_ns for pair in self.pairs)
        return replace(self, occluded_ns=elsewhere.union(
            pair.stamp_ns for pair, counts in zip(self.pairs, unoccluded) if not counts))


@dataclass(frozen=True, eq=False)
class _Solution:
    """
    Moments of the mixture of the hypotheses, and the equations of the images.

    :param mean: mean of the unknowns except accelerations, in the order of ``StateIndex``.
    :param relief: (m,) mean of the relief, m.
    :param relief_square: (m,) mean square of the relief; variance by the likeliest hypothesis,
        m^2.
    :param weights: weights of all hypotheses.
    :param log_evidence: logarithm of the evidence of all hypotheses together.
    :param likely: weight and answer of each hypothesis that counts.
    :param photometry: equations of the images.
    :param speed_rate_std: random walk of the speed, weighted r.m.s., m/s/sqrt(s).
    :param unnoticed: returns the errors of the newest speed due to braking that does not show yet.
    """

    mean: Array
    relief: Array
    relief_square: Array
    weights: Array
    log_evidence: float
    likely: Sequence[tuple[float, Moments]]
    photometry: Photometry
    speed_rate_std: float
    unnoticed: Callable[[], Unnoticed]

    @cached_property
    def covariance(self) -> Array:
        """Return the covariance of the unknowns of ``mean``."""
        return _total(w * (a.covariance + np.outer(a.mean - self.mean, a.mean - self.mean))
                      for w, a in self.likely)


class PhotometricWindow:
    """
    Grows with every pair of a pass; see the module's docstring.

    :param sampler: makes observations of the front.
    :param prior: prior of the pass.
    :param config: precision of the images, motion models, effort.
    :param nominal_stamp_std_s: 1-sigma of correct stamps, s; that of ``config`` is larger while
        stamps are uneven. None for that of ``config``.
    """

    def __init__(self, sampler: ObservationSampler, prior: PassPrior, config: TrackerConfig,
                 nominal_stamp_std_s: Optional[float] = None) -> None:
        self.sampler, self.config = sampler, config
        self.photometry = PassPhotometry(sampler.relief_basis, config.noise, config.visibility)
        nodes = sampler.relief_basis.shape[1]
        self.motion = PassMotion(prior, config, config.stamp_std_s)
        self.nominal_motion = self.motion if nominal_stamp_std_s is None else PassMotion(
            prior, config, nominal_stamp_std_s)
        self.exact_motion = PassMotion(prior, config, 0.0)
        self.hypotheses = hypotheses_of(config)
        self._window = _Window((), np.zeros((0, 4)), np.zeros(nodes), np.ones(nodes))
        self._agreement: Array = np.zeros(0)  # left-right NCCs of the last solution
        self._blurs: list[Array] = []  # log-likelihoods of the views' blurs, one per first pair

    def add(self, pair: StereoPair, guess: Array, *, reacquires: bool = False
            ) -> Optional[Posterior]:
        """
        Add a pair and refine everything.

        A pair that does not show the whole front does not influence later answers.

        :param guess: (4,) s, a, b, v by the particles.
        :param reacquires: whether the front was not wholly seen in the previous pair.
        :return: None when the front is not wholly in both images at the guess.
        """
        if not self._window.keyframes:
            self._blurs = []
            self._judge_sharpness(pair, guess)
        observation = self._observed(pair, guess)
        if observation is None:
            return None
        window, posterior = self._refined(
            self._grown(_Keyframe(pair, observation), guess), _REACQUIRED if reacquires else _LIVE)
        if posterior.unoccluded[-1]:
            window, posterior = self._as_sharp(window, posterior)
            self._window, self._agreement = window, posterior.cross_ncc
            posterior = self._begun_where_shown() or posterior
        return posterior

    def doubt_stamps(self, stamp_std_s: float) -> None:
        """
        Assume another 1-sigma of all stamps, s, from now on.

        The solution of the whole pass ignores it if the images confirm the stamps.
        """
        self.motion = PassMotion(self.motion.prior, self.config, stamp_std_s)

    def keep(self, pair: StereoPair, guess: Array) -> bool:
        """
        Add a pair that will be solved for together with the next one.

        :param guess: (4,) s, a, b, v predicted from earlier pairs.
        :return: whether it was added: it shows the whole front, and its views agree as well as
            those of the pairs that were solved for.
        """
        observation = self._observed(pair, guess)
        if observation is None or not self._agrees(observation):
            return False
        self._window = self._grown(_Keyframe(pair, observation), guess)
        return True

    def shows(self, pair: StereoPair, guess: Array) -> bool:
        """Return whether a pair shows the whole front at a guess (4,), judged by the views."""
        observation = self._observed(pair, guess)
        return observation is not None and self._agrees(observation)

    def _agrees(self, observation: Observation) -> bool:
        """Return whether the views of an observation agree as well as in the last solution."""
        return views_agree(observation.cross_ncc, self._agreement, self.config.visibility)

    def _observed(self, pair: StereoPair, guess: Array) -> Optional[Observation]:
        """Return the observation at a guess (4,) of s, a, b, v; None if not in both images."""
        rate, heading = self._newest_drift()
        return self.sampler.observe(
            pair, guess[:3], np.array([guess[3], rate, 0.0]), heading, self._window.relief)

    def _grown(self, keyframe: _Keyframe, state: Array) -> _Window:
        """Return the window with a new keyframe and its state (4,)."""
        n, effort = len(self._window.keyframes), self.config.effort
        window = self._window.inserted(n, keyframe, state)
        if n + 1 <= effort.live_observations:
            return window
        # Never deactivate the first keyframe or one of the newest two.
        return window.deactivated(_least_gap(window.pairs[:-1]),
                                  effort.pass_observations - effort.live_observations)

    def _judge_sharpness(self, pair: StereoPair, state: Array) -> None:
        """Add a pair's evidence of which view is sharper; arguments as for :meth:`add`."""
        noise = self.config.noise
        seen = self.sampler.blurred_patches(pair, state[:3], np.array([state[3], 0.0, 0.0]),
                                            trial_blurs_px(noise))
        if seen is None:
            return
        if not self._blurs:
            self.sampler.blurred_at_px = seen[1]
        self._blurs.append(blur_log_likelihoods(*seen, noise))
        self.sampler.blur_px = equal_blurs_px(np.sum(self._blurs, axis=0), noise)

    def _as_sharp(self, window: _Window, posterior: Posterior) -> tuple[_Window, Posterior]:
        """
        Return the solution with equally sharp views, by the evidence of its newest pair too.

        Only the first pairs are used for this.  Where the blur does not change, neither does the
        solution.
        """
        if not self._blurs or len(self._blurs) >= _BLUR_PAIRS or len(window.keyframes) < 2:
            return window, posterior
        before = self.sampler.blur_px
        self._judge_sharpness(window.pairs[-1], window.state[-1])
        seen = None if self.sampler.blur_px == before else self._seen_anew(window)
        if seen is not None and len(seen.keyframes) == len(window.keyframes):
            found = self._refined(seen, _REACQUIRED)
            if found[1].unoccluded[-1]:
                return found
        self.sampler.blur_px = before
        return window, posterior

    def solve_pass(self) -> SolvedPass:
        """Return the pass solved from all keyframes, including inactive ones."""
        return self._solved(self._recalled(self._window))

    def _solved(self, window: _Window) -> SolvedPass:
        """Return the pass solved from all keyframes of a window without inactive ones."""
        for _ in range(_MOST_JUDGEMENTS):
            occluded_ns = window.occluded_ns
            window, posterior = self._refined(window, _WHOLE_PASS)
            if window.occluded_ns == occluded_ns:
                break
        unshown = window.unshown(_FEWEST_KEYFRAMES)
        if unshown:
            return self._begun_at(window, unshown)._solved(window.since(unshown))
        # The choice of observations that this answer rests on, in case it has not converged.
        window, at = replace(window, occluded_ns=occluded_ns), window.index
        covariance = self._solve(window, self.hypotheses, self.exact_motion).covariance
        doubt = self._doubt_of_blur(window, posterior)
        posterior = replace(posterior, covariance=posterior.covariance + doubt)
        of_speeds = doubt[3::4, 3::4]
        return SolvedPass(
            posterior, occluded_ns, covariance[np.ix_(at.speeds, at.speeds)] + of_speeds,
            _given_heading(covariance, at) + of_speeds)

    def _begun_where_shown(self) -> Optional[Posterior]:
        """
        Drop the pairs before the first that shows the whole front; return the new posterior.

        Returns None if there are none, or if the newest pair would no longer count.  Once there
        are inactive pairs, which may show the whole front, this is left to the end of the pass.
        """
        window = self._window
        unshown = window.unshown(self.config.visibility.confirm_pairs)
        if not unshown or window.inactive:
            return None
        begun = self._begun_at(window, unshown)
        shown, posterior = begun._refined(window.since(unshown), _REACQUIRED)
        if not posterior.unoccluded[-1]:
            return None
        self.motion, self.exact_motion = begun.motion, begun.exact_motion
        self.nominal_motion = begun.nominal_motion
        self._window, self._agreement = shown, posterior.cross_ncc
        return posterior

    def _begun_at(self, window: _Window, k: int) -> PhotometricWindow:
        """
        Return a window for a pass whose first ``k`` pairs do not show the whole front.

        Its prior does not use the place and centre found in the first pair: something hid part of
        the front there, so they may be a metre off, which would count as speed.
        """
        s_m, *offset_m = window.state[k, :3]
        prior = replace(self.motion.prior, s_m=float(s_m), s_std_m=_ANYWHERE_M,
                        offset_m=np.array(offset_m))
        other = PhotometricWindow(
            self.sampler, prior, self.config, self.nominal_motion.processes.stamp_std_s)
        other.doubt_stamps(self.motion.processes.stamp_std_s)
        return other

    def _doubt_of_blur(self, window: _Window, posterior: Posterior) -> Array:
        """Return the covariance (4 n, 4 n) to add to a pass for making views equally sharp."""
        share = self.config.noise.blur_doubt
        samplers = self.sampler.less_blurred() if share else []
        return doubt_of_blur(posterior, [self._sampled_by(sampler, window)
                                         for sampler in samplers],
                             share, self.motion.prior.speed_std_mps)

    def _sampled_by(self, sampler: ObservationSampler, window: _Window) -> Optional[Posterior]:
        """Return the pass solved with another sampler; None where it cannot be solved."""
        other = PhotometricWindow(sampler, self.motion.prior, self.config)
        other.motion, other.nominal_motion = self.motion, self.nominal_motion
        seen = other._seen_anew(window)
        if seen is None or not seen.counts().any():
            return None
        try:
            return other._refined(seen, _WHOLE_PASS)[1]
        except np.linalg.LinAlgError:
            return None

    def _seen_anew(self, window: _Window) -> Optional[_Window]:
        """
        Return a window with its observations remade at their poses; those not in view are dropped.

        Returns None if that is the first one, to which the prior refers.
        """
        rates, _, heading = self._directions(window)
        seen = [self.sampler.observe(
            k.pair, k.observation.pose, np.array([state[3], rate, 0.0]), float(psi), window.relief)
            for k, state, rate, psi in zip(window.keyframes, window.state, rates, heading)]
        return None if seen[0] is None else replace(
            window, state=window.state[[o is not None for o in seen]], keyframes=tuple(
                _Keyframe(k.pair, o) for k, o in zip(window.keyframes, seen) if o is not None))

    def _recalled(self, window: _Window) -> _Window:
        """Return a window with inactive pairs active again, at states interpolated in time."""
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
        """Return the refined window and its posterior; see :meth:`_gauss_newton`."""
        window, solution = self._gauss_newton(window, effort, self.motion)
        if effort is _WHOLE_PASS and self._confirms_stamps(window):
            window, solution = self._gauss_newton(window, effort, self.nominal_motion)
        window = window.judged(solution.photometry.unoccluded)
        return window, self._posterior(window, solution, effort)

    def _confirms_stamps(self, window: _Window) -> bool:
        """
        Return whether the images confirm stamps that are doubted because they are uneven.

        Exposures may be uneven too.  With the stamps of the exposures a vehicle moves smoothly, to
        some centimetres; with wrong ones it jerks.  Only a whole pass can tell: a live reading
        depends on its newest stamp, which only later pairs can confirm.
        """
        if self.nominal_motion.processes.stamp_std_s >= self.motion.processes.stamp_std_s:
            return False
        nominal, doubted = (self._solve(window, self.hypotheses, motion).log_evidence
                            for motion in (self.nominal_motion, self.motion))
        odds = self.config.exposure_odds
        return odds == 0 or nominal - doubted > math.log(odds)

    def _gauss_newton(self, window: _Window, effort: _Effort, motion: PassMotion
                      ) -> tuple[_Window, _Solution]:
        """Iterate Gauss-Newton; observations are remade only where their pose has moved."""
        all_: Sequence[Hypothesis] = self.hypotheses
        for done in range(1, effort.most + 1):
            solution = self._solve(window, all_, motion)
            weights = solution.weights
            window = replace(
                window, changing_lanes=float(sum(
                    w for h, w in zip(all_, weights) if h.motion.changes_lanes)),
                more_px=math.sqrt(sum(w * h.more_px ** 2 for h, w in zip(all_, weights))))
            all_ = [h for h, w in zip(all_, of_kin(all_, weights)) if w > _NEGLIGIBLE]
            window, moved_px = self._moved(window, solution, effort)
            if moved_px <= (effort.near_px if done < effort.iterations else _FAR_PX):
                break
            # Further iterations do not help if the front is occluded where it is.
            if effort is _REACQUIRED and moved_px <= _FAR_PX \
                    and not solution.photometry.unoccluded[-1]:
                break
        return window, solution

    def _posterior(self, window: _Window, solution: _Solution, effort: _Effort) -> Posterior:
        """Return the posterior of a solution, ordered by pairs."""
        at, seen = window.index, solution.photometry
        order = np.column_stack([at.poses, at.speeds]).ravel()
        rates, path_scale, heading = self._directions(window)
        return Posterior(
            window.pairs[0].stamp_ns, window.times_s, window.state.copy(),
            solution.covariance[np.ix_(order, order)], rates, heading, path_scale,
            seen.cross_ncc, seen.unoccluded, seen.seen, solution.speed_rate_std,
            None if effort is _WHOLE_PASS else solution.unnoticed())

    def _solve(self, window: _Window, hypotheses: Sequence[Hypothesis], motion: PassMotion
               ) -> _Solution:
        """
        Solve for poses, speeds, accelerations and heading error at the present observations.

        The evidence of each hypothesis has a closed Gaussian form.  The answer is the moments of
        the mixture, so that allowing for braking neither makes a steady pass noisy nor biases a
        braking one.
        """
        give_way()
        apart = any(pair.right_lag_s for pair in window.pairs)
        seen = self.photometry(window.observations, window.counts(), window.more_px,
                               rates_by_offsets(window.times_s) if apart else None)
        give_way()
        # The relief does not depend on the motion model, so it is eliminated once.
        held = np.append(window.relief_weights / self.config.noise.relief_std_m ** 2,
                         np.full(seen.lines, 1 / _ACROSS_PX ** 2))
        said = {more_px: _without_relief(
            seen.scattered(more_px), held, len(window.relief))
                for more_px in {h.more_px: None for h in hypotheses}}
        before = np.array([math.log(h.share) + said[h.more_px].log_density for h in hypotheses])
        evidence = np.array([a.log_evidence for a in self._answers(
            window, hypotheses, motion, said, covariances=False)])
        counts = np.flatnonzero(
            with_onset_to_come(hypotheses, normalise_log_weights(before + evidence))
            > _NEGLIGIBLE)
        some = [hypotheses[int(k)] for k in counts]
        with_onsets = PassOnsets(self.config, motion, window.times_s, window.state, some)
        without = self._answers(window, some, motion, said, covariances=True)
        found = [with_onsets(answer, h) for h, answer in zip(some, without)]
        evidence[counts] = [answer.log_evidence for answer in found]
        weights = normalise_log_weights(before + evidence)
        shares = np.where(weights[counts] > _NEGLIGIBLE, weights[counts], 0.0)
        shares /= shares.sum()
        likely = [(float(w), answer) for w, answer in zip(shares, found) if w > 0]
        mean = _total(w * answer.mean for w, answer in likely)
        told = said[some[0].more_px].unknowns
        relief = _total(w * said[h.more_px].relief(answer.mean[told])
                        for w, h, answer in zip(shares, some, found) if w > 0)
        most = int(np.argmax(shares))
        strays = said[some[most].more_px].relief_variances(
            found[most].covariance[np.ix_(told, told)])
        rate = math.sqrt(sum(
            float(w) * (h.motion.speed_rate_std or 0.0) ** 2 for w, h in zip(shares, some)))
        return _Solution(
            mean, relief, np.square(relief) + strays, weights,
            float(np.logaddexp.reduce(before + evidence)), likely, seen, rate,
            partial(with_onsets.unnoticed, [one for one, w in zip(without, shares) if w > _LIKELY],
                    [one for one, w in zip(some, shares) if w > _LIKELY],
                    int(window.index.speeds[-1]), self.config.visibility.unnoticed_braking_mps2))

    def _answers(self, window: _Window, hypotheses: Sequence[Hypothesis], motion: PassMotion,
                 said: Mapping[float, _PoseEquations], *, covariances: bool) -> list[Moments]:
        """
        Return the answers of hypotheses, in their order.

        :param said: scatter of the disparities to the equations of the images.
        :param covariances: whether to compute covariances; else they are empty.
        """
        levels, all_ = list(said), said.values()
        found = answers(
            motion, window.times_s, window.state, [h.motion for h in hypotheses],
            [levels.index(h.more_px) for h in hypotheses], np.array([one.H for one in all_]),
            np.array([one.right for one in all_]), covariances=covariances)
        around = found.covariances if covariances else np.zeros((len(hypotheses), 0, 0))
        return [Moments(mean, covariance, float(evidence)) for mean, covariance, evidence in zip(
            found.means, around, found.log_evidence)]

    def _directions(self, window: _Window) -> tuple[Array, Array, Array]:
        """
        Return the lateral rates, path scales and headings (n,) of the present state.

        Headings are scaled by the probability of a lane change, as a vehicle that keeps its lane
        points along it.  From lateral rates alone, a wrong heading would foreshorten the front,
        which looks like another range, and so reinforce itself.
        """
        rates = lateral_rates(window.times_s, window.state[:, 1])
        path_scale = self.sampler.front.path_scale(window.state[:, :3])
        return rates, path_scale, window.changing_lanes * headings(
            window.state, rates, path_scale)

    def _newest_drift(self) -> tuple[float, float]:
        """Return the newest lateral rate, m/s, and heading, rad, for the next observation."""
        if len(self._window.keyframes) < 2:
            return 0.0, 0.0
        rates, _, heading = self._directions(self._window)
        return float(rates[-1]), float(heading[-1])

    def _moved(self, window: _Window, solution: _Solution, effort: _Effort
               ) -> tuple[_Window, float]:
        """Return the window at a solution, and how far the remade observations have moved, px."""
        at = window.index
        state = np.column_stack([solution.mean[at.poses], solution.mean[at.speeds]])
        noise = self.config.noise
        window = replace(
            window, state=state, relief=solution.relief, relief_weights=node_weights(
                solution.relief_square, noise.relief_std_m, noise.relief_dof))
        rates, _, heading = self._directions(window)
        seen = window.observations
        changes = state[:, :3] - np.array([o.pose for o in seen])
        turned = np.abs(heading - [o.heading_rad for o in seen])
        # The r.m.s., because most samples have not moved where only some nodes have.
        reshaped = np.sqrt(np.square(
            window.relief - np.array([o.relief for o in seen])).mean(axis=1))
        # Change of the distance that the front moves between exposures, along and across.
        gone_m = np.abs([pair.right_lag_s for pair in window.pairs] * (
            np.stack([state[:, 3], rates]) - np.transpose([o.velocity_mps[:2] for o in seen])))
        per_m = np.array([o.shift_px for o in seen])  # (n, 2, 3)
        px = np.maximum(np.abs(per_m * changes[:, None]).max(axis=(1, 2)),
                        per_m[..., 0].max(axis=1) * (
                            _HALF_WIDTH_M * turned + reshaped + gone_m[0])
                        + per_m[:, 1, 1] * gone_m[1])
        keyframes, moved_px = list(window.keyframes), 0.0
        for k in np.flatnonzero(px > effort.moved_px):
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
    """Return the index of the pair, not the first or last, whose removal leaves the least gap."""
    times = np.array([pair.stamp_ns for pair in pairs])
    return 1 + int(np.argmin(times[2:] - times[:-2])) if len(times) > 2 else len(times) - 1


@dataclass(frozen=True, eq=False)
class _PoseEquations(Equations):
    """
    Equations of the images for the poses alone, and the speeds where views have two stamps.

    The m eliminated unknowns are the nodes of the relief, then how far right views are off their
    epipolar lines.

    :param alone: (m,) eliminated unknowns where the poses are 0.
    :param gain: (m, k) their decrease per unit of the poses.
    :param factor: Cholesky factor of their information (m, m) where the poses are known.
    :param nodes: number of nodes of the relief.
    """

    alone: Array
    gain: Array
    factor: tuple[Array, bool]
    nodes: int

    @property
    def unknowns(self) -> Indices:
        """Return the indices (k,) of the unknowns of these equations."""
        return np.arange(len(self.right))

    def relief(self, poses: Array) -> Array:
        """Return the relief for given poses (k,)."""
        return np.asarray(self.alone - self.gain @ poses)[:self.nodes]

    def relief_variances(self, poses: Array) -> Array:
        """Return the variances of the relief, given the covariance (k, k) of the poses."""
        return node_variances(self.factor, self.gain, poses)[:self.nodes]


def _without_relief(said: Equations, held: Array, nodes: int) -> _PoseEquations:
    """
    Return the equations of the images for the poses alone.

    :param said: their equations for poses, relief and lines of right views.
    :param held: (m,) prior information of each node of the relief, 1/m^2, and of the lines.
    :param nodes: number of nodes of the relief.
    """
    n = len(said.right) - len(held)
    own = said.H[n:, n:] + np.diag(held)
    factor = cho_factor(own, lower=True, check_finite=False)
    gain = cho_solve(factor, said.H[n:, :n], check_finite=False)
    alone = cho_solve(factor, said.right[n:], check_finite=False)
    log_density = said.log_density + 0.5 * float(said.right[n:] @ alone) - float(
        np.log(np.diag(factor[0])).sum())
    return _PoseEquations(
        said.H[:n, :n] - said.H[:n, n:] @ gain, said.right[:n] - said.H[:n, n:] @ alone,
        log_density, alone, gain, factor, nodes)


def _given_heading(covariance: Array, at: StateIndex) -> Array:
    """Return the covariance (n, n) of the speeds if the path's heading were known."""
    shared = covariance[np.ix_(at.speeds, at.heading_error)]
    error = covariance[np.ix_(at.heading_error, at.heading_error)]
    return np.asarray(covariance[np.ix_(at.speeds, at.speeds)]
                      - shared @ np.linalg.solve(error, shared.T))


def _total(terms: Iterable[Array]) -> Array:
    """Return the sum of arrays."""
    return np.asarray(sum(terms))
