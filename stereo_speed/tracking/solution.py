# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
One linear solution of a pass: all hypotheses solved at the present observations, and weighed.

The evidence of each hypothesis has a closed Gaussian form.  The answer is the moments of the
mixture, so that allowing for braking neither makes a steady pass noisy nor biases a braking one.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
import math
from typing import Callable, Iterable, Mapping, Sequence

import numpy as np

from .hypotheses import (
    hypotheses_of, Hypothesis, log_unchanged, PassOnsets, with_onset_to_come)
from .keyframes import Window
from .motion_answers import answers
from .motion_prior import PassMotion, rates_by_offsets
from .onset import Moments, Unnoticed
from .photometry import PassPhotometry, Photometry
from .pose_equations import PoseEquations, without_relief
from ..core.records import Array
from ..core.right_of_way import give_way
from ..core.tracker_config import TrackerConfig
from ..estimation.weights import normalise_log_weights

NEGLIGIBLE = 1e-4  # weight below which a hypothesis is left out in this pair
_LIKELY = 0.01  # least weight of a hypothesis that unnoticed braking must be covered for
# 1-sigma of how far a right view may be off its epipolar line, more than any calibration error, so
# that this does not influence the speed (`steadying.view_lag` finds the lag from it).
_ACROSS_PX = 3.0


@dataclass(frozen=True, eq=False)
class Solution:
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


class Solver:
    """
    Solves for poses, speeds, accelerations and heading error at the present observations.

    :param relief_basis: (G, m) share of each node of the relief at each sample of the front.
    :param config: precision of the images, motion models.
    """

    def __init__(self, relief_basis: Array, config: TrackerConfig) -> None:
        self.config, self.hypotheses = config, hypotheses_of(config)
        self._photometry = PassPhotometry(relief_basis, config.noise, config.visibility)

    def solve(self, window: Window, hypotheses: Sequence[Hypothesis], motion: PassMotion
              ) -> Solution:
        """
        Return the solution of a window.

        :param hypotheses: those to weigh, some or all of ``self.hypotheses``.
        :param motion: prior of the pass.
        """
        give_way()
        photometry = self._seen(window)
        give_way()
        images = self._for_poses(photometry, window, hypotheses)
        log_prior, times_s = _log_prior(hypotheses, images), window.times_s
        log_evidence = np.array([answer.log_evidence for answer in _answers(
            times_s, window.states, hypotheses, motion, images, covariances=False)])
        log_evidence += log_unchanged(self.config, hypotheses, times_s)
        counting = np.flatnonzero(
            with_onset_to_come(hypotheses, normalise_log_weights(log_prior + log_evidence))
            > NEGLIGIBLE)
        some = [hypotheses[int(k)] for k in counting]
        with_onsets = PassOnsets(self.config, motion, times_s, window.states, some)
        steady = _answers(times_s, window.states, some, motion, images, covariances=True)
        moments = [with_onsets(answer, h) for h, answer in zip(some, steady)]
        log_evidence[counting] = [answer.log_evidence for answer in moments]
        weights = normalise_log_weights(log_prior + log_evidence)
        shares = np.where(weights[counting] > NEGLIGIBLE, weights[counting], 0.0)
        shares /= shares.sum()
        likely = [(float(w), answer) for w, answer in zip(shares, moments) if w > 0]
        relief, relief_square = _relief_moments(
            shares, moments, [images[h.more_px] for h in some])
        return Solution(
            _total(w * answer.mean for w, answer in likely), relief, relief_square, weights,
            float(np.logaddexp.reduce(log_prior + log_evidence)), likely, photometry,
            _speed_rate_std(shares, some),
            partial(with_onsets.unnoticed,
                    [answer for answer, w in zip(steady, shares) if w > _LIKELY],
                    [h for h, w in zip(some, shares) if w > _LIKELY],
                    int(window.index.speeds[-1]), self.config.visibility.unnoticed_braking_mps2))

    def log_evidences(self, window: Window, motion: PassMotion, each_s: Sequence[Array]) -> Array:
        """
        Return the logarithms (k,) of the evidence of all hypotheses with other times.

        Onsets of speed changes are left out.

        :param motion: prior of the pass.
        :param each_s: k arrays (n,) of times of the keyframes, to assume instead of their stamps.
        """
        hypotheses = self.hypotheses
        images = self._for_poses(self._seen(window), window, hypotheses)
        log_prior = _log_prior(hypotheses, images)
        log_evidences = [[answer.log_evidence for answer in _answers(
            times_s, window.states, hypotheses, motion, images, covariances=False)]
            for times_s in each_s]
        return np.asarray(np.logaddexp.reduce(log_prior + log_evidences, axis=1))

    def _seen(self, window: Window) -> Photometry:
        """Return the equations of the images of a window."""
        apart = any(pair.right_lag_s for pair in window.pairs)
        return self._photometry(
            window.observations, window.counts(), window.more_px,
            rates_by_offsets(window.times_s) if apart else None)

    def _for_poses(self, photometry: Photometry, window: Window,
                   hypotheses: Sequence[Hypothesis]) -> dict[float, PoseEquations]:
        """
        Return the equations of the images for the poses, by the scatter of the disparities.

        The relief does not depend on the motion model, so it is eliminated once for each scatter.
        """
        held = np.append(window.relief_weights / self.config.noise.relief_std_m ** 2,
                         np.full(photometry.lines, 1 / _ACROSS_PX ** 2))
        scatters_px = {h.more_px: None for h in hypotheses}  # each once, in a fixed order
        return {more_px: without_relief(
            photometry.scattered(more_px), held, len(window.relief)) for more_px in scatters_px}


