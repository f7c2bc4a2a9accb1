# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Lets a background thread yield the interpreter to an urgent one.

Python threads take turns, each for up to some milliseconds.  A background thread calls
:func:`give_way` at points that it passes often, and waits there while an urgent thread holds the
right of way, so that this one has the interpreter for itself.
"""
from __future__ import annotations

from contextlib import contextmanager
import threading
from typing import Iterator

_of_thread = threading.local()


class RightOfWay:
    """
    Held by an urgent thread; threads that called :meth:`give` wait meanwhile.

    :param most_s: longest wait at one point, s, even if the holder never releases it.
    """

    def __init__(self, most_s: float = 0.1) -> None:
        self._most_s, self._free = most_s, threading.Event()
        self._free.set()

    def give(self) -> None:
        """Make the calling thread give way from now on, wherever it calls :func:`give_way`."""
        _of_thread.way = self

    def wait(self) -> None:
        """Wait until no thread holds it, or the longest wait is over."""
        self._free.wait(self._most_s)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold it; only one thread may at a time."""
        self._free.clear()
        try:
            yield
        finally:
            self._free.set()


def give_way() -> None:
    """Wait while an urgent thread holds the right of way, if this thread is to give way."""
    way = getattr(_of_thread, 'way', None)
    if way is not None:
        way.wait()
