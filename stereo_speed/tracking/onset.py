# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Vehicles that keep their speed until they brake or accelerate, and then keep it again.

A driver brakes at once, and stops braking at once, and the newest pairs show little of it: in a
tenth of a second at 6 m/s^2 a vehicle falls behind by 3 cm and loses 1.3 mph.  So the speed may
begin to change, and end to, at any pair, and where pairs are rare between them.  The acceleration
meanwhile is one more unknown, constant and eliminated.  It enters nothing but the random walk of
the speeds and the ways between them, so that all onsets follow from the answer without any in
closed form: what one does that ends is what one does that does not, less what one would that
begins then.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Sequence, Union

import numpy as np
from numpy.typing import NDArray

from .motion_prior import StateIndex
from ..core.records import Array
from ..estimation.gaussian import Conditioned

_PART_S = 0.1  # in which times are taken as one: half of it at 6 m/s^2 is less than 1 cm
_PARTS_OF_MOST = np.arange(1, 5) / 4  # less of an acceleration shows later
_MOST_PARTS = 4  # of an interval out of sight: pairs of times, and so the cost, grow as the square


@dataclass(frozen=True, eq=False)
class Moments:
    """
    Moments of a mixture of Gaussians.

    :param mean: of the unknowns.
    :param covariance: of them.
    :param log_evidence: of all its members together.
    """

    mean: Array
    covariance: Array
    log_evidence: float


@dataclass(frozen=True)
class Onsets:
    """
    How vehicles that keep their speed begin to change it.

    :param per_s: how often, 1/s.
    :param lasts_s: mean time for which they do, s.
    :param std_mps2: 1-sigma of the acceleration meanwhile.
    """

    per_s: float
    lasts_s: float
    std_mps2: float


@dataclass(frozen=True, eq=False)
class Changes:
    """
    What accelerations of 1 m/s^2 do that begin at one of m times and do not end.

    The times are those of the pairs and some between them, and the last, which counts for one that
    has not ended yet.

    :param pull: (m, k) on all unknowns, of the walk of the speeds and the ways between them.
    :param own: (m, m) information of them, and of each with each.
    :param lasts_s: (m,) until the last pair.
    :param gaps_s: (m,) time that each stands for.
    :param none: (m, m) where one would end before it begins.
    :param long_s: from the first pair to the last.
    """

    pull: Array
    own: Array
    lasts_s: Array
    gaps_s: Array
    none: NDArray[np.bool_]
    long_s: float

    def newest(self, seconds: float) -> Changes:
        """Return those that began no longer ago."""
        few = slice(int(np.argmax(self.lasts_s <= seconds)), None)
        return replace(self, pull=self.pull[few], own=self.own[few, few],
                       lasts_s=self.lasts_s[few], gaps_s=self.gaps_s[few],
                       none=self.none[few, few])


def changes(times_s: Array, at: StateIndex, ways: Array, rate: float) -> Changes:
    """
    Return what accelerations do to the unknowns of a pass.

    :param times_s: (n,) stamps, s.
    :param at: where the unknowns are.
    :param ways: (n - 1, n - 1) information of the ways from pair to pair, given the speeds, 1/m^2.
    :param rate: random walk of the speed, m/s/sqrt(s).
    """
    gained_s, behind_s2, between_s = _gained(times_s)
    gaps_s = np.diff(times_s)
    walk, held = gained_s / (rate ** 2 * gaps_s), behind_s2 @ ways
    pull = np.zeros((len(walk), at.steady))
    s, v, mean_s = at.poses[:, 0], at.speeds, 0.5 * gaps_s
    pull[:, v[1:]] += walk - mean_s * held
    pull[:, v[:-1]] -= walk + mean_s * held
    pull[:, s[1:]] += held
    pull[:, s[:-1]] -= held
    return Changes(pull, walk @ gained_s.T + held @ behind_s2.T, gained_s.sum(axis=1), between_s,
                   np.tri(len(walk), dtype=bool), float(times_s[-1] - times_s[0]))


def _gained(times_s: Array) -> tuple[Array, Array, Array]:
    """
    Return what an acceleration of 1 m/s^2 that begins at each of m times adds in each interval.

    :return: (m, n - 1) speed, s; (m, n - 1) by how much the way exceeds that of the mean of the
        speeds at its ends, s^2; (m,) time that each stands for, s.
    """
    gaps_s = np.diff(times_s)
    parts = np.clip(np.rint(gaps_s / _PART_S), 1, _MOST_PARTS).astype(int)
    interval = np.repeat(np.arange(len(gaps_s)), parts)
    rows = np.arange(len(interval))
    gone = (rows - np.repeat(np.cumsum(parts) - parts, parts)) / parts[interval]  # share of it
    own_s = gaps_s[interval]
    gained_s, behind_s2 = np.zeros((2, len(rows) + 1, len(gaps_s)))
    gained_s[:-1] = np.where(np.arange(len(gaps_s)) > interval[:, None], gaps_s, 0.0)
    gained_s[rows, interval] = (1 - gone) * own_s
    behind_s2[rows, interval] = -0.5 * gone * (1 - gone) * np.square(own_s)
    return gained_s, behind_s2, np.append(own_s / parts[interval], 1.0)


