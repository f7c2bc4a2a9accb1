# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Monitors the stamps of a camera for steps of its clock and for deviations from an even pace.

A pace is a constant frame interval.  A step can be found only in a stream that has kept a pace.
"""
from __future__ import annotations

from collections import deque
import math
from typing import NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray

from .records import Array

_PACE = 20  # intervals that must have kept the pace before a step can be found
_JITTER_S = 5e-4  # largest deviation of an interval that keeps the pace
_STEP_S = 3e-3  # smallest deviation that is a step
_MOST_PERIODS = 10  # longest gap, in periods, that the pace is carried over
_GAPS = 256  # gaps that are remembered, more than a pass has
_FEWEST = 5  # fewest intervals that tell how even the stamps are
_FEWEST_ODD = 2  # fewest intervals that can show an odd one, by differing
_NO_PACE = 0.15  # 1-sigma in periods above which there is no pace; uniform remainders give 0.2
_ROUNDED_S = 1e-5  # deviation that counts as none; the rounding of stamps is smaller
_NEW_PACE = 3  # intervals that establish another pace
_STRAYS = 2  # intervals affected by one stray stamp
_SHORT = 8  # at most one interval in so many is shorter than the pace by a stray stamp
_FEWEST_BESIDE = 8  # fewest other intervals that a stray is compared with
_STRAY_SIGMAS = 4.0  # deviation of a stray in sigmas, beyond those of Gaussian intervals
_MAD_SIGMA = 1.4826  # ratio of a Gaussian's 1-sigma to its median absolute deviation


class Gap(NamedTuple):
    """
    An interval of several periods between two stamps: images are missing, or the clock was set.

    :param after_ns: the stamp at its end, ns.
    :param periods: its length in periods, at least 2.
    :param period_s: the period of the stream, s.
    """

    after_ns: int
    periods: int
    period_s: float


class StampWatch:
    """
    Finds steps of the clock and measures how even the stamps are; see the module's docstring.

    A stream with uneven intervals has no pace, so no steps are found in it. Missing images leave
    gaps of whole periods, which are not steps; whether the clock was set forward by a whole number
    of periods is for the images to tell (``tracking.clock_step``). ``steps`` counts the steps,
    ``last_step_s`` is the newest one. ``gaps`` are the latest gaps, ``last_ns`` is the last stamp.
    """

    def __init__(self) -> None:
        self._intervals_s: deque[float] = deque(maxlen=_PACE)
        self._latest_s: deque[float] = deque(maxlen=_PACE)  # undivided intervals, without steps
        self.last_ns: Optional[int] = None
        self.steps, self.last_step_s = 0, 0.0
        self.gaps: deque[Gap] = deque(maxlen=_GAPS)
        self._odd: dict[tuple[float, float, float], float] = {}  # odd_share at the newest stamp

    def add(self, ns: int) -> float:
        """Add the next stamp; return the step of the clock before it, s, 0 for none."""
        last_ns, self.last_ns = self.last_ns, ns
        self._odd.clear()
        if last_ns is None:
            return 0.0
        interval_s = (ns - last_ns) * 1e-9
        pace_s = self._pace_s()
        if pace_s is None:
            self._intervals_s.append(interval_s)
            self._take(interval_s)
            return 0.0
        periods = max(round(interval_s / pace_s), 1)
        off_s = interval_s - periods * pace_s
        if periods > _MOST_PERIODS or abs(off_s) < _STEP_S:
            self._intervals_s.append(interval_s / periods)
            self._take(interval_s)
            if periods > 1:
                self.gaps.append(Gap(ns, periods, pace_s))
            return 0.0
        self.steps, self.last_step_s = self.steps + 1, off_s
        # The pace survives one step; repeated steps use up the intervals and so end the pace.
        self._intervals_s.popleft()
        return off_s

    def take_for_step(self, gap: Gap) -> None:
        """Count a gap as a step of the clock, because no images are missing there."""
        self.gaps.remove(gap)
        self.steps, self.last_step_s = self.steps + 1, (gap.periods - 1) * gap.period_s

    def restart(self) -> None:
        """Forget the last stamp and the gaps, because time has jumped."""
        self.last_ns = None
        self.gaps.clear()

    def unevenness_s(self, most_s: float) -> Optional[float]:
        """
        Return the 1-sigma of the stamps about an even pace, s.

        The error of an interval is that of two stamps with independent errors.  A single stray
        stamp is left out.  A few intervals determine the variance poorly, so its posterior mean
        is used.  Without a pace, as with exposures at arbitrary times, all scatter of the
        intervals counts.

        :param most_s: largest 1-sigma that is normal, s.
        :return: None if the 1-sigma is not above ``most_s``, or there are too few intervals.
        """
        if len(self._latest_s) < _FEWEST:
            return None
        off_s = _off_s(np.array(self._latest_s))
        if len(off_s) < _FEWEST:
            return None
        std_s = _interval_std_s(off_s) / math.sqrt(2.0)
        if not std_s > max(most_s, _ROUNDED_S):
            return None
        freedom = len(off_s) / 1.5  # neighbouring intervals share a stamp
        return std_s * math.sqrt(freedom / (freedom - 2.0))

    def odd_share(self, odd_s: float, most_s: float, least_s: float) -> float:
        """
        Return the relative 1-sigma that odd stamps among the latest add to a speed at the newest.

        A stamp that deviates from an even pace by more than usual may be a single stray or the
        first of many; only later stamps will tell. A speed measured since then is wrong by the
        share of the deviation in the elapsed time.

        :param odd_s: largest usual deviation of an interval, s; a larger one is odd.
        :param most_s: largest error of a stamp, s; a larger deviation is one of the exposure.
        :param least_s: shortest time over which a speed is measured, s.
        """
        key = odd_s, most_s, least_s
        if key not in self._odd:  # cached, as every track of a pair asks the same
            self._odd[key] = self._odd_share(*key)
        return self._odd[key]

    def _odd_share(self, odd_s: float, most_s: float, least_s: float) -> float:
        intervals_s = np.array(self._latest_s)
        if len(intervals_s) < _FEWEST_ODD:
            return 0.0
        periods, near, pace_s = _paced(intervals_s)
        off_s = np.where(near, np.abs(intervals_s - periods * pace_s), 0.0)
        if not _keeps_pace(off_s[near], pace_s):
            return 0.0
        off_s[off_s <= max(odd_s, _ROUNDED_S)] = 0.0
        since_s = np.maximum(np.cumsum(intervals_s[::-1])[::-1], least_s)
        return float(np.max(np.minimum(off_s, most_s) / since_s))

    def _take(self, interval_s: float) -> None:
        """Add an interval; if the newest few have another pace, forget the older ones."""
        self._latest_s.append(interval_s)
        if len(self._latest_s) < _FEWEST + _NEW_PACE:
            return
        intervals_s = np.array(self._latest_s)
        intervals_s /= _paced(intervals_s).periods
        old_s, new_s = intervals_s[:-_NEW_PACE], intervals_s[-_NEW_PACE:]
        apart_s = max(new_s.min() - old_s.max(), old_s.min() - new_s.max())
        if apart_s > max(float(np.ptp(old_s)), float(np.ptp(new_s)), _ROUNDED_S):
            newest = list(self._latest_s)[-_NEW_PACE:]
            self._latest_s.clear()
            self._latest_s.extend(newest)

    def _pace_s(self) -> Optional[float]:
        """Return the period of the stream, s; None if it has not kept a pace."""
        if len(self._intervals_s) < _PACE:
            return None
        intervals_s = np.array(self._intervals_s)
        periods, near, pace_s = _paced(intervals_s)
        off_s = intervals_s - periods * pace_s
        return pace_s if near.all() and (np.abs(off_s) < _JITTER_S).all() else None


class _Paced(NamedTuple):
    """
    The intervals of a stream in terms of its pace.

    :param periods: (n,) number of periods that each interval spans.
    :param near: (n,) whether the interval is not a long gap.
    :param pace_s: the period, s.
    """

    periods: Array
    near: NDArray[np.bool_]
    pace_s: float


def _paced(intervals_s: Array) -> _Paced:
    """Return the pace that fits most of the intervals."""
    pace_s = float(np.sort(intervals_s)[len(intervals_s) // _SHORT])  # low, as gaps are longer
    for _ in range(2):
        periods = np.maximum(np.round(intervals_s / pace_s), 1.0)
        near = periods <= _MOST_PERIODS
        pace_s = _median((intervals_s / periods)[near])
    return _Paced(periods, near, pace_s)


def _off_s(intervals_s: Array) -> Array:
    """
    Return the deviations of intervals from their pace, s.

    Intervals over missing images are compared with whole multiples of the period; without a pace,
    all are compared with their median, and outliers are left out.
    """
    periods, near, pace_s = _paced(intervals_s)
    off_s = (intervals_s - periods * pace_s)[near]
    if _keeps_pace(off_s, pace_s):
        return off_s
    middle_s = _median(intervals_s)
    off_s = (intervals_s - middle_s)[intervals_s < _MOST_PERIODS * middle_s]
    # A gap is not scatter; without a pace only its length reveals it.
    return off_s[np.abs(off_s) < _STRAY_SIGMAS * _MAD_SIGMA * _median(np.abs(off_s))]


def _median(values: Array) -> float:
    """Return what ``np.median`` does, which takes much longer for a few numbers."""
    ordered = np.sort(values)  # NaN comes last
    count = len(ordered)
    if not count or math.isnan(ordered[-1]):
        return math.nan
    return float((ordered[(count - 1) // 2] + ordered[count // 2]) / 2)


def _keeps_pace(off_s: Array, pace_s: float) -> bool:
    """Return whether intervals with such deviations from a pace keep it at all."""
    return _interval_std_s(off_s) < _NO_PACE * math.sqrt(2.0) * pace_s


def _interval_std_s(off_s: Array) -> float:
    """Return the 1-sigma of intervals, without the two that a single stray stamp affects."""
    by_size_s = np.sort(np.abs(off_s))
    rest_s = by_size_s[:-_STRAYS]
    if len(rest_s) >= _FEWEST_BESIDE:
        most_s = _STRAY_SIGMAS * _MAD_SIGMA * _median(rest_s)
        by_size_s = np.append(rest_s, by_size_s[-_STRAYS:][by_size_s[-_STRAYS:] <= most_s])
    return float(np.sqrt(np.mean(by_size_s ** 2)))
