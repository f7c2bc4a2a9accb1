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
import math
from typing import Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .band_agreement import all_but_one, error_scale, PartSpeed
from .blur_doubt import doubt_of_blur
from .clock_step import clock_was_set, ClockWatch
from .hypotheses import Hypothesis, of_kin
from .keyframes import Keyframe, least_gap, Window
from .motion_prior import (
    headings, Indices, lateral_rates, PassMotion, PassMotions, StateIndex)
from .observation import Observation, ObservationSampler
from .photometry import views_agree
from .posterior import Posterior, SolvedPass
from .relief import node_weights
from .sharpness import blur_log_likelihoods, likeliest_blurs, trial_blurs_px, trial_gammas
from .solution import NEGLIGIBLE, Solution, Solver
from ..core.records import Array, StereoPair
from ..core.stamp_watch import Gap
from ..core.tracker_config import TrackerConfig

_FAR_PX = 0.5  # iterations go on while observations move further than this
_MOST_JUDGEMENTS = 3  # rounds, at most, of deciding which observations are occluded
_MAX_MOVE_PX = 3.0  # limit of a step, the linear range of a patch
_HALF_WIDTH_M = 0.8  # lever by which a change of heading moves the edges of a front
_ANYWHERE_M = 10.0  # 1-sigma of the first place where only the images are to determine it
_FEWEST_KEYFRAMES = 4  # least number for a pass, that of the shortest measured one
_BLUR_PAIRS = 4  # first pairs that decide which view is sharper, as many as the shortest pass has


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


