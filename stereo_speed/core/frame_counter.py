# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers the frames of a live camera by their header stamps, in integer nanoseconds."""
from __future__ import annotations

from collections import deque
from statistics import median

_INTERVALS = 31  # enough that a run of dropped frames does not affect their median


class FrameCounter:
    """
    Numbers frames by their stamps, so that dropped frames keep their numbers.

    The frame interval is the median of the latest intervals; a gap of k frame intervals, rounded,
    advances the number by k. A stamp that is not later than the last one gets no number.

    ``number`` is the number of the last frame, 0 before the first; ``gaps`` and ``dropped`` count
    the gaps and the frames missing in them, ``repeated`` and ``late`` the stamps left out.

    :param jump_ns: a stamp farther than this before the last one means that time has jumped
        back, ns.
    """

    def __init__(self, jump_ns: int) -> None:
        self.jump_ns = jump_ns
        self.number = self.last_ns = 0
        self.gaps = self.dropped = self.repeated = self.late = 0
        self._intervals: deque[int] = deque(maxlen=_INTERVALS)

    def jumps_back(self, ns: int) -> bool:
        """Return whether time has jumped back to a stamp [ns]."""
        return self.number > 0 and ns < self.last_ns - self.jump_ns

    def restart(self) -> None:
        """Start again at number 1; the counts continue."""
        self.number = self.last_ns = 0
        self._intervals.clear()

    def step(self, ns: int) -> int:
        """Return by how many frames a stamp [ns] follows the last one; 0 if it is left out."""
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
