# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Pairs between the thread that receives and the thread that measures.

Short delays are made good: what is measured live then is what ``replay`` measures. When the pair
in hand has waited for long, the machine does not keep up: from then on pairs are hurried, those
that had to wait most, until for some time none had to wait for half as long. Who is hurried again
soon after is hurried for longer the next time. Where that does not do, and the pair in hand has
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
CALM_S, MOST_CALM_S = 2.0, 60.0  # without a pair that waits for long, none is hurried any more
AGAIN_S = 10.0  # who hurries again so soon after a calm stopped too soon
LONG_S = 0.1  # that a pair waits, at least, until pairs are hurried
_LONG = 0.1  # of most_wait_s, the same
_PROLONGS = 0.5  # of that: one stall, or the jitter of arrivals, does not
_SHORT_S = 0.01  # that pairs may wait while they are hurried


class Haste:
    """
    Whether pairs are hurried.

    :param begins_s: for which a pair must have waited.
    """

    def __init__(self, begins_s: float) -> None:
        self._begins_s, self._calm_s = begins_s, CALM_S
        self._on, self._begun_s = False, 0.0
        self._late_s = self._ended_s = -float('inf')

    def see(self, now_s: float, waited_s: float, overloaded: bool) -> bool:
        """
        Return whether pairs are hurried from now on.

        :param now_s: steady time.
        :param waited_s: how long the pair in hand has waited.
        :param overloaded: whether pairs are skipped.
        """
        if self._on and not self._lasts(now_s):
            self._on, self._ended_s = False, self._late_s + self._calm_s
        if not self._on and (overloaded or waited_s > self._begins_s):
            again = now_s - self._ended_s < self._calm_s + AGAIN_S
            self._calm_s = min(2 * self._calm_s, MOST_CALM_S) if again else CALM_S
            self._on, self._begun_s = True, now_s
        if self._on and (overloaded or waited_s > _PROLONGS * self._begins_s):
            self._late_s = now_s
        return self._on

    def _lasts(self, now_s: float) -> bool:
        return now_s - self._late_s <= self._calm_s

    def lasted_s(self, now_s: float) -> float:
        """Return for how long pairs have been hurried without a break; 0 where they are not."""
        return now_s - self._begun_s if self._on and self._lasts(now_s) else 0.0


class PairQueue(Generic[Item]):
    """
    See the module's docstring.

    :param most_wait_s: that a pair may have waited.
    :param most: pairs that may wait.
    :param hurry: whether pairs are hurried before any are skipped.
    :param clock: steady time, s.
    """

    def __init__(self, most_wait_s: float, most: int,
                 clock: Callable[[], float] = time.monotonic, *, hurry: bool = True) -> None:
        self.most_wait_s, self._clock = most_wait_s, clock
        self._waiting: deque[tuple[float, Item]] = deque()
        self._most, self._changed, self._closed = most, threading.Condition(), False
        self._skipped, self._skipped_s, self._ready_s = 0, -float('inf'), -float('inf')
        self._haste = Haste(max(_LONG * most_wait_s, LONG_S))
        self._may_hurry, self.overloaded, self.hurry = hurry, False, Hurry.NO

    def ready(self) -> None:
        """Be told that measuring is ready: what waited until now did not wait for others."""
        self._ready_s = self._clock()

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
            self.hurry = self._hurried(now_s, now_s - max(came_s, self._ready_s))
            return item

    def _hurried(self, now_s: float, waited_s: float) -> Hurry:
        """Return how the pair that is served is hurried."""
        if not (self._may_hurry and self._haste.see(now_s, waited_s, self.overloaded)):
            return Hurry.NO
        return Hurry.MUCH if waited_s > _SHORT_S else Hurry.SOME

    @property
    def hurrying_s(self) -> float:
        """Return for how long pairs have been hurried without a break; 0 where they are not."""
        return self._haste.lasted_s(self._clock())

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