def _log_prior(hypotheses: Sequence[Hypothesis], images: Mapping[float, PoseEquations]) -> Array:
    """Return the logarithms (h,) of hypotheses' shares, times the density of the images."""
    return np.array([math.log(h.share) + images[h.more_px].log_density for h in hypotheses])


def _answers(times_s: Array, states: Array, hypotheses: Sequence[Hypothesis], motion: PassMotion,
             images: Mapping[float, PoseEquations], *, covariances: bool) -> list[Moments]:
    """
    Return the answers of hypotheses, in their order, without onsets of speed changes.

    :param times_s: (n,) times of the keyframes, s.
    :param states: (n, 4) states to linearise at.
    :param images: scatter of the disparities to the equations of the images.
    :param covariances: whether to compute covariances; else they are empty.
    """
    scatters_px, equations = list(images), images.values()
    solved = answers(
        motion, times_s, states, [h.motion for h in hypotheses],
        [scatters_px.index(h.more_px) for h in hypotheses], np.array([e.H for e in equations]),
        np.array([e.right for e in equations]), covariances=covariances)
    around = solved.covariances if covariances else np.zeros((len(hypotheses), 0, 0))
    return [Moments(mean, covariance, float(evidence)) for mean, covariance, evidence in zip(
        solved.means, around, solved.log_evidence)]


def _relief_moments(shares: Array, moments: Sequence[Moments],
                    images: Sequence[PoseEquations]) -> tuple[Array, Array]:
    """
    Return the mean (m,) of the relief, m, and its mean square (m,), m^2.

    :param shares: (h,) weights of the hypotheses that count; their sum is 1.
    :param moments: their answers.
    :param images: their equations of the images.
    """
    known = images[0].unknowns
    relief = _total(w * equations.relief(answer.mean[known])
                    for w, answer, equations in zip(shares, moments, images) if w > 0)
    most = int(np.argmax(shares))
    variances = images[most].relief_variances(moments[most].covariance[np.ix_(known, known)])
    return relief, np.square(relief) + variances


def _speed_rate_std(shares: Array, hypotheses: Sequence[Hypothesis]) -> float:
    """Return the random walk of the speed, weighted r.m.s., m/s/sqrt(s)."""
    return math.sqrt(sum(
        float(w) * (h.motion.speed_rate_std or 0.0) ** 2 for w, h in zip(shares, hypotheses)))


def _total(terms: Iterable[Array]) -> Array:
    """Return the sum of arrays."""
    return np.asarray(sum(terms))
