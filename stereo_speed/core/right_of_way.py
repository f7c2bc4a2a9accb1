# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A thread that others must not wait for, and that gives way to them.

Threads of Python run in turns, each for as long as it likes or some milliseconds.  One that has
time stops at the points that it is known to pass often while another one is in a hurry, which
then has the interpreter for itself.
"""
from __future__ import annotations

from contextlib import contextmanager
import threading
from typing import Iterator

_of_thread = threading.local()


class RightOfWay:
    """
    Held by who is in a hurry; threads that are told of it wait meanwhile.

    :param most_s: that is waited for at one point, whatever becomes of who holds it.
    """

    def __init__(self, most_s: float = 0.1) -> None:
        self._most_s, self._free = most_s, threading.Event()
        self._free.set()

    def give(self) -> None:
        """Have this thread give way from now on, wherever it calls :func:`give_way`."""
        _of_thread.way = self

    def wait(self) -> None:
        """Wait until nobody holds it."""
        self._free.wait(self._most_s)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold it; one thread does at a time."""
        self._free.clear()
        try:
            yield
        finally:
            self._free.set()


def give_way() -> None:
    """Wait while who is in a hurry holds the right of way, if this thread is to give way."""
    way = getattr(_of_thread, 'way', None)
    if way is not None:
        way.wait()
