# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Solutions beside the pairs: no reading waits for one.

To solve for one vehicle takes as long as the readings of ten.  Live, at high rates, readings are
those of the last solutions, carried on to the pair; the next ones are worked on in a thread that
gives way to the pairs, and are taken in with the first pair after they are ready.
"""
from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, Callable, Generic, Optional, TypeVar

from ..core.records import StereoPair, TrackUpdate
from ..core.right_of_way import RightOfWay

T = TypeVar('T')
Said = list[tuple[StereoPair, Optional[TrackUpdate]]]

_MOST_PASSED_OVER = 3  # urgent tasks that are done before one that is not
_MOST_LATER = 8  # pairs: a solution that takes longer is late


@dataclass(eq=False)
class Turn:
    """
    A pair that a track solves for while others come.

    :param pair: that it solves for.
    :param particles: number of particles that its tracker was told.
    :param later: pairs that came meanwhile, which it is fed afterwards if they need no solution.
    :param said: the pairs that it was fed in the end, and what it says of each.
    :param expected: by the stamp of a pair, where the vehicle was expected when that came.
    :param others: by the stamp of a pair, what other tracks say of it.
    :param stamp_std_s: 1-sigma that stamps have turned out to have since, s; None where they are
        as good as the track takes them to be.
    """

    pair: StereoPair
    particles: int
    later: deque[StereoPair]
    said: Future[Said]
    expected: dict[int, TrackUpdate] = field(default_factory=dict)
    others: dict[int, list[TrackUpdate]] = field(default_factory=dict)
    stamp_std_s: Optional[float] = None


def later_pairs() -> deque[StereoPair]:
    """Return a place for pairs that come during a turn."""
    return deque(maxlen=_MOST_LATER)


@dataclass(eq=False)
class _Task(Generic[T]):
    """What is to be done, and what will come of it."""

    work: Callable[[], T]
    future: Future[T] = field(default_factory=Future)

    def do(self) -> None:
        """Do it, unless it was cancelled."""
        if self.future.set_running_or_notify_cancel():
            try:
                self.future.set_result(self.work())
            except BaseException as error:
                self.future.set_exception(error)


class SolvingBeside:
    """A thread that works on solutions, one after the other; a pipeline has one of its own."""

    def __init__(self) -> None:
        self._way = RightOfWay()
        self._first: deque[_Task[Any]] = deque()
        self._then: deque[_Task[Any]] = deque()
        self._passed_over = 0  # turns of those that are not urgent
        self._thread = ThreadPoolExecutor(
            max_workers=1, thread_name_prefix='solutions', initializer=self._way.give)

    def submit(self, task: Callable[[], T], *, urgent: bool = True) -> Future[T]:
        """
        Return what a task will return, which begins when those before it are done.

        :param urgent: whether it goes before those that are not: readings of known vehicles get
            old, and who waits for new ones is told of none before.
        """
        one = _Task(task)
        (self._first if urgent else self._then).append(one)
        self._thread.submit(self._next)
        return one.future

    def _next(self) -> None:
        others = self._then and (not self._first or self._passed_over >= _MOST_PASSED_OVER)
        self._passed_over = 0 if others or not self._then else self._passed_over + 1
        (self._then if others else self._first).popleft().do()

    def held_up(self) -> AbstractContextManager[None]:
        """Hold the thread up while a pair is in hand."""
        return self._way.held()

    def wait(self, future: Future[Any]) -> None:
        """Wait until a task is done; not while holding it up, for it would give way."""
        wait([future])

    def close(self) -> None:
        """Give up what has not begun, and wait for what has."""
        for one in [*self._first, *self._then]:
            one.future.cancel()
        self._thread.shutdown()
