# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A clock that steps shows in the stamps of a camera that has kept its pace until then."""
from __future__ import annotations

from collections import deque
from typing import Optional

import numpy as np

_PACE = 20  # intervals that must have kept the pace
_JITTER_S = 5e-4  # by which an interval may differ from it
_STEP_S = 3e-3  # a smaller difference is no step
_MOST_PERIODS = 10  # of a gap; after a longer one the pace has to be found anew


class StampWatch:
    """
    Finds steps of the clock; see the module's docstring.

    A stream with uneven intervals has no pace, and nothing is said of it. Missing images leave
    gaps of whole periods, which are no steps. ``steps`` counts them, ``last_step_s`` is the newest
    one.
    """

    def __init__(self) -> None:
        self._intervals_s: deque[float] = deque(maxlen=_PACE)
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
            return 0.0
        periods = max(round(interval_s / pace_s), 1)
        off_s = interval_s - periods * pace_s
        if periods > _MOST_PERIODS or abs(off_s) < _STEP_S:
            self._intervals_s.append(interval_s / periods)
            return 0.0
        self.steps, self.last_step_s = self.steps + 1, off_s
        # One step leaves the pace as it was; where they go on, there was none.
        self._intervals_s.popleft()
        return off_s

    def restart(self) -> None:
        """Forget the last stamp: time has jumped."""
        self._last_ns = None

    def _pace_s(self) -> Optional[float]:
        """Return the period of the stream; None where it keeps none."""
        if len(self._intervals_s) < _PACE:
            return None
        pace_s = float(np.median(self._intervals_s))
        steady = np.abs(np.array(self._intervals_s) - pace_s) < _JITTER_S
        return pace_s if steady.all() else None
