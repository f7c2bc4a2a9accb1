# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What may have happened in a pass: ways to drive, scatters of the disparities, onsets.

The images weigh all of it by their evidence.
"""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Sequence

import numpy as np

from .motion_prior import motion_models, MotionModel, PassMotion, StateIndex, walk_rate
from .onset import changes, Moments, Onsets, Unnoticed, unnoticed, with_onsets
from .photometry import scatters_px
from ..core.config import TrackerConfig
from ..core.records import Array

# Who cruises may brake for this long unnoticed: at 6 m/s^2 it is then 27 cm behind, several times
# what a pair tells of a place.  Who brakes for longer is one whose speed walks the most.
_UNNOTICED_S = 0.3
_NOTICED_S = 1.0  # at last: who brakes then is 3 m behind


@dataclass(frozen=True)
class Hypothesis:
    """
    What may have happened in a pass.

    :param motion: how the vehicle drives.
    :param more_px: scatter of the disparities beyond what is usual, px.
    :param share: prior probability.
    :param onsets: share, of its own, of those who have begun to change their speed for a while.
    """

    motion: MotionModel
    more_px: float
    share: float
    onsets: float

    @property
    def kin(self) -> tuple[float, bool, float]:
        """Return what it has in common with those like it but for how the speed walks."""
        return self.more_px, self.motion.changes_lanes, self.motion.ride_std_m


def hypotheses_of(config: TrackerConfig) -> list[Hypothesis]:
    """Return all that may have happened."""
    models = motion_models(config)
    return [Hypothesis(motion, more_px, motion.share * share, _onset_share(motion, models))
            for more_px, share in scatters_px(config.noise) for motion in models
            if motion.share * share > 0]  # a product of tiny shares is 0 and has no logarithm


def _onset_share(motion: MotionModel, models: Sequence[MotionModel]) -> float:
    """
    Return the share of those who have been changing their speed, of those who keep it like this.

    Who brakes does not do so as evenly as who cruises: whoever has for a while is one of those
    whose speed walks the most.
    """
    alike = [m for m in models if m.speed_rate_std is not None and (
        m.changes_lanes, m.ride_std_m) == (motion.changes_lanes, motion.ride_std_m)]
    walks = max((walk_rate(m.speed_rate_std or 0.0) for m in alike), default=math.inf)
    if motion.speed_rate_std is None or walk_rate(motion.speed_rate_std) < walks:
        return 0.0
    return sum(m.share for m in alike) / motion.share


def with_onset_to_come(hypotheses: Sequence[Hypothesis], weights: Array) -> Array:
    """
    Return the greatest weights that hypotheses may have once their onsets are put in.

    A vehicle that keeps its speed until it brakes is explained about as well as one that changes
    its speed all the time, and before its onset is known not at all.

    :param weights: of the hypotheses before that.
    """
    changing = {h.kin: float(w)
                for h, w in zip(hypotheses, weights) if h.motion.speed_rate_std is None}
    return np.array([max(float(w), changing.get(h.kin, 0.0))
                     for h, w in zip(hypotheses, weights)])


def of_kin(hypotheses: Sequence[Hypothesis], weights: Array) -> Array:
    """
    Return the greatest weights of hypotheses and those like them but for how the speed walks.

    An observation that is not yet in place looks like one who brakes, and says nothing of that.
    """
    greatest: dict[tuple[float, bool, float], float] = {}
    for h, weight in zip(hypotheses, weights):
        greatest[h.kin] = max(greatest.get(h.kin, 0.0), float(weight))
    return np.array([greatest[h.kin] for h in hypotheses])


class PassOnsets:
    """
    What vehicles that keep their speed may do to a pass when they begin to change it.

    :param config: how often they do, and how.
    :param motion: prior of the pass.
    :param times_s: (n,) stamps, s.
    :param state: (n, 4) s, a, b and speed where the pass is solved.
    :param hypotheses: all that are asked for.
    """

    def __init__(self, config: TrackerConfig, motion: PassMotion, times_s: Array, state: Array,
                 hypotheses: Sequence[Hypothesis]) -> None:
        self.onsets = Onsets(config.onset_per_s, config.onset_lasts_s, config.onset_std_mps2)
        self._occur = bool(config.onset_per_s and config.onset_std_mps2)
        self._counted = self.onsets if self._occur else Onsets(0.0, config.onset_lasts_s, 1.0)
        rates = {walk_rate(h.motion.speed_rate_std) for h in hypotheses
                 if len(times_s) > 1 and h.motion.speed_rate_std is not None}
        self._changes = {rate: changes(times_s, StateIndex(len(times_s)), motion.way_information(
            times_s, state, rate), rate) for rate in rates}

    def __call__(self, answer: Moments, hypothesis: Hypothesis) -> Moments:
        """Return the answer of a hypothesis with the onsets put in."""
        rate = hypothesis.motion.speed_rate_std
        if not (self._occur and self._changes) or rate is None:
            return answer
        does = self._changes[walk_rate(rate)]
        if not hypothesis.onsets:
            return with_onsets(answer, does.newest(_UNNOTICED_S), self.onsets)
        return with_onsets(answer, does, self.onsets, np.where(
            does.lasts_s > _UNNOTICED_S, hypothesis.onsets, 1.0))

    def unnoticed(self, answers: Sequence[Moments], hypotheses: Sequence[Hypothesis], newest: int,
                  most_mps2: float) -> Unnoticed:
        """
        Return by how much the newest speed may be wrong while a change of it does not show.

        :param answers: those of hypotheses without onsets.
        :param hypotheses: the likely ones: who takes any of them for true is to be right.
        :param newest: index of that speed.
        :param most_mps2: greatest acceleration.
        """
        return Unnoticed.any_of([unnoticed(
            answer, self._changes[walk_rate(one.motion.speed_rate_std)].newest(_NOTICED_S),
            self._counted, newest, most_mps2) for answer, one in zip(answers, hypotheses)
            if self._changes and one.motion.speed_rate_std is not None], most_mps2)
