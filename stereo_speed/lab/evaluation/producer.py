# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A stream of items that another process makes while this one uses them."""
from __future__ import annotations

from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from multiprocessing.queues import Queue
import queue
from typing import Any, Callable, Iterable, Iterator, TypeVar

import cv2

from ...core.threads import one_blas_thread

Item = TypeVar('Item')
WAITING = 8  # items made and not yet used, at most
_ALIVE_S = 5.0  # so often the other process is checked while nothing comes


def produced(make: Callable[..., Iterable[Item]], *arguments: object) -> Iterator[Item]:
    """
    Yield the items of an iterable that another process makes.

    :param make: a function of a module, called there.
    :param arguments: what it is called with.
    :raises Exception: what went wrong there.
    """
    one_blas_thread()
    context = get_context('spawn')
    items: Queue[Any] = context.Queue(WAITING)
    process = context.Process(target=_produce, args=(items, make, arguments), daemon=True)
    process.start()
    try:
        while (found := _next(items, process)) is not None:
            if isinstance(found, Exception):
                raise found
            yield found
    finally:
        process.terminate()
        process.join(_ALIVE_S)
        process.kill()  # one that was started by who ignores SIGTERM does so, too
        process.join()


def _next(items: Queue[Any], process: BaseProcess) -> Any:
    """Return the next item, as long as there is a process to send it."""
    while True:
        try:
            return items.get(timeout=_ALIVE_S)
        except queue.Empty:
            if not process.is_alive() and items.empty():
                raise RuntimeError(f'the producing process ended with exit code '
                                   f'{process.exitcode}') from None


def _produce(items: Queue[Any], make: Callable[..., Iterable[Any]],
             arguments: tuple[object, ...]) -> None:
    """Run in a process of its own: items go out, then None, or what went wrong."""
    cv2.setNumThreads(1)
    try:
        for item in make(*arguments):
            items.put(item)
        items.put(None)
    except Exception as error:  # it is raised in the other process
        items.put(error)
