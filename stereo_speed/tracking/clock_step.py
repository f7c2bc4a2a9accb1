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
from typing import Iterable

import numpy as np

from .keyframes import Window
from .motion_prior import PassMotion
from .solution import Solver
from ..core.records import Array
from ..core.stamp_watch import Gap

_ODDS = 100.0  # of a step, by the images, above which the stamps are doubted


def clock_was_set(window: Window, solver: Solver, motion: PassMotion, gaps: Iterable[Gap]) -> bool:
    """
    Return whether a pass shows that the clock was set forward in a gap of its stamps.

    :param window: the pass, solved with its stamps.
    :param motion: prior of the pass.
    :param gaps: gaps of the stream; those outside the pass do not count.
    """
    steps = [times_s for gap in gaps for times_s in _with_steps(window, gap)]
    if not steps:
        return False
    as_stamped, *others = solver.log_evidences(window, motion, [window.times_s, *steps])
    return bool(max(others) - as_stamped > math.log(_ODDS))


def _with_steps(window: Window, gap: Gap) -> list[Array]:
    """Return the times (n,) of the keyframes, s, for each step of the clock in a gap."""
    stamps_ns = np.array([pair.stamp_ns for pair in window.pairs])
    after, counts = stamps_ns >= gap.after_ns, window.counts()
    if not (counts & after).any() or not (counts & ~after).any():
        return []
    return [window.times_s - after * step * gap.period_s for step in range(1, gap.periods)]
