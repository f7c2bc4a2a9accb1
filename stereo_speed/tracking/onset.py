# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Onsets: vehicles that keep their speed, then brake or accelerate, then keep their speed again.

Braking begins and ends abruptly, and the newest pairs show little of it: in a tenth of a second at
6 m/s^2 a vehicle falls behind by 3 cm and loses 1.3 mph.  So a change of speed may begin and end
at any pair and, where pairs are far apart, between pairs.  Its acceleration is one more unknown,
which is constant and eliminated.  It affects only the random walk of the speeds and the distances
between pairs, so the answers for all onsets follow in closed form from the answer without one.
A change may also be under way in the first pair, with the probability that it has at any time.
The effect of a change that ends is that of one which begins at its onset, minus that of one which
begins at its end, both without an end.
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

_PART_S = 0.1  # resolution of onset times; half of it at 6 m/s^2 makes less than 1 cm
_PARTS_OF_MOST = np.arange(1, 5) / 4  # shares of the greatest acceleration; less shows later
_MOST_PARTS = 4  # parts, at most, of an interval without pairs; the cost grows as their square


@dataclass(frozen=True, eq=False)
class Moments:
    """
    Moments of a mixture of Gaussians.

    :param mean: mean of the unknowns.
    :param covariance: covariance of the unknowns.
    :param log_evidence: logarithm of the evidence of all its members together.
    """

    mean: Array
    covariance: Array
    log_evidence: float


@dataclass(frozen=True)
class Onsets:
    """
    Statistics of speed changes of vehicles that keep their speed.

    :param per_s: rate of onsets, 1/s.
    :param lasts_s: mean duration of a change, s.
    :param std_mps2: 1-sigma of the acceleration during it, m/s^2.
    """

    per_s: float
    lasts_s: float
    std_mps2: float

    def expected(self, may: Changes) -> Array:
        """
        Return the probability (m,) of a change since each of the times, relative to that of none.

        Relative to a steady vehicle in the first pair, one whose speed is changing then has the
        probability ``per_s * lasts_s``, as in the long run.  How long it goes on is not part of
        this.
        """
        return self.per_s * (may.gaps_s + np.where(may.earlier, self.lasts_s, 0.0))

    @property
    def fades_per_s(self) -> float:
        """
        Return the rate at which the probability of a change falls as it goes on, relative to none.

        It ends at ``1 / lasts_s``; without it, an onset would have been due at ``per_s``.
        Negative where onsets are more frequent than that.
        """
        return 1 / self.lasts_s - self.per_s

    def log_unchanged(self, long_s: float) -> float:
        """Return the logarithm of the probability that nothing changes within a time, s."""
        return -self.per_s * long_s - math.log1p(self.per_s * self.lasts_s)


@dataclass(frozen=True, eq=False)
class Changes:
    """
    Effects of accelerations of 1 m/s^2 that begin at one of m times and do not end.

    The times are those of the pairs and some between them.  The last one, at the newest pair,
    stands for a change that has not ended yet.  With the effect d of an acceleration on the
    differences of speeds and on the distances, their Jacobian J by the unknowns, and their
    information W:

    :param pull: (m, k) d' W J of each time, for all unknowns.
    :param own: (m, m) d' W d of each two times.
    :param lasts_s: (m,) time from each until the last pair, s.
    :param gaps_s: (m,) time interval that each stands for, s.
    :param earlier: (m,) whether it also stands for all times before it: that of the first pair.
    :param none: (m, m) whether a change would end (column) no later than it begins (row).
    :param long_s: time from the first pair to the last, s.
    """

    pull: Array
    own: Array
    lasts_s: Array
    gaps_s: Array
    earlier: NDArray[np.bool_]
    none: NDArray[np.bool_]
    long_s: float

    def newest(self, seconds: float) -> Changes:
        """Return the changes that began no longer ago than a time, or before the first pair."""
        few = slice(int(np.argmax(self.lasts_s <= seconds)), None)
        return replace(self, pull=self.pull[few], own=self.own[few, few],
                       lasts_s=self.lasts_s[few], gaps_s=self.gaps_s[few],
                       earlier=self.earlier[few], none=self.none[few, few])


