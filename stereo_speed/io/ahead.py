# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Read and decode items in a thread while earlier ones are processed."""
from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import Generator, Iterable, TypeVar

Item = TypeVar('Item')
MOST = 4  # items read ahead: covers a pair that is slow to decode, and needs little memory


def ahead(items: Iterable[Item], most: int = MOST) -> Generator[Item, None, None]:
    """
    Yield items in their order, fetched some ahead by a thread.

    An error is raised after the items before it.  A caller that stops early closes the generator,
    which waits for the reads in progress; then the source may be closed.

    :param items: the items; only the thread iterates over them.
    :param most: number of items fetched ahead.
    """
    iterator, end = iter(items), object()
    with ThreadPoolExecutor(1, 'ahead') as thread:
        coming = deque(thread.submit(next, iterator, end) for _ in range(most))
        while (item := coming.popleft().result()) is not end:
            coming.append(thread.submit(next, iterator, end))
            yield item  # type: ignore[misc]