class PhotometricWindow:
    """
    Grows with every pair of a pass; see the module's docstring.

    :param sampler: makes observations of the front.
    :param motions: priors of the pass.
    :param config: precision of the images, motion models, effort.
    """

    def __init__(self, sampler: ObservationSampler, motions: PassMotions, config: TrackerConfig
                 ) -> None:
        self.sampler, self.motions, self.config = sampler, motions, config
        self.gaps: Sequence[Gap] = ()  # of the stream, where the clock may have been set forward
        self._solver = Solver(sampler.relief_basis, config)
        self.clock = ClockWatch(self._solver)
        nodes = sampler.relief_basis.shape[1]
        self._window = Window((), np.zeros((0, 4)), np.zeros(nodes), np.ones(nodes))
        self._agreement: Array = np.zeros(0)  # left-right NCCs of the last solution
        # log-likelihoods of the trial exponents and blurs, one array for each of the first pairs
        self._blurs: list[Array] = []

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
            self._grown(Keyframe(pair, observation), guess), _REACQUIRED if reacquires else _LIVE)
        if posterior.unoccluded[-1]:
            window, posterior = self._with_equal_sharpness(window, posterior)
            self._window, self._agreement = window, posterior.cross_ncc
            posterior = self._begun_where_shown() or posterior
            self.clock.judge(self._window, self.motions.assumed, self.gaps)
        return posterior

    def doubt_stamps(self, stamp_std_s: float) -> None:
        """
        Assume another 1-sigma of all stamps, s, from now on.

        The solution of the whole pass ignores it if the images confirm the stamps.
        """
        self.motions = self.motions.doubting(stamp_std_s)

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
        self._window = self._grown(Keyframe(pair, observation), guess)
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

    def _grown(self, keyframe: Keyframe, state: Array) -> Window:
        """Return the window with a new keyframe and its state (4,)."""
        n, effort = len(self._window.keyframes), self.config.effort
        window = self._window.inserted(n, keyframe, state)
        if n + 1 <= effort.live_observations:
            return window
        # Never deactivate the first keyframe or one of the newest two.
        return window.deactivated(least_gap(window.pairs[:-1]),
                                  effort.pass_observations - effort.live_observations)

    def _judge_sharpness(self, pair: StereoPair, state: Array) -> None:
        """
        Add a pair's evidence of which view is sharper, and make the sampler blur accordingly.

        Arguments are those of :meth:`add`.
        """
        noise = self.config.noise
        seen = self.sampler.blurred_patches(
            pair, state[:3], np.array([state[3], 0.0, 0.0]), trial_blurs_px(noise),
            trial_gammas(noise))
        if seen is None:
            return
        if not self._blurs:
            self.sampler.blurred_at_px = seen[1]
        self._blurs.append(blur_log_likelihoods(*seen, noise))
        self.sampler.blur_gamma, self.sampler.blur_px = likeliest_blurs(
            np.sum(self._blurs, axis=0), noise)

    def _with_equal_sharpness(self, window: Window, posterior: Posterior
                              ) -> tuple[Window, Posterior]:
        """
        Return the solution with equally sharp views, by the evidence of its newest pair too.

        Only the first pairs are used for this.  Where the blur does not change, neither does the
        solution.
        """
        if not self._blurs or len(self._blurs) >= _BLUR_PAIRS or len(window.keyframes) < 2:
            return window, posterior
        before = self.sampler.blur_px, self.sampler.blur_gamma
        self._judge_sharpness(window.pairs[-1], window.states[-1])
        same = (self.sampler.blur_px, self.sampler.blur_gamma) == before
        remade = None if same else self._remade(window)
        if remade is not None and len(remade.keyframes) == len(window.keyframes):
            sharp_window, sharp_posterior = self._refined(remade, _REACQUIRED)
            if sharp_posterior.unoccluded[-1]:
                return sharp_window, sharp_posterior
        self.sampler.blur_px, self.sampler.blur_gamma = before
        return window, posterior

    def solve_pass(self) -> SolvedPass:
        """Return the pass solved from all keyframes, including inactive ones."""
        return self._solved(self._recalled(self._window))

    def _solved(self, window: Window) -> SolvedPass:
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
        window = replace(window, occluded_ns=occluded_ns)
        exact = self._solver.solve(window, self._solver.hypotheses, self.motions.exact)
        at = window.index
        states = np.column_stack([at.poses, at.speeds]).ravel()
        matching = _given_heading(exact.covariance, at, states)
        added = (self._band_scale(window, exact, matching[3::4, 3::4]) - 1) * matching \
            + self._doubt_of_blur(window, posterior)
        return SolvedPass(
            replace(posterior, covariance=posterior.covariance + added), occluded_ns,
            exact.covariance[np.ix_(at.speeds, at.speeds)] + added[3::4, 3::4],
            (matching + added)[3::4, 3::4],
            clock_was_set(window, self._solver, self.motions.assumed, self.gaps),
            math.hypot(self.config.noise.match_floor_px, window.more_px))

    def _band_scale(self, window: Window, exact: Solution, covariance: Array) -> float:
        """
        Return the factor on the covariance of matching, by how well bands of the front agree.

        :param exact: the solution of the pass for exact stamps.
        :param covariance: (n, n) that of its speeds if the path's heading were known.
        """
        share = self.config.noise.band_share
        if not share:
            return 1.0
        likely = [h for h, w in zip(self._solver.hypotheses, exact.weights) if w > NEGLIGIBLE]
        try:
            speeds = [self._speed_of_part(which, window, likely)
                      for which in all_but_one(self.sampler.grid_shape)]
        except np.linalg.LinAlgError:
            return 1.0  # a pass that is solved must not be lost for this
        return error_scale(float(covariance.mean()), speeds, share)

    def _speed_of_part(self, which: NDArray[np.bool_], window: Window,
                       hypotheses: Sequence[Hypothesis]) -> PartSpeed:
        """
        Return the mean speed of a pass by a part of the front, to first order.

        :param which: (G,) samples of the part.
        """
        part = replace(window, keyframes=tuple(
            Keyframe(k.pair, k.observation.part(which)) for k in window.keyframes))
        solution = Solver(self.sampler.relief_basis[which], self.config).solve(
            part, hypotheses, self.motions.exact)
        at = window.index
        return PartSpeed(
            float(solution.mean[at.speeds].mean()),
            float(_given_heading(solution.covariance, at, at.speeds).mean()))

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
        self.motions = begun.motions
        self._window, self._agreement = shown, posterior.cross_ncc
        return posterior

    def _begun_at(self, window: Window, k: int) -> PhotometricWindow:
        """
        Return a window for a pass whose first ``k`` pairs do not show the whole front.

        Its prior does not use the place and centre found in the first pair: something hid part of
        the front there, so they may be a metre off, which would count as speed.
        """
        s_m, *offset_m = window.states[k, :3]
        prior = replace(self.motions.prior, s_m=float(s_m), s_std_m=_ANYWHERE_M,
                        offset_m=np.array(offset_m))
        begun = PhotometricWindow(self.sampler, self.motions.begun_at(prior), self.config)
        begun.gaps = self.gaps
        return begun

    def _doubt_of_blur(self, window: Window, posterior: Posterior) -> Array:
        """Return the covariance (4 n, 4 n) to add to a pass for making views equally sharp."""
        share = self.config.noise.blur_doubt
        samplers = self.sampler.less_blurred() if share else []
        return doubt_of_blur(posterior, [self._solved_with(sampler, window)
                                         for sampler in samplers],
                             share, self.motions.prior.speed_std_mps)

    def _solved_with(self, sampler: ObservationSampler, window: Window) -> Optional[Posterior]:
        """Return the pass solved with another sampler; None where it cannot be solved."""
        resampled = PhotometricWindow(sampler, self.motions, self.config)
        remade = resampled._remade(window)
        if remade is None or not remade.counts().any():
            return None
        try:
            return resampled._refined(remade, _WHOLE_PASS)[1]
        except np.linalg.LinAlgError:
            return None

    def _remade(self, window: Window) -> Optional[Window]:
        """
        Return a window with its observations remade at their poses; those not in view are dropped.

        Returns None if that is the first one, to which the prior refers.
        """
        rates, _, heading = self._directions(window)
        observations = [self.sampler.observe(
            k.pair, k.observation.pose, np.array([state[3], rate, 0.0]), float(psi), window.relief)
            for k, state, rate, psi in zip(window.keyframes, window.states, rates, heading)]
        return None if observations[0] is None else replace(
            window, states=window.states[[o is not None for o in observations]], keyframes=tuple(
                Keyframe(k.pair, o) for k, o in zip(window.keyframes, observations)
                if o is not None))

    def _recalled(self, window: Window) -> Window:
        """Return a window with inactive pairs active again, at states interpolated in time."""
        times_s, states, first_ns = window.times_s, window.states.T, window.pairs[0].stamp_ns
        for pair in window.inactive:
            at_s = (pair.stamp_ns - first_ns) * 1e-9
            guess = np.array([np.interp(at_s, times_s, column) for column in states])
            observation = self.sampler.observe(
                pair, guess[:3], np.array([guess[3], 0.0, 0.0]), 0.0, window.relief)
            if observation is not None:
                k = int(np.searchsorted([p.stamp_ns for p in window.pairs], pair.stamp_ns))
                window = window.inserted(k, Keyframe(pair, observation), guess)
        return replace(window, inactive=())

    def _refined(self, window: Window, effort: _Effort) -> tuple[Window, Posterior]:
        """Return the refined window and its posterior; see :meth:`_gauss_newton`."""
        window, solution = self._gauss_newton(window, effort, self.motions.assumed)
        if effort is _WHOLE_PASS:
            nominal = self._confirming_stamps(window)
            if nominal is not None:
                window, solution = self._gauss_newton(
                    window, effort, self.motions.nominal, nominal)
        window = window.judged(solution.photometry.unoccluded)
        return window, self._posterior(window, solution, effort)

    def _confirming_stamps(self, window: Window) -> Optional[Solution]:
        """
        Return the solution with nominal stamps where the images confirm doubted ones; else None.

        Stamps are doubted because they are uneven, but exposures may be uneven too.  With the
        stamps of the exposures a vehicle moves smoothly, to some centimetres; with wrong ones it
        jerks.  Only a whole pass can tell: a live reading depends on its newest stamp, which only
        later pairs can confirm.
        """
        motions = self.motions
        if motions.nominal.processes.stamp_std_s >= motions.assumed.processes.stamp_std_s:
            return None
        nominal, assumed = (self._solver.solve(window, self._solver.hypotheses, motion)
                            for motion in (motions.nominal, motions.assumed))
        odds = self.config.exposure_odds
        confirmed = odds == 0 or nominal.log_evidence - assumed.log_evidence > math.log(odds)
        return nominal if confirmed else None

    def _gauss_newton(self, window: Window, effort: _Effort, motion: PassMotion,
                      first: Optional[Solution] = None) -> tuple[Window, Solution]:
        """
        Iterate Gauss-Newton; observations are remade only where their pose has moved.

        :param first: the solution of the window itself, if it is known already.
        """
        hypotheses: Sequence[Hypothesis] = self._solver.hypotheses
        solution = self._solver.solve(window, hypotheses, motion) if first is None else first
        for done in range(1, effort.most + 1):
            if done > 1:
                solution = self._solver.solve(window, hypotheses, motion)
            weights = solution.weights
            window = replace(
                window, changing_lanes=float(sum(
                    w for h, w in zip(hypotheses, weights) if h.motion.changes_lanes)),
                more_px=math.sqrt(sum(w * h.more_px ** 2 for h, w in zip(hypotheses, weights))))
            hypotheses = [h for h, w in zip(hypotheses, of_kin(hypotheses, weights))
                          if w > NEGLIGIBLE]
            window, moved_px = self._moved(window, solution, effort)
            if moved_px <= (effort.near_px if done < effort.iterations else _FAR_PX):
                break
            # Further iterations do not help if the front is occluded where it is.
            if effort is _REACQUIRED and moved_px <= _FAR_PX \
                    and not solution.photometry.unoccluded[-1]:
                break
        return window, solution

    def _posterior(self, window: Window, solution: Solution, effort: _Effort) -> Posterior:
        """Return the posterior of a solution, ordered by pairs."""
        at, photometry = window.index, solution.photometry
        order = np.column_stack([at.poses, at.speeds]).ravel()
        rates, path_scale, heading = self._directions(window)
        return Posterior(
            window.pairs[0].stamp_ns, window.times_s, window.states.copy(),
            solution.covariance[np.ix_(order, order)], rates, heading, path_scale,
            photometry.cross_ncc, photometry.unoccluded, photometry.seen,
            solution.speed_rate_std,
            None if effort is _WHOLE_PASS else solution.unnoticed())

    def _directions(self, window: Window) -> tuple[Array, Array, Array]:
        """
        Return the lateral rates, path scales and headings (n,) of the present state.

        Headings are scaled by the probability of a lane change, as a vehicle that keeps its lane
        points along it.  From lateral rates alone, a wrong heading would foreshorten the front,
        which looks like another range, and so reinforce itself.
        """
        rates = lateral_rates(window.times_s, window.states[:, 1])
        path_scale = self.sampler.front.path_scale(window.states[:, :3])
        return rates, path_scale, window.changing_lanes * headings(
            window.states, rates, path_scale)

    def _newest_drift(self) -> tuple[float, float]:
        """Return the newest lateral rate, m/s, and heading, rad, for the next observation."""
        if len(self._window.keyframes) < 2:
            return 0.0, 0.0
        rates, _, heading = self._directions(self._window)
        return float(rates[-1]), float(heading[-1])

    def _moved(self, window: Window, solution: Solution, effort: _Effort
               ) -> tuple[Window, float]:
        """Return the window at a solution, and how far the remade observations have moved, px."""
        window = self._at(window, solution)
        rates, _, heading = self._directions(window)
        shifts_px = _shifts_px(window, rates, heading)
        keyframes, moved_px = list(window.keyframes), 0.0
        for k in np.flatnonzero(shifts_px > effort.moved_px):
            old, state = keyframes[k], window.states[k]
            change = (state[:3] - old.observation.pose) * min(1.0, _MAX_MOVE_PX / shifts_px[k])
            remade = self.sampler.observe(
                old.pair, old.observation.pose + change,
                np.array([state[3], rates[k], 0.0]), float(heading[k]), window.relief)
            if remade is not None:
                keyframes[k] = Keyframe(old.pair, remade)
                moved_px = max(moved_px, float(shifts_px[k]))
        return replace(window, keyframes=tuple(keyframes)), moved_px

    def _at(self, window: Window, solution: Solution) -> Window:
        """Return the window with the states and the relief of a solution."""
        at, noise = window.index, self.config.noise
        return replace(
            window, states=np.column_stack([solution.mean[at.poses], solution.mean[at.speeds]]),
            relief=solution.relief, relief_weights=node_weights(
                solution.relief_square, noise.relief_std_m, noise.relief_dof))


