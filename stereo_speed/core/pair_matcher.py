# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs the images of two cameras by their header stamps, in integer nanoseconds."""
from __future__ import annotations

from collections import deque
import heapq
from typing import Any, Optional, Sequence

import numpy as np

LEFT, RIGHT = 0, 1
MAX_TOLERANCE_NS = 5_000_000  # the time in which a car at 30 m/s moves 0.15 m

Match = tuple[int, Any, int, Any]  # left stamp, left item, right stamp, right item


class PairMatcher:
    """
    Matches left and right items by stamp, either exactly or the nearest within a tolerance.

    Each item is used once and pairs are returned in time order. The stamps of one side must rise:
    an item that is not newer than the last of its side is left out and counted as unpaired
    (call :meth:`reset` when time itself jumps back). A pair is returned as soon as no later
    item could be nearer: at once for equal stamps, otherwise when the gap is below half the
    smallest interval seen on the earlier item's side, or when the next item has arrived.

    :param tolerance_ns: largest gap between the stamps of a pair, ns; 0 requires equal stamps.
    :param queue_size: number of unpaired items kept per side; the oldest is dropped first.
    """

    def __init__(self, tolerance_ns: int = 0, queue_size: int = 10) -> None:
        if tolerance_ns < 0 or queue_size < 1:
            raise ValueError(f'tolerance_ns must be >= 0 and queue_size >= 1, '
                             f'got {tolerance_ns} and {queue_size}')
        self.tolerance_ns, self.queue_size = tolerance_ns, queue_size
        self.reset()

    def reset(self) -> None:
        """Forget all items and counts."""
        self._queues: tuple[deque[tuple[int, Any]], ...] = (deque(), deque())
        self._last: list[Optional[int]] = [None, None]
        self._spacing: list[Optional[int]] = [None, None]
        self._unpaired = [0, 0]

    @property
    def unpaired_left(self) -> int:
        """Return the number of left items dropped; items still waiting are not counted."""
        return self._unpaired[LEFT]

    @property
    def unpaired_right(self) -> int:
        """Return the number of right items dropped; items still waiting are not counted."""
        return self._unpaired[RIGHT]

    def add_left(self, stamp_ns: int, item: Any) -> list[Match]:
        """Add a left item and return the pairs that are now certain."""
        return self._add(LEFT, stamp_ns, item)

    def add_right(self, stamp_ns: int, item: Any) -> list[Match]:
        """Add a right item and return the pairs that are now certain."""
        return self._add(RIGHT, stamp_ns, item)

    def flush(self) -> list[Match]:
        """Return the pairs still undecided, as no more items will come, and drop the rest."""
        matches = self._settle(final=True)
        for side in (LEFT, RIGHT):
            self._unpaired[side] += len(self._queues[side])
            self._queues[side].clear()
        return matches

    def _add(self, side: int, stamp_ns: int, item: Any) -> list[Match]:
        last = self._last[side]
        if last is not None:
            if stamp_ns <= last:
                self._unpaired[side] += 1
                return []
            spacing = self._spacing[side]
            step = stamp_ns - last
            self._spacing[side] = step if spacing is None else min(spacing, step)
        self._last[side] = stamp_ns
        self._queues[side].append((stamp_ns, item))
        matches = self._settle(final=False)
        if len(self._queues[side]) > self.queue_size:
            self._drop(side)
        return matches

    def _drop(self, side: int) -> None:
        self._queues[side].popleft()
        self._unpaired[side] += 1

    def _settle(self, final: bool) -> list[Match]:
        """Return the pairs at the heads of both queues that are certain."""
        left, right = self._queues
        matches: list[Match] = []
        while left and right:
            early = LEFT if left[0][0] <= right[0][0] else RIGHT
            queue, late_ns = self._queues[early], self._queues[1 - early][0][0]
            gap = late_ns - queue[0][0]
            if gap > self.tolerance_ns:
                self._drop(early)  # stamps rise, so no nearer item can come
            elif len(queue) > 1 and abs(queue[1][0] - late_ns) < gap:
                self._drop(early)  # the next item of its side is nearer
            elif len(queue) > 1 or final or self._certain(early, gap):
                matches.append((*left.popleft(), *right.popleft()))
            else:
                break
        return matches

    def _certain(self, early: int, gap: int) -> bool:
        """Return whether the next item of the early side must be farther away than ``gap``."""
        spacing = self._spacing[early]
        return gap == 0 or (spacing is not None and 2 * gap < spacing)


def choose_tolerance_ns(left_ns: Sequence[int], right_ns: Sequence[int]) -> int:
    """
    Return the tolerance by which to pair two recorded streams, from their stamps alone.

    It is 0, for exact matching, when at least half of the images of the side with fewer have an
    equal stamp on the other side; otherwise a quarter of the median frame interval, 5 ms at most.

    :param left_ns: stamps of the left images, rising, ns.
    :param right_ns: stamps of the right images, rising, ns.
    """
    equal = len(set(left_ns) & set(right_ns))
    if 2 * equal >= min(len(set(left_ns)), len(set(right_ns))):
        return 0
    steps = [int(np.median(np.diff(np.asarray(stamps, dtype=np.int64))))
             for stamps in (left_ns, right_ns) if len(stamps) > 1]
    return min([MAX_TOLERANCE_NS] + [step // 4 for step in steps])


def plan_pairs(left_ns: Sequence[int], right_ns: Sequence[int], tolerance_ns: int
               ) -> tuple[list[tuple[int, int]], int, int]:
    """
    Pair two recorded streams whose stamps are all known.

    :param left_ns: stamps of the left images, rising, ns.
    :param right_ns: stamps of the right images, rising, ns.
    :param tolerance_ns: see :class:`PairMatcher`.
    :return: the indices (left, right) of each pair, and the numbers of unpaired left and right
        images.
    """
    matcher = PairMatcher(tolerance_ns, queue_size=len(left_ns) + len(right_ns) + 1)
    matches: list[Match] = []
    both = heapq.merge(((stamp, LEFT, i) for i, stamp in enumerate(left_ns)),
                       ((stamp, RIGHT, i) for i, stamp in enumerate(right_ns)))
    for stamp, side, i in both:
        add = matcher.add_left if side == LEFT else matcher.add_right
        matches += add(stamp, i)
    matches += matcher.flush()
    pairs = [(left, right) for _, left, _, right in matches]
    return pairs, matcher.unpaired_left, matcher.unpaired_right
