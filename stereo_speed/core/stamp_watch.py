# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What the stamps of a camera tell of its clock: steps, and by how much they are off an even pace.

A step shows where the pace was kept until then.
"""
from __future__ import annotations

from collections import deque
import math
from typing import Optional

import numpy as np

_PACE = 20  # intervals that must have kept the pace
_JITTER_S = 5e-4  # by which an interval may differ from it
_STEP_S = 3e-3  # a smaller difference is no step
_MOST_PERIODS = 10  # of a gap; after a longer one the pace has to be found anew
_FEWEST = 5  # intervals that tell how even the stamps are
_NO_PACE = 0.15  # of a period; without any pace the 1-sigma would be 0.2 of it (a uniform rest)
_ROUNDED_S = 1e-5  # of an even pace: stamps are rounded to less


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

    def add(self, ns: int) -> float:
        """Take the next stamp; return by how much the clock has stepped before it, s."""
        last_ns, self._last_ns = self._last_ns, ns
        if last_ns is None:
            return 0.0
        interval_s = (ns - last_ns) * 1e-9
        pace_s = self._pace_s()
        if pace_s is None:
            self._intervals_s.append(interval_s)
            self._latest_s.append(interval_s)
            return 0.0
        periods = max(round(interval_s / pace_s), 1)
        off_s = interval_s - periods * pace_s
        if periods > _MOST_PERIODS or abs(off_s) < _STEP_S:
            self._intervals_s.append(interval_s / periods)
            self._latest_s.append(interval_s)
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

        Independent errors of two stamps make that of the interval between them.  What few
        intervals tell of it is uncertain: the mean of the variance is given, by all they tell.

        :param most_s: that is as it should be.
        :return: None where it is no more than that, where there is no pace, as of exposures at
            any time, or where nothing is known yet.
        """
        if len(self._latest_s) < _FEWEST:
            return None
        intervals_s = np.array(self._latest_s)
        pace_s = float(np.sort(intervals_s)[len(intervals_s) // 4])  # gaps are longer
        for _ in range(2):
            periods = np.maximum(np.round(intervals_s / pace_s), 1.0)
            near = periods <= _MOST_PERIODS
            pace_s = float(np.median((intervals_s / periods)[near]))
        off_s = (intervals_s - periods * pace_s)[near]
        if len(off_s) < _FEWEST:
            return None
        std_s = float(np.sqrt(np.mean(off_s ** 2) / 2.0))
        if not max(most_s, _ROUNDED_S) < std_s < _NO_PACE * pace_s:
            return None
        freedom = len(off_s) / 1.5  # neighbouring intervals share a stamp
        return std_s * math.sqrt(freedom / (freedom - 2.0))

    def _pace_s(self) -> Optional[float]:
        """Return the period of the stream; None where it keeps none."""
        if len(self._intervals_s) < _PACE:
            return None
        pace_s = float(np.median(self._intervals_s))
        steady = np.abs(np.array(self._intervals_s) - pace_s) < _JITTER_S
        return pace_s if steady.all() else None
