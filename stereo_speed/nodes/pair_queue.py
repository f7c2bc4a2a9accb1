# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The queue of pairs between the receiving thread and the measuring thread.

A pair that has waited for most of the interval between two pairs is hurried: less work is done for
it, so that the next one waits less.  This is decided for each pair, so pairs are hurried only
while the machine does not keep up.  If that is not enough and a pair has waited too long, the
newest pair is measured and all older ones are skipped, until nothing had to be skipped for some
time.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import threading
import time
from typing import Callable, Generic, Optional, TypeVar

Item = TypeVar('Item')
RECOVER_S = 5.0  # time without a skipped pair after which the machine counts as keeping up again
LEAST_LONG_S = 0.02  # waiting time up to which no pair is hurried, as arrivals jitter
_LONG = 0.6  # the same as a share of the interval between two pairs; the greater one counts


@dataclass(frozen=True, eq=False)
class _Waiting(Generic[Item]):
    """
    A pair that waits.

    :param came_s: steady time of its arrival, s.
    :param stamp_ns: its stamp.
    :param item: the pair.
    """

    came_s: float
    stamp_ns: int
    item: Item


class PairQueue(Generic[Item]):
    """
    See the module's docstring.

    :param most_wait_s: waiting time of a pair above which older pairs are skipped, s.
    :param most: greatest number of waiting pairs.
    :param hurry: whether pairs are hurried before any are skipped.
    :param clock: steady time, s.

    ``hurried`` tells whether the pair that was taken last is hurried, ``skipped_ns`` are the
    stamps of the pairs that were skipped before it; empty if none was there to take.
    """

    def __init__(self, most_wait_s: float, most: int,
                 clock: Callable[[], float] = time.monotonic, *, hurry: bool = True) -> None:
        self.most_wait_s, self._clock = most_wait_s, clock
        self._waiting: deque[_Waiting[Item]] = deque()
        self._most, self._changed, self._closed = most, threading.Condition(), False
        self._skipped_ns: list[int] = []  # since the pair that was taken last
        self.skipped_ns: list[int] = []
        self._skipped_s, self._ready_s = -float('inf'), -float('inf')
        self._came_s, self._between_s = -float('inf'), 0.0
        self._may_hurry, self.overloaded, self.hurried = hurry, False, False

    def ready(self) -> None:
        """Mark measuring as ready; earlier waiting does not count as being slow."""
        self._ready_s = self._clock()

    def put(self, item: Item, stamp_ns: int) -> None:
        """
        Add the newest pair; the oldest is skipped if too many are waiting.

        :param item: the pair.
        :param stamp_ns: its stamp.
        """
        with self._changed:
            now_s = self._clock()
            self._came_s, self._between_s = now_s, now_s - self._came_s
            self._waiting.append(_Waiting(now_s, stamp_ns, item))
            self._skip(len(self._waiting) - self._most)
            self._changed.notify()

    def take(self, timeout_s: float) -> Optional[Item]:
        """Return the pair to measure next; None if none comes in time."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed, timeout_s)
            if not self._waiting:
                self.skipped_ns = []
                return None
            now_s = self._clock()
            if self.overloaded and now_s - self._skipped_s > RECOVER_S:
                self.overloaded = False
            if self.overloaded or now_s - self._waiting[0].came_s > self.most_wait_s:
                self._skip(len(self._waiting) - 1)
            self.skipped_ns, self._skipped_ns = self._skipped_ns, []
            taken = self._waiting.popleft()
            waited_s = now_s - max(taken.came_s, self._ready_s)
            self.hurried = self._may_hurry and (
                self.overloaded or waited_s > max(LEAST_LONG_S, _LONG * self._between_s))
            return taken.item

    def _skip(self, count: int) -> None:
        """Skip the oldest pairs, if the count is positive."""
        if count > 0:
            self._skipped_ns += [self._waiting.popleft().stamp_ns for _ in range(count)]
            self._skipped_s, self.overloaded = self._clock(), True

    def close(self) -> None:
        """Wake the waiting thread, as no more pairs will come."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def __len__(self) -> int:
        return len(self._waiting)