def with_onsets(steady: Union[Conditioned, Moments], may: Changes, onsets: Onsets,
                rate_factor: Union[float, Array] = 1.0) -> Moments:
    """
    Return what is known when a vehicle may begin to change its speed, and end to.

    :param steady: what is known when it does not: its speed is a Wiener process.
    :param may: what that does.
    :param onsets: how it does.
    :param rate_factor: of how often they do, where others are counted to these; maybe (m,).
    """
    mean, covariance = steady.mean, steady.covariance
    moves = may.pull @ covariance
    told = may.pull @ mean
    # What is known of the walk lessens what it tells, to nothing at most but for rounding.
    tells = np.maximum(_between(may.own - moves @ may.pull.T), 0.0)
    known = tells + 1 / onsets.std_mps2 ** 2
    told = told[:, None] - told
    accelerations = told / known
    begins = np.log(rate_factor * onsets.per_s * may.gaps_s) - may.lasts_s / onsets.lasts_s
    ends = np.log(may.gaps_s / onsets.lasts_s) + may.lasts_s / onsets.lasts_s
    ends[-1] = 0.0  # has not ended yet
    log_share = begins[:, None] + ends - 0.5 * np.log(known * onsets.std_mps2 ** 2) \
        + 0.5 * told * accelerations
    log_share[may.none] = -np.inf
    greatest = max(float(log_share.max()), 0.0)
    shares = np.exp(log_share - greatest)
    total = float(shares.sum()) + math.exp(-greatest)
    weights = shares / total
    push, square = weights * accelerations, weights * (np.square(accelerations) + 1 / known)
    shift = (push.sum(axis=1) - push.sum(axis=0)) @ moves
    spread = np.diag(square.sum(axis=0) + square.sum(axis=1)) - square - square.T
    return Moments(
        mean + shift, covariance + moves.T @ (spread @ moves) - np.outer(shift, shift),
        steady.log_evidence + greatest + math.log(total) - onsets.per_s * may.long_s)


@dataclass(frozen=True, eq=False)
class Unnoticed:
    """
    By how much a speed may be wrong that has begun to change, before it shows.

    :param speed_mps: (k,) error of the newest speed, one for each change that may be, m/s, and
    :param rate_mps2: (k,) by which it grows until more is known, m/s^2.
    """

    speed_mps: Array
    rate_mps2: Array

    def after(self, seconds: float) -> float:
        """Return the greatest error some time after the newest speed, m/s."""
        return float((self.speed_mps + seconds * self.rate_mps2).max())

    @classmethod
    def any_of(cls, several: Sequence[Unnoticed], most_mps2: float) -> Unnoticed:
        """
        Return all that may be wrong by any of several views of it.

        :param most_mps2: greatest acceleration, which may begin with the newest pair whatever
            the view.
        """
        return cls(np.concatenate([[0.0], *(one.speed_mps for one in several)]),
                   np.concatenate([[most_mps2], *(one.rate_mps2 for one in several)]))


def unnoticed(steady: Union[Conditioned, Moments], may: Changes, onsets: Onsets, newest: int,
              most_mps2: float) -> Unnoticed:
    """
    Return what changes of the speed do to what is known of it, as they are noticed by and by.

    Who brakes is told from who keeps the speed by what the pairs have shown since, which at first
    is nothing: the answer of :func:`with_onsets` is that of most drivers.  Here it is asked what
    it would be, but for noise, with each onset there may be.

    :param steady: what is known when there is none.
    :param may: what each does.
    :param onsets: how drivers do; where they never do, nothing is noticed.
    :param newest: index of the newest speed.
    :param most_mps2: greatest acceleration.
    """
    moves = may.pull @ steady.covariance
    shows = may.own - moves @ may.pull.T  # of each, for each that it is taken for
    known = np.maximum(np.diag(shows), 0.0)[:-1] + 1 / onsets.std_mps2 ** 2
    with np.errstate(divide='ignore'):
        before = np.log(onsets.per_s * may.gaps_s[:-1]) - may.lasts_s[:-1] / onsets.lasts_s \
            - 0.5 * np.log(known * onsets.std_mps2 ** 2)
    a = most_mps2 * _PARTS_OF_MOST[:, None, None]
    told = a * shows[:, :-1]
    log_shares = before + 0.5 * np.square(told) / known
    greatest = np.maximum(log_shares.max(axis=-1, initial=0.0, keepdims=True), 0.0)
    shares = np.exp(log_shares - greatest)
    shares /= shares.sum(axis=-1, keepdims=True) + np.exp(-greatest)
    noticed = shares * told / known
    left = a[..., 0] * moves[:, newest] - noticed @ moves[:-1, newest]
    return Unnoticed(np.abs(left).ravel(), np.abs(a[..., 0] - noticed.sum(axis=-1)).ravel())


def _between(products: Array) -> Array:
    """Return the squares (m, m) of differences of vectors whose products (m, m) are known."""
    own = np.diag(products)
    return np.asarray(own[:, None] + own - products - products.T)
