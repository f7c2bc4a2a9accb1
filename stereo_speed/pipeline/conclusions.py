# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Ways to measure a pass that is over: at once, or beside the pairs that follow.

Measuring a whole pass takes as long as some pairs do.  ``AtOnce`` gives results in the same order
in every run, but live, the readings of other vehicles would have to wait: ``Beside`` measures in
another thread.  Offline, ``Later`` does too and keeps the order, where results of pairs may be
reported a little later.  The error of a pass that cannot be measured is raised where results are
asked for.
"""
from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Callable, Optional, Protocol

from ..core.passes import PassResult

Measure = Callable[[], PassResult]


class OnlyHereError(Exception):
    """A pass cannot be measured in another process, because it cannot be pickled."""


def _nothing() -> None:
    """Do nothing."""


def _here(measure: Measure) -> PassResult:
    """Return the result of a pass."""
    return measure()


class Conclusions(Protocol):
    """Measures passes that are over; each pipeline has its own."""

    def add(self, measure: Measure, failed: Callable[[], object] = _nothing) -> None:
        """
        Take in a pass.

        :param measure: measures the pass, and changes nothing else.
        :param failed: called where ``done`` will not return the pass, perhaps in another thread.
        """

    def done(self, *, everything: bool = False) -> list[PassResult]:
        """
        Return results that were not returned before, in the order in which the passes ended.

        :param everything: whether to wait for those that are not ready.
        """

    def close(self) -> None:
        """Discard passes that are not ready."""


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
        """Discard results that were not returned."""
        self._ready = []


class Beside:
    """
    Measures passes in a thread of its own, one after the other.

    Results are those of :class:`AtOnce`, a few pairs later.  ``waiting`` is the number of passes
    still to come, so that an instrument can wait for them before it closes.

    :param most: number of passes that may wait; adding another one blocks until the first is
        measured, as each holds its images.
    :param failed: called with the error of a pass that could not be measured, which then has no
        result; None to raise the error where results are asked for, and return the other results
        at the next call.
    :param measured: called in that thread to measure a pass, for example in another process.
    """

    def __init__(self, most: int = 8, failed: Optional[Callable[[Exception], object]] = None,
                 measured: Callable[[Measure], PassResult] = _here) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix='passes')
        self._waiting: deque[Future[PassResult]] = deque()
        self._ready: list[PassResult] = []  # kept while a later error is raised
        self._most, self._failed, self._measure = most, failed, measured

    @property
    def waiting(self) -> int:
        """Return the number of passes that were taken in and not yet returned."""
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
        """Cancel passes that have not begun, and wait for the one that has."""
        self._thread.shutdown(cancel_futures=True)
        self._waiting.clear()
        self._ready = []


class Later:
    """
    Measures passes in a thread of its own; the loop that runs the pipeline collects the results.

    The pipeline gets none of them: after each pair, ``pop`` returns those that ended with it.

    :param measured: called in that thread to measure a pass, as in :class:`Beside`.
    :param most: number of passes that may wait, as in :class:`Beside`.
    """

    def __init__(self, measured: Callable[[Measure], PassResult] = _here, most: int = 8) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix='passes')
        self._new: list[Future[PassResult]] = []
        self._waiting: list[Future[PassResult]] = []
        self._measure, self._most = measured, most

    def add(self, measure: Measure, failed: Callable[[], object] = _nothing) -> None:
        """Take in a pass, which the pipeline does not wait for unless too many are waiting."""
        self._waiting = [future for future in self._waiting if not future.done()]
        if len(self._waiting) >= self._most:
            wait(self._waiting[:1])
        self._new.append(self._thread.submit(self._measure, measure))
        self._waiting.append(self._new[-1])
        failed()

    def pop(self) -> list[Future[PassResult]]:
        """Return the futures of the passes that were taken in since the last call."""
        new, self._new = self._new, []
        return new

    def done(self, *, everything: bool = False) -> list[PassResult]:
        """Return the results not popped yet, if all are asked for at the stream's end."""
        return [future.result() for future in self.pop()] if everything else []

    def close(self) -> None:
        """Cancel passes that have not begun, and wait for the one that has."""
        self._thread.shutdown(cancel_futures=True)
        self._new, self._waiting = [], []
