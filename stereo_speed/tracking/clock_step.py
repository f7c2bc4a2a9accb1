# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Decides whether images are missing in a gap of the stamps, or their clock was set forward in it.

Set forward by a whole number of periods, a clock leaves the same stamps as missing images.  But
the vehicle has moved on for one period only, so with these stamps it seems to stop in the gap and
to go on afterwards.  The evidence of the images with the stamps as they are is compared with that
of all steps that are possible.
"""
from __future__ import annotations

import math
from typing import Iterable, Optional, Sequence

import numpy as np

from .keyframes import Window
from .motion_prior import PassMotion
from .solution import Solver
from ..core.stamp_watch import Gap

_REJECTED = math.log(100.0)  # log odds of a step from which a pass is rejected
_SURE = math.log(1e4)  # log odds from which a step, or that there was none, is taken as a fact
_READ = -math.log(20.0)  # log odds up to which there are live readings
_RECENT_NS = 1_000_000_000  # age up to which a gap affects live readings


def log_odds(window: Window, solver: Solver, motion: PassMotion, gaps: Iterable[Gap]) -> float:
    """
    Return the logarithm of the odds that the clock was set forward in a gap.

    :param window: pairs of a pass, solved with their stamps.
    :param motion: prior of the pass.
    :param gaps: gaps of the stream; those outside the window do not count.
    :return: that of the most likely step; -inf if none is possible.
    """
    stamps_ns = np.array([pair.stamp_ns for pair in window.pairs])
    counted_ns, times_s = stamps_ns[window.counts()], window.times_s
    steps = [times_s - (stamps_ns >= gap.after_ns) * step * gap.period_s for gap in gaps
             if counted_ns.size and counted_ns[0] < gap.after_ns <= counted_ns[-1]
             for step in range(1, gap.periods)]
    if not steps:
        return -math.inf
    as_stamped, *others = solver.log_evidences(window, motion, [times_s, *steps])
    return float(max(others) - as_stamped)


def clock_was_set(window: Window, solver: Solver, motion: PassMotion, gaps: Iterable[Gap]) -> bool:
    """Return whether a whole pass shows a step; arguments are those of :func:`log_odds`."""
    return log_odds(window, solver, motion, gaps) > _REJECTED


class ClockWatch:
    """
    Judges the gaps of the stream while a pass is under way.

    ``doubtful`` is whether a step is possible in a recent gap.  ``step`` is a gap in which the
    clock was certainly set; None if there is none.

    :param solver: solves the pass.
    """

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self._odds: dict[int, float] = {}  # log odds of the recent gaps, by the ends of these
        self.doubtful = False
        self.step: Optional[Gap] = None

    def judge(self, window: Window, motion: PassMotion, gaps: Sequence[Gap]) -> None:
        """
        Judge the recent gaps by a window that has just been solved.

        A gap keeps its odds if the pairs before it have been dropped, as they may have been
        because the vehicle is taken to be elsewhere since.
        """
        newest_ns, known = window.pairs[-1].stamp_ns, self._odds
        recent = [gap for gap in gaps if newest_ns - gap.after_ns < _RECENT_NS]
        self._odds = {gap.after_ns: known.get(gap.after_ns, -math.inf) for gap in recent}
        for gap in recent:
            if -math.inf < self._odds[gap.after_ns] < -_SURE:
                continue
            odds = log_odds(window, self._solver, motion, [gap])
            if odds > -math.inf:
                self._odds[gap.after_ns] = odds
            if odds > _SURE:
                self.step = gap
        self.doubtful = self.step is not None or any(
            odds > _READ for odds in self._odds.values())