def changes(times_s: Array, at: StateIndex, ways: Array, rate: float) -> Changes:
    """
    Return the effects of accelerations on the unknowns of a pass.

    :param times_s: (n,) stamps, s.
    :param at: indices of the unknowns.
    :param ways: (n - 1, n - 1) information of the distances from pair to pair, given the speeds,
        1/m^2.
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
                   np.arange(len(walk)) == 0, np.tri(len(walk), dtype=bool),
                   float(times_s[-1] - times_s[0]))


def _gained(times_s: Array) -> tuple[Array, Array, Array]:
    """
    Return the effect of 1 m/s^2 from each of m times on in each interval between pairs.

    :return: (m, n - 1) speed gained, s; (m, n - 1) distance beyond that of the mean of the speeds
        at both ends, s^2; (m,) time that each of the m times stands for, s.
    """
    gaps_s = np.diff(times_s)
    parts = np.clip(np.rint(gaps_s / _PART_S), 1, _MOST_PARTS).astype(int)
    interval = np.repeat(np.arange(len(gaps_s)), parts)
    rows = np.arange(len(interval))
    # share of the interval that has passed
    gone = (rows - np.repeat(np.cumsum(parts) - parts, parts)) / parts[interval]
    own_s = gaps_s[interval]
    gained_s, behind_s2 = np.zeros((2, len(rows) + 1, len(gaps_s)))
    gained_s[:-1] = np.where(np.arange(len(gaps_s)) > interval[:, None], gaps_s, 0.0)
    gained_s[rows, interval] = (1 - gone) * own_s
    behind_s2[rows, interval] = -0.5 * gone * (1 - gone) * np.square(own_s)
    return gained_s, behind_s2, np.append(own_s / parts[interval], 1.0)


def with_onsets(steady: Union[Conditioned, Moments], may: Changes, onsets: Onsets,
                rate_factor: Union[float, Array] = 1.0) -> Moments:
    """
    Return the answer for a vehicle that may begin, and end, to change its speed.

    It may also be changing it in the first pair, if that is among the times of ``may``.

    :param steady: the answer without changes, where the speed is a Wiener process.
    :param may: effects of changes.
    :param onsets: statistics of changes.
    :param rate_factor: factor on the rate of onsets, above 1 where those of other hypotheses are
        counted here; a number or (m,).
    """
    mean, covariance = steady.mean, steady.covariance
    moves = may.pull @ covariance
    weighted = may.pull @ mean  # information times acceleration, of changes that do not end
    # Uncertain unknowns reduce the information about an acceleration, at most to 0 but for
    # rounding.
    information = np.maximum(_between(may.own - moves @ may.pull.T), 0.0)
    known = information + 1 / onsets.std_mps2 ** 2
    weighted = weighted[:, None] - weighted
    accelerations = weighted / known
    begins = np.log(rate_factor * onsets.expected(may)) - may.lasts_s * onsets.fades_per_s
    ends = np.log(may.gaps_s / onsets.lasts_s) + may.lasts_s * onsets.fades_per_s
    ends[-1] = 0.0  # the change has not ended yet
    log_share = begins[:, None] + ends - 0.5 * np.log(known * onsets.std_mps2 ** 2) \
        + 0.5 * weighted * accelerations
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
        steady.log_evidence + greatest + math.log(total) + onsets.log_unchanged(may.long_s))


@dataclass(frozen=True, eq=False)
class Unnoticed:
    """
    Errors of the newest speed while a change of speed does not show yet.

    :param speed_mps: (k,) error of the newest speed for each possible change, m/s.
    :param rate_mps2: (k,) rate at which it grows until the next pair, m/s^2.
    """

    speed_mps: Array
    rate_mps2: Array

    def after(self, seconds: float) -> float:
        """Return the greatest error a time after the newest speed, m/s."""
        return float((self.speed_mps + seconds * self.rate_mps2).max())

    @classmethod
    def any_of(cls, several: Sequence[Unnoticed], most_mps2: float) -> Unnoticed:
        """
        Return the errors under several hypotheses together.

        :param most_mps2: greatest acceleration, m/s^2, which may begin at the newest pair under
            any hypothesis.
        """
        return cls(np.concatenate([[0.0], *(one.speed_mps for one in several)]),
                   np.concatenate([[most_mps2], *(one.rate_mps2 for one in several)]))


def unnoticed(steady: Union[Conditioned, Moments], may: Changes, onsets: Onsets, newest: int,
              most_mps2: float) -> Unnoticed:
    """
    Return the errors of the newest speed due to changes that are noticed only gradually.

    Pairs distinguish braking from a constant speed only by what they show since its onset, which
    at first is nothing: :func:`with_onsets` then answers as for most drivers.  This function finds
    for each possible onset, without noise, how far off that answer would be.

    :param steady: the answer without changes.
    :param may: effects of changes.
    :param onsets: statistics of changes; with a rate of 0 none is ever noticed.
    :param newest: index of the newest speed.
    :param most_mps2: greatest acceleration, m/s^2.
    """
    moves = may.pull @ steady.covariance
    shows = may.own - moves @ may.pull.T  # evidence of each true onset for each assumed one
    known = np.maximum(np.diag(shows), 0.0)[:-1] + 1 / onsets.std_mps2 ** 2
    with np.errstate(divide='ignore'):
        before = np.log(onsets.expected(may)[:-1]) - may.lasts_s[:-1] * onsets.fades_per_s \
            - 0.5 * np.log(known * onsets.std_mps2 ** 2)
    a = most_mps2 * _PARTS_OF_MOST[:, None, None]
    weighted = a * shows[:, :-1]  # information times acceleration
    log_shares = before + 0.5 * np.square(weighted) / known
    greatest = np.maximum(log_shares.max(axis=-1, initial=0.0, keepdims=True), 0.0)
    shares = np.exp(log_shares - greatest)
    shares /= shares.sum(axis=-1, keepdims=True) + np.exp(-greatest)
    noticed = shares * weighted / known
    left = a[..., 0] * moves[:, newest] - noticed @ moves[:-1, newest]
    return Unnoticed(np.abs(left).ravel(), np.abs(a[..., 0] - noticed.sum(axis=-1)).ravel())


def _between(products: Array) -> Array:
    """Return squared distances (m, m) of vectors from their inner products (m, m)."""
    own = np.diag(products)
    return np.asarray(own[:, None] + own - products - products.T)
