# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
When a pass that is over is measured: at once, or beside the pairs that follow.

Measuring a whole pass takes as long as some pairs do.  What is measured at once comes in the same
order whenever it is run.  Live, other vehicles' readings would wait for it; offline, who can tell
what came of the pairs a little later has it measured beside and told in the same order.  A pass
that cannot be measured has its error raised where results are asked for.
"""
from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Callable, Optional, Protocol

from ..core.passes import PassResult

Measure = Callable[[], PassResult]


class OnlyHereError(Exception):
    """A pass cannot be measured in another process: what it holds cannot be told to one."""


def _nothing() -> None:
    """Do nothing."""


def _here(measure: Measure) -> PassResult:
    """Return the result of a pass."""
    return measure()


class Conclusions(Protocol):
    """Measures passes that are over; a pipeline has one of its own."""

    def add(self, measure: Measure, failed: Callable[[], object] = _nothing) -> None:
        """
        Take in a pass.

        :param measure: measures it and touches nothing else.
        :param failed: told where it is not to be waited for, perhaps in another thread.
        """

    def done(self, *, everything: bool = False) -> list[PassResult]:
        """
        Return results that were not returned before, in the order in which the passes ended.

        :param everything: wait for those that are not ready.
        """

    def close(self) -> None:
        """Give up what is not ready."""


class AtOnce:
    """Measures each pass when it is over."""

    def __init__(self) -> None:
        self._ready: list[PassResult] = []

    def add(self, measure: Measure, failed: Callable[[], object] = _nothing) -> None:
        """Measure a pass."""
        try:
            self._ready.append(measure())
        except Exception:
            failed()
            raise

    def done(self, *, everything: bool = False) -> list[PassResult]:
        """Return results that were not returned before."""
        ready, self._ready = self._ready, []
        return ready

    def close(self) -> None:
        """Give up what was not returned."""
        self._ready = []


class Beside:
    """
    Measures passes in a thread of its own, one after the other.

    Their results are those of :class:`AtOnce`, a few pairs later.  ``waiting`` tells how many are
    still to come, so that who closes an instrument can wait for them.

    :param most: passes that may wait; who adds one more waits for the first of them, for each
        holds its images.
    :param failed: takes the error of a pass that could not be measured, which then has no result;
        without it the error is raised where results are asked for, and who asks again is given
        the others.
    :param measured: where they are measured; in that thread, if it is not told.
    """

    def __init__(self, most: int = 8, failed: Optional[Callable[[Exception], object]] = None,
                 measured: Callable[[Measure], PassResult] = _here) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix='passes')
        self._waiting: deque[Future[PassResult]] = deque()
        self._ready: list[PassResult] = []  # of those before one whose error was raised
        self._most, self._failed, self._measure = most, failed, measured

    @property
    def waiting(self) -> int:
        """Return how many passes were taken in and not returned."""
        return len(self._waiting) + len(self._ready)

    def add(self, measure: Measure, failed: Callable[[], object] = _nothing) -> None:
        """Take in a pass."""
        begun = [future for future in self._waiting if not future.done()]
        if len(begun) >= self._most:
            wait(begun[:1])
        self._waiting.append(self._thread.submit(self._attempted, measure, failed))

    def _attempted(self, measure: Measure, failed: Callable[[], object]) -> PassResult:
        try:
            return self._measure(measure)
        except Exception:
            failed()
            raise

    def done(self, *, everything: bool = False) -> list[PassResult]:
        """Return results that were not returned before, in the order in which passes ended."""
        while self._waiting and (everything or self._waiting[0].done()):
            future = self._waiting.popleft()
            try:
                self._ready.append(future.result())
            except Exception as error:
                if self._failed is None:
                    raise
                self._failed(error)
        ready, self._ready = self._ready, []
        return ready

    def close(self) -> None:
        """Give up what has not begun, and wait for what has."""
        self._thread.shutdown(cancel_futures=True)
        self._waiting.clear()
        self._ready = []


class Later:
    """
    Has passes measured in a thread of its own; who runs the pipeline asks for their results.

    The pipeline is told of none: ``pop`` gives out, after each pair, those that were over with it.

    :param measured: where they are measured; in that thread, if it is not told.
    :param most: passes that may wait, as in :class:`Beside`.
    """

    def __init__(self, measured: Callable[[Measure], PassResult] = _here, most: int = 8) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix='passes')
        self._new: list[Future[PassResult]] = []
        self._waiting: list[Future[PassResult]] = []
        self._measure, self._most = measured, most

    def add(self, measure: Measure, failed: Callable[[], object] = _nothing) -> None:
        """Take in a pass, which the pipeline does not wait for, but where too many wait."""
        self._waiting = [future for future in self._waiting if not future.done()]
        if len(self._waiting) >= self._most:
            wait(self._waiting[:1])
        self._new.append(self._thread.submit(self._measure, measure))
        self._waiting.append(self._new[-1])
        failed()

    def pop(self) -> list[Future[PassResult]]:
        """Return the passes that were taken in since the last call, as they are to come."""
        new, self._new = self._new, []
        return new

    def done(self, *, everything: bool = False) -> list[PassResult]:
        """Return the results that nobody has asked for, the stream being over; before, none."""
        return [future.result() for future in self.pop()] if everything else []

    def close(self) -> None:
        """Give up what has not begun, and wait for what has."""
        self._thread.shutdown(cancel_futures=True)
        self._new, self._waiting = [], []
