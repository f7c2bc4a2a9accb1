# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Evenly spaced items of sequences and of streams."""
from __future__ import annotations

from typing import Generic, Sequence, TypeVar

import numpy as np

Item = TypeVar('Item')


def evenly(items: Sequence[Item], count: int) -> list[Item]:
    """Return at most ``count`` items, evenly spaced, including the first and the last."""
    chosen = np.linspace(0, len(items) - 1, min(count, len(items)))
    return [items[i] for i in np.round(chosen).astype(int)]


class EvenSampler(Generic[Item]):
    """
    Keeps evenly spaced items of a stream of unknown length, in bounded memory.

    :param count: number of items wanted; at most twice as many are kept.
    """

    def __init__(self, count: int) -> None:
        self._count, self._step, self._seen = count, 1, 0
        self.kept: list[Item] = []

    def wants(self) -> bool:
        """Return whether to keep the next item; call it once per item."""
        self._seen += 1
        return (self._seen - 1) % self._step == 0

    def add(self, item: Item) -> None:
        """Keep an item; beyond twice the count, drop every other one and double the step."""
        self.kept.append(item)
        if len(self.kept) > 2 * self._count:
            self.kept, self._step = self.kept[::2], 2 * self._step

    def items(self) -> list[Item]:
        """Return at most ``count`` of the kept items, including the first and the last."""
        return evenly(self.kept, self._count)
