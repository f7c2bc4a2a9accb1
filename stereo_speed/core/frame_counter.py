# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Number the frames of a live camera by their header stamps, in integer nanoseconds."""
from __future__ import annotations

from collections import deque
from statistics import median

_INTERVALS = 31  # enough that a run of dropped frames does not move their median


class FrameCounter:
    """
    Numbers frames by their stamps, so that those dropped on the way count as well.

    The interval of the frames is the median of the latest ones; a gap of k of them, rounded,
    advances the number by k. Stamps that are not later than the last one have no number.

    ``number`` is that of the last frame, 0 before the first; ``gaps`` and ``dropped`` count the
    gaps and the frames missing in them, ``repeated`` and ``late`` the stamps left out.

    :param jump_ns: a stamp this far before the last one is of another time, ns.
    """

    def __init__(self, jump_ns: int) -> None:
        self.jump_ns = jump_ns
        self.number = self.last_ns = 0
        self.gaps = self.dropped = self.repeated = self.late = 0
        self._intervals: deque[int] = deque(maxlen=_INTERVALS)

    def jumps_back(self, ns: int) -> bool:
        """Return whether a stamp [ns] is of another time."""
        return self.number > 0 and ns < self.last_ns - self.jump_ns

    def restart(self) -> None:
        """Start again at number 1; the counts go on."""
        self.number = self.last_ns = 0
        self._intervals.clear()

    def step(self, ns: int) -> int:
        """Return how many frames after the last one a stamp [ns] is: 0 for one to leave out."""
        if self.number == 0:
            self.number, self.last_ns = 1, ns
            return 1
        interval = ns - self.last_ns
        if interval <= 0:
            self.repeated += interval == 0
            self.late += interval < 0
            return 0
        self._intervals.append(interval)
        frames = max(round(interval / median(self._intervals)), 1)
        self.gaps += frames > 1
        self.dropped += frames - 1
        self.number, self.last_ns = self.number + frames, ns
        return frames
