# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A stream of items that another process produces while this one consumes them."""
from __future__ import annotations

from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from multiprocessing.queues import Queue
import queue
from typing import Any, Callable, Iterable, Iterator, TypeVar

import cv2

from ...core.threads import one_blas_thread

Item = TypeVar('Item')
WAITING = 8  # greatest number of items in the queue
_ALIVE_S = 5.0  # interval of the checks of the other process while nothing arrives


def produced(make: Callable[..., Iterable[Item]], *arguments: object) -> Iterator[Item]:
    """
    Yield the items of an iterable that another process produces.

    :param make: a module-level function, called in that process.
    :param arguments: its arguments.
    :raises Exception: the exception that was raised there.
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
        process.kill()  # children of a process that ignores SIGTERM ignore it, too
        process.join()


def _next(items: Queue[Any], process: BaseProcess) -> Any:
    """Return the next item; raise when the process has ended."""
    while True:
        try:
            return items.get(timeout=_ALIVE_S)
        except queue.Empty:
            if not process.is_alive() and items.empty():
                raise RuntimeError(f'the producing process ended with exit code '
                                   f'{process.exitcode}') from None


def _produce(items: Queue[Any], make: Callable[..., Iterable[Any]],
             arguments: tuple[object, ...]) -> None:
    """Run in the other process: send the items, then None or an exception."""
    cv2.setNumThreads(1)
    try:
        for item in make(*arguments):
            items.put(item)
        items.put(None)
    except Exception as error:  # it is raised in the other process
        items.put(error)
