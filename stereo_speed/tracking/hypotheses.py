# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Hypotheses of a pass: motion models, scatters of the disparities, onsets of speed changes.

They are weighed by the evidence of the images.
"""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Optional, Sequence

import numpy as np

from .motion_prior import motion_models, MotionModel, PassMotion, StateIndex, walk_rate
from .onset import changes, Moments, Onsets, Unnoticed, unnoticed, with_onsets
from .photometry import scatters_px
from ..core.records import Array
from ..core.tracker_config import TrackerConfig

# Longest time for which braking may go unnoticed under a cruising hypothesis: at 6 m/s^2 a vehicle
# is then 27 cm behind, several times the position error of one pair.  Longer braking is left to
# the hypotheses whose speed has the largest random walk.
_UNNOTICED_S = 0.3
_NOTICED_S = 1.0  # braking for longer is surely noticed; at 6 m/s^2 a vehicle is then 3 m behind


@dataclass(frozen=True)
class Hypothesis:
    """
    One hypothesis of what happened in a pass.

    :param motion: motion model of the vehicle.
    :param more_px: scatter of the disparities beyond the least one, 1-sigma, px.
    :param share: prior probability.
    :param onsets: factor on the rate of onsets that began more than ``_UNNOTICED_S`` before the
        last pair; 0 for none of them.
    """

    motion: MotionModel
    more_px: float
    share: float
    onsets: float

    @property
    def kin(self) -> tuple[float, bool, float]:
        """Return the properties that hypotheses share which differ only in how speed changes."""
        return self.more_px, self.motion.changes_lanes, self.motion.ride_std_m


def hypotheses_of(config: TrackerConfig) -> list[Hypothesis]:
    """Return all hypotheses that a configuration allows for."""
    models = motion_models(config)
    return [Hypothesis(motion, more_px, motion.share * share, _onset_share(motion, models))
            for more_px, share in scatters_px(config.noise) for motion in models
            if motion.share * share > 0]  # a product of tiny shares is 0 and has no logarithm


def _onset_share(motion: MotionModel, models: Sequence[MotionModel]) -> float:
    """
    Return the factor on the rate of longer onsets under one motion model.

    Braking is less even than cruising.  So a vehicle that has been braking for a while is counted
    to the model with the largest random walk of the speed, which then stands for all models like
    it; the factor of the other models is 0.
    """
    alike = [m for m in models if m.speed_rate_std is not None and (
        m.changes_lanes, m.ride_std_m) == (motion.changes_lanes, motion.ride_std_m)]
    walks = max((walk_rate(m.speed_rate_std or 0.0) for m in alike), default=math.inf)
    if motion.speed_rate_std is None or walk_rate(motion.speed_rate_std) < walks:
        return 0.0
    return sum(m.share for m in alike) / motion.share


def with_onset_to_come(hypotheses: Sequence[Hypothesis], weights: Array) -> Array:
    """
    Return the greatest weights that hypotheses may reach once their onsets are included.

    If a vehicle keeps its speed and then brakes, a hypothesis with an onset explains it about as
    well as one whose speed changes all the time; without the onset it does not explain it at all.

    :param weights: weights of the hypotheses without onsets.
    """
    changing = {h.kin: float(w)
                for h, w in zip(hypotheses, weights) if h.motion.speed_rate_std is None}
    return np.array([max(float(w), changing.get(h.kin, 0.0))
                     for h, w in zip(hypotheses, weights)])


def of_kin(hypotheses: Sequence[Hypothesis], weights: Array) -> Array:
    """
    Return for each hypothesis the greatest weight among those that differ only in the speed.

    An observation that is not yet in place looks like braking, but is no evidence for it.
    """
    greatest: dict[tuple[float, bool, float], float] = {}
    for h, weight in zip(hypotheses, weights):
        greatest[h.kin] = max(greatest.get(h.kin, 0.0), float(weight))
    return np.array([greatest[h.kin] for h in hypotheses])


def onsets_of(config: TrackerConfig) -> Optional[Onsets]:
    """Return the statistics of speed changes; None where a configuration leaves them out."""
    if not (config.onset_per_s and config.onset_std_mps2):
        return None
    return Onsets(config.onset_per_s, config.onset_lasts_s, config.onset_std_mps2)


def log_unchanged(config: TrackerConfig, hypotheses: Sequence[Hypothesis], times_s: Array
                  ) -> Array:
    """
    Return the logarithms (k,) of the probability under each hypothesis that no speed changes.

    A vehicle that stands in view for minutes would have been expected to move on. Hypotheses that
    expect so have their evidence multiplied by this; those that are too improbable to be weighed
    with onsets, too, else they outweigh all others in the end.

    :param times_s: (n,) stamps; onsets do not count before the second one.
    """
    onsets, log_none = onsets_of(config), 0.0
    if onsets is not None and len(times_s) > 1:
        log_none = onsets.log_unchanged(float(times_s[-1] - times_s[0]))
    return np.array([0.0 if h.motion.speed_rate_std is None else log_none for h in hypotheses])


class PassOnsets:
    """
    Adds onsets of speed changes to the answers of hypotheses that keep the speed.

    :param config: rate, duration and size of speed changes.
    :param motion: prior of the pass.
    :param times_s: (n,) stamps, s.
    :param state: (n, 4) s, a, b and speed at which the pass is linearised.
    :param hypotheses: all hypotheses that are solved for.
    """

    def __init__(self, config: TrackerConfig, motion: PassMotion, times_s: Array, state: Array,
                 hypotheses: Sequence[Hypothesis]) -> None:
        self.onsets = onsets_of(config)
        self._counted = self.onsets or Onsets(0.0, config.onset_lasts_s, 1.0)
        rates = {walk_rate(h.motion.speed_rate_std) for h in hypotheses
                 if len(times_s) > 1 and h.motion.speed_rate_std is not None}
        self._changes = {rate: changes(times_s, StateIndex(len(times_s)), motion.way_information(
            times_s, state, rate), rate) for rate in rates}

    def __call__(self, answer: Moments, hypothesis: Hypothesis) -> Moments:
        """Return the answer of a hypothesis with onsets included."""
        rate = hypothesis.motion.speed_rate_std
        if self.onsets is None or rate is None or not self._changes:
            return answer
        does = self._changes[walk_rate(rate)]
        if not hypothesis.onsets:
            return with_onsets(answer, does.newest(_UNNOTICED_S), self.onsets)
        return with_onsets(answer, does, self.onsets, np.where(
            does.lasts_s > _UNNOTICED_S, hypothesis.onsets, 1.0))

    def unnoticed(self, answers: Sequence[Moments], hypotheses: Sequence[Hypothesis], newest: int,
                  most_mps2: float) -> Unnoticed:
        """
        Return the possible errors of the newest speed while a change of speed does not show yet.

        :param answers: answers of hypotheses without onsets.
        :param hypotheses: the likely hypotheses; the errors cover each of them.
        :param newest: index of the newest speed.
        :param most_mps2: greatest acceleration, m/s^2.
        """
        return Unnoticed.any_of([unnoticed(
            answer, self._changes[walk_rate(one.motion.speed_rate_std)].newest(_NOTICED_S),
            self._counted, newest, most_mps2) for answer, one in zip(answers, hypotheses)
            if self._changes and one.motion.speed_rate_std is not None], most_mps2)
