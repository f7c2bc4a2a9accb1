# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reading ahead: what is read and decoded while what was read before is worked on."""
from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from typing import Generator, Iterable, TypeVar

Item = TypeVar('Item')
MOST = 4  # read ahead: enough for a pair that takes long, and little memory


def ahead(items: Iterable[Item], most: int = MOST) -> Generator[Item, None, None]:
    """
    Yield items that a thread of its own fetches some ahead, in their order.

    An error comes after the items before it.  Who stops early closes it, and waits
    for those under way: what they are read from may be closed then.
    """
    iterator, end = iter(items), object()
    with ThreadPoolExecutor(1, 'ahead') as thread:
        coming = deque(thread.submit(next, iterator, end) for _ in range(most))
        while (item := coming.popleft().result()) is not end:
            coming.append(thread.submit(next, iterator, end))
            yield item  # type: ignore[misc]