def _shifts_px(window: Window, rates: Array, heading: Array) -> Array:
    """
    Return how far the samples of each observation (n,) are from where the window has them, px.

    :param rates: (n,) lateral rates of the window, m/s.
    :param heading: (n,) headings of the window, rad.
    """
    observations, states = window.observations, window.states
    changes = states[:, :3] - np.array([o.pose for o in observations])
    turned = np.abs(heading - [o.heading_rad for o in observations])
    # The r.m.s., because most samples have not moved where only some nodes have.
    reshaped = np.sqrt(np.square(
        window.relief - np.array([o.relief for o in observations])).mean(axis=1))
    # Change of the distance that the front moves between exposures, along and across.
    between_m = np.abs([pair.right_lag_s for pair in window.pairs] * (
        np.stack([states[:, 3], rates])
        - np.transpose([o.velocity_mps[:2] for o in observations])))
    per_m = np.array([o.shift_px for o in observations])  # (n, 2, 3)
    return np.asarray(np.maximum(
        np.abs(per_m * changes[:, None]).max(axis=(1, 2)),
        per_m[..., 0].max(axis=1) * (_HALF_WIDTH_M * turned + reshaped + between_m[0])
        + per_m[:, 1, 1] * between_m[1]))


def _given_heading(covariance: Array, at: StateIndex, which: Indices) -> Array:
    """Return the covariance (k, k) of some unknowns (k,) if the path's heading were known."""
    shared = covariance[np.ix_(which, at.heading_error)]
    error = covariance[np.ix_(at.heading_error, at.heading_error)]
    return np.asarray(covariance[np.ix_(which, which)]
                      - shared @ np.linalg.solve(error, shared.T))
