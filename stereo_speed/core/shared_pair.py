# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A pair whose images lie in memory that two processes share: see ``helper_process``."""
from __future__ import annotations

from dataclasses import dataclass
import math
from mmap import mmap
from typing import Any, Optional

import numpy as np

from .records import RigMotion, StereoPair


@dataclass(frozen=True, eq=False)
class SharedPair:
    """
    What is told of the pair; its images lie in the memory, one after the other.

    :param index: of the pair.
    :param stamp_ns: of its left image.
    :param right_stamp_ns: of its right image.
    :param motion: how the rig stood.
    :param shape: of each image.
    :param dtype: of both.
    :param begin: of the left image, bytes.
    """

    index: int
    stamp_ns: int
    right_stamp_ns: int
    motion: Optional[RigMotion]
    shape: tuple[int, ...]
    dtype: str
    begin: int

    @classmethod
    def of(cls, pair: StereoPair, begin: int = 0) -> SharedPair:
        """
        Return what is told of a pair.

        :param begin: where its left image is to lie, bytes.
        """
        return cls(pair.index, pair.stamp_ns, pair.right_stamp_ns, pair.motion, pair.left.shape,
                   pair.left.dtype.str, begin)

    @property
    def end(self) -> int:
        """Return where the right image ends, bytes."""
        return self.begin + 2 * math.prod(self.shape) * np.dtype(self.dtype).itemsize

    def _images(self, memory: mmap) -> np.ndarray[Any, Any]:
        """Return both images (2, ...), where they lie."""
        return np.ndarray((2, *self.shape), self.dtype, memory, self.begin)

    def lay(self, pair: StereoPair, memory: mmap) -> None:
        """Lay the images of the pair into the memory."""
        there = self._images(memory)
        there[0], there[1] = pair.left, pair.right

    def pair(self, memory: mmap) -> StereoPair:
        """Return the pair itself; its images are good as long as they lie there."""
        left, right = self._images(memory)
        return StereoPair(self.index, self.stamp_ns, self.right_stamp_ns, left, right,
                          motion=self.motion)
