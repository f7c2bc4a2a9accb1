# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Pairs between the thread that receives and the thread that measures.

A pair that has waited for most of the time between two pairs is hurried: it has the less done with
it, so that the next one waits for less.  Each is hurried by itself: none is but where the machine
does not keep up for the moment.  Where that does not do, and the pair in hand has waited too long,
the newest pair is served and all older ones are skipped, whole and in order, until for some time
there was nothing to skip.
"""
from __future__ import annotations

from collections import deque
import threading
import time
from typing import Callable, Generic, Optional, TypeVar

Item = TypeVar('Item')
RECOVER_S = 5.0  # without a pair skipped, the machine keeps up again
LEAST_LONG_S = 0.02  # that a pair may wait in any case: arrivals jitter
_LONG = 0.6  # of the time between two pairs, the same


class PairQueue(Generic[Item]):
    """
    See the module's docstring.

    :param most_wait_s: that a pair may have waited.
    :param most: pairs that may wait.
    :param hurry: whether pairs are hurried before any are skipped.
    :param clock: steady time, s.

    ``hurried`` says whether the pair that was taken last is.
    """

    def __init__(self, most_wait_s: float, most: int,
                 clock: Callable[[], float] = time.monotonic, *, hurry: bool = True) -> None:
        self.most_wait_s, self._clock = most_wait_s, clock
        self._waiting: deque[tuple[float, Item]] = deque()
        self._most, self._changed, self._closed = most, threading.Condition(), False
        self._skipped, self._skipped_s, self._ready_s = 0, -float('inf'), -float('inf')
        self._came_s, self._between_s = -float('inf'), 0.0
        self._may_hurry, self.overloaded, self.hurried = hurry, False, False

    def ready(self) -> None:
        """Be told that measuring is ready: what waited until now did not wait for others."""
        self._ready_s = self._clock()

    def put(self, item: Item) -> None:
        """Add the newest pair; the oldest is skipped where too many wait."""
        with self._changed:
            now_s = self._clock()
            self._came_s, self._between_s = now_s, now_s - self._came_s
            self._waiting.append((now_s, item))
            skipped = max(len(self._waiting) - self._most, 0)
            for _ in range(skipped):
                self._waiting.popleft()
            self._skip(skipped)
            self._changed.notify()

    def take(self, timeout_s: float) -> Optional[Item]:
        """Return the pair to measure next, as soon as there is one; None if there is none."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed, timeout_s)
            if not self._waiting:
                return None
            now_s = self._clock()
            if self.overloaded and now_s - self._skipped_s > RECOVER_S:
                self.overloaded = False
            if self.overloaded or now_s - self._waiting[0][0] > self.most_wait_s:
                self._skip(len(self._waiting) - 1)
                while len(self._waiting) > 1:
                    self._waiting.popleft()
            came_s, item = self._waiting.popleft()
            waited_s = now_s - max(came_s, self._ready_s)
            self.hurried = self._may_hurry and (
                self.overloaded or waited_s > max(LEAST_LONG_S, _LONG * self._between_s))
            return item

    def _skip(self, count: int) -> None:
        if count:
            self._skipped += count
            self._skipped_s, self.overloaded = self._clock(), True

    def pop_skipped(self) -> int:
        """Return how many pairs were skipped since the last call."""
        with self._changed:
            skipped, self._skipped = self._skipped, 0
        return skipped

    def close(self) -> None:
        """Wake who waits: nothing more will come."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def __len__(self) -> int:
        return len(self._waiting)
