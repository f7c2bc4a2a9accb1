# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Solutions in a thread beside the pairs, so that no reading waits for one.

Solving for one vehicle takes as long as the readings of ten.  Live, at high rates, readings are
predicted from the last solutions.  The next solutions are computed in a thread that gives way to
the pairs, and are taken in with the first pair after they are ready.
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
Fed = list[tuple[StereoPair, Optional[TrackUpdate]]]  # pairs, each with the track's update

_MOST_PASSED_OVER = 3  # urgent tasks in a row while others wait
_MOST_LATER = 8  # pairs kept during a turn; a solution that takes longer is late


@dataclass(eq=False)
class Turn:
    """
    A turn: a track solves for a pair while further pairs come.

    :param pair: the pair that it solves for.
    :param particles: number of particles that its tracker was told to use.
    :param later: pairs that came since; the track is fed them afterwards if they need no solution.
    :param fed: the pairs that it was fed, each with its update, once the turn is over.
    :param expected: stamp of a pair to the predicted update that was given for it.
    :param others: stamp of a pair to the updates of other tracks for it.
    :param stamp_std_s: larger 1-sigma of the stamps found during the turn, s; None if there is
        none.
    """

    pair: StereoPair
    particles: int
    later: deque[StereoPair]
    fed: Future[Fed]
    expected: dict[int, TrackUpdate] = field(default_factory=dict)
    others: dict[int, list[TrackUpdate]] = field(default_factory=dict)
    stamp_std_s: Optional[float] = None


def later_pairs() -> deque[StereoPair]:
    """Return an empty queue for the pairs that come during a turn."""
    return deque(maxlen=_MOST_LATER)


@dataclass(eq=False)
class _Task(Generic[T]):
    """A piece of work and the future of its result."""

    work: Callable[[], T]
    future: Future[T] = field(default_factory=Future)

    def do(self) -> None:
        """Do the work, unless it was cancelled."""
        if self.future.set_running_or_notify_cancel():
            try:
                self.future.set_result(self.work())
            except BaseException as error:
                self.future.set_exception(error)


class SolvingBeside:
    """A thread that computes solutions, one after the other; each pipeline has its own."""

    def __init__(self) -> None:
        self._way = RightOfWay()
        self._first: deque[_Task[Any]] = deque()
        self._then: deque[_Task[Any]] = deque()
        self._passed_over = 0  # urgent tasks done in a row while others waited
        self._thread = ThreadPoolExecutor(
            max_workers=1, thread_name_prefix='solutions', initializer=self._way.give)

    def submit(self, task: Callable[[], T], *, urgent: bool = True) -> Future[T]:
        """
        Queue a task and return its future.

        :param urgent: whether it goes before tasks that are not urgent.  Solutions of known
            vehicles are urgent, as their published readings age; new tracks have none yet.
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
        """Return a context that pauses the thread while a pair is processed."""
        return self._way.held()

    def wait(self, future: Future[Any]) -> None:
        """Wait until a task is done; not to be called while the thread is paused."""
        wait([future])

    def close(self) -> None:
        """Cancel tasks that have not begun, and wait for the one that has."""
        for one in [*self._first, *self._then]:
            one.future.cancel()
        self._thread.shutdown()
