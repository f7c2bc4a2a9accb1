# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What the stamps of a camera tell of its clock: steps, and by how much they are off an even pace.

A step shows where the pace was kept until then.
"""
from __future__ import annotations

from collections import deque
import math
from typing import NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray

from .records import Array

_PACE = 20  # intervals that must have kept the pace
_JITTER_S = 5e-4  # by which an interval may differ from it
_STEP_S = 3e-3  # a smaller difference is no step
_MOST_PERIODS = 10  # of a gap; after a longer one the pace has to be found anew
_FEWEST = 5  # intervals that tell how even the stamps are
_FEWEST_ODD = 2  # intervals, of which one is odd where they differ
_NO_PACE = 0.15  # of a period; without any pace the 1-sigma would be 0.2 of it (a uniform rest)
_ROUNDED_S = 1e-5  # of an even pace: stamps are rounded to less
_NEW_PACE = 3  # intervals that make another pace
_STRAYS = 2  # intervals that one stray stamp makes
_SHORT = 8  # one interval in so many is a stray shorter than the pace
_FEWEST_BESIDE = 8  # intervals that such strays are held against
_STRAY_SIGMAS = 4.0  # a stray is farther off than Gaussian intervals are
_MAD_SIGMA = 1.4826  # 1-sigma of a Gaussian over its median absolute deviation


class StampWatch:
    """
    Finds steps of the clock; see the module's docstring.

    A stream with uneven intervals has no pace, and nothing is said of it. Missing images leave
    gaps of whole periods, which are no steps. ``steps`` counts them, ``last_step_s`` is the newest
    one.
    """

    def __init__(self) -> None:
        self._intervals_s: deque[float] = deque(maxlen=_PACE)
        self._latest_s: deque[float] = deque(maxlen=_PACE)  # as they are, but for steps
        self._last_ns: Optional[int] = None
        self.steps, self.last_step_s = 0, 0.0
        self._odd: dict[tuple[float, float, float], float] = {}  # shares at the newest stamp

    def add(self, ns: int) -> float:
        """Take the next stamp; return by how much the clock has stepped before it, s."""
        last_ns, self._last_ns = self._last_ns, ns
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
            return 0.0
        self.steps, self.last_step_s = self.steps + 1, off_s
        # One step leaves the pace as it was; where they go on, there was none.
        self._intervals_s.popleft()
        return off_s

    def restart(self) -> None:
        """Forget the last stamp: time has jumped."""
        self._last_ns = None

    def unevenness_s(self, most_s: float) -> Optional[float]:
        """
        Return the 1-sigma of the stamps about an even pace.

        Independent errors of two stamps make that of the interval between them.  One stray stamp
        says nothing of the others.  What few intervals tell is uncertain: the mean of the variance
        is given, by all they tell.  Where there is no pace, as of exposures at any time, all
        scatter of the intervals counts.

        :param most_s: that is as it should be.
        :return: None where it is no more than that, or where nothing is known yet.
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
        Return the 1-sigma of a speed at the newest stamp by odd ones among the last, as a share.

        A stamp off an even pace by more than stamps are known to be may be a stray one or the
        first of many, which only those to come will tell. A way since then is wrong as if it had
        taken so much longer or shorter.

        :param odd_s: by which intervals are off as stamps are known to be; more is odd.
        :param most_s: by which a stamp may be wrong; exposures are off by more.
        :param least_s: for which a speed is measured at least.
        """
        asked = odd_s, most_s, least_s
        if asked not in self._odd:  # each track of a pair asks the same
            self._odd[asked] = self._odd_share(*asked)
        return self._odd[asked]

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
        """Take in an interval; where the newest few have another pace, forget the others."""
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
        """Return the period of the stream; None where it keeps none."""
        if len(self._intervals_s) < _PACE:
            return None
        pace_s = float(np.median(self._intervals_s))
        steady = np.abs(np.array(self._intervals_s) - pace_s) < _JITTER_S
        return pace_s if steady.all() else None


class _Paced(NamedTuple):
    """
    How intervals keep a pace.

    :param periods: (n,) that each spans.
    :param near: (n,) whether it is no long gap.
    :param pace_s: the period.
    """

    periods: Array
    near: NDArray[np.bool_]
    pace_s: float


def _paced(intervals_s: Array) -> _Paced:
    """Return how intervals keep the pace that fits most of them."""
    pace_s = float(np.sort(intervals_s)[len(intervals_s) // _SHORT])  # gaps are longer
    for _ in range(2):
        periods = np.maximum(np.round(intervals_s / pace_s), 1.0)
        near = periods <= _MOST_PERIODS
        pace_s = float(np.median((intervals_s / periods)[near]))
    return _Paced(periods, near, pace_s)


def _off_s(intervals_s: Array) -> Array:
    """
    Return by how much intervals are off a pace.

    Those over missing images are off whole periods, where these show.
    """
    periods, near, pace_s = _paced(intervals_s)
    off_s = (intervals_s - periods * pace_s)[near]
    if _keeps_pace(off_s, pace_s):
        return off_s
    middle_s = float(np.median(intervals_s))
    off_s = (intervals_s - middle_s)[intervals_s < _MOST_PERIODS * middle_s]
    # A gap is no scatter, and without a pace only its length tells it.
    return off_s[np.abs(off_s) < _STRAY_SIGMAS * _MAD_SIGMA * float(np.median(np.abs(off_s)))]


def _keeps_pace(off_s: Array, pace_s: float) -> bool:
    """Return whether intervals that are off a pace by so much have one at all."""
    return _interval_std_s(off_s) < _NO_PACE * math.sqrt(2.0) * pace_s


def _interval_std_s(off_s: Array) -> float:
    """Return the 1-sigma of intervals; what one stray stamp makes of two of them is left out."""
    by_size_s = np.sort(np.abs(off_s))
    rest_s = by_size_s[:-_STRAYS]
    if len(rest_s) >= _FEWEST_BESIDE:
        most_s = _STRAY_SIGMAS * _MAD_SIGMA * float(np.median(rest_s))
        by_size_s = np.append(rest_s, by_size_s[-_STRAYS:][by_size_s[-_STRAYS:] <= most_s])
    return float(np.sqrt(np.mean(by_size_s ** 2)))
