# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Pairs between the thread that receives and the thread that measures.

Short delays are made good: what is measured live is what ``replay`` measures. When the pair in
hand has waited for long, the machine does not keep up: from then on pairs that had to wait are
hurried, until for some time none had to be. Where that does not do, and the pair in hand has
waited too long, the newest pair is served and all older ones are skipped, whole and in order,
until for some time there was nothing to skip.
"""
from __future__ import annotations

from collections import deque
import threading
import time
from typing import Callable, Generic, Optional, TypeVar

from ..pipeline.pipeline import Hurry

Item = TypeVar('Item')
RECOVER_S = 5.0  # without a pair skipped, the machine keeps up again
CALM_S = 60.0  # without a pair hurried, too: who takes it for that too soon has pairs wait again
_LONG = 0.1  # of most_wait_s, for which one waits until pairs are hurried
_SHORT_S = 0.01  # that pairs may wait from then on


class PairQueue(Generic[Item]):
    """
    See the module's docstring.

    :param most_wait_s: that a pair may have waited.
    :param most: pairs that may wait.
    :param clock: steady time, s.
    """

    def __init__(self, most_wait_s: float, most: int,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self.most_wait_s, self._clock = most_wait_s, clock
        self._waiting: deque[tuple[float, Item]] = deque()
        self._most, self._changed, self._closed = most, threading.Condition(), False
        self._skipped, self._skipped_s, self._hurried_s = 0, -float('inf'), -float('inf')
        self.overloaded = self._hurries = False
        self.hurry = Hurry.NO

    def put(self, item: Item) -> None:
        """Add the newest pair; the oldest is skipped where too many wait."""
        with self._changed:
            self._waiting.append((self._clock(), item))
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
            self._hurry(now_s, now_s - came_s)
            return item

    def _hurry(self, now_s: float, waited_s: float) -> None:
        """Decide whether the pair that is served is hurried."""
        if self._hurries and now_s - self._hurried_s > CALM_S:
            self._hurries = False
        self._hurries |= self.overloaded or waited_s > _LONG * self.most_wait_s
        late = waited_s > _SHORT_S
        self.hurry = Hurry.NO if not self._hurries else Hurry.MUCH if late else Hurry.SOME
        if self._hurries and late:
            self._hurried_s = now_s

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
