# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A pair whose images lie in memory shared by two processes; see ``helper_process``."""
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
    Description of a pair whose images lie in shared memory, the right one after the left one.

    :param index: index of the pair.
    :param stamp_ns: stamp of the left image, ns.
    :param right_stamp_ns: stamp of the right image, ns.
    :param motion: rotation of the rig.
    :param blur_px2: difference of the blur of its views, px^2.
    :param shape: shape of each image.
    :param dtype: type of both images, as a string.
    :param begin: offset of the left image in the memory, bytes.
    """

    index: int
    stamp_ns: int
    right_stamp_ns: int
    motion: Optional[RigMotion]
    blur_px2: float
    shape: tuple[int, ...]
    dtype: str
    begin: int

    @classmethod
    def of(cls, pair: StereoPair, begin: int = 0) -> SharedPair:
        """
        Return the description of a pair.

        :param begin: offset that its left image is to have in the memory, bytes.
        """
        return cls(pair.index, pair.stamp_ns, pair.right_stamp_ns, pair.motion, pair.blur_px2,
                   pair.left.shape, pair.left.dtype.str, begin)

    @property
    def end(self) -> int:
        """Return the offset of the end of the right image, bytes."""
        return self.begin + 2 * math.prod(self.shape) * np.dtype(self.dtype).itemsize

    def _images(self, memory: mmap) -> np.ndarray[Any, Any]:
        """Return both images (2, ...) as a view of the memory."""
        return np.ndarray((2, *self.shape), self.dtype, memory, self.begin)

    def lay(self, pair: StereoPair, memory: mmap) -> None:
        """Copy the images of the pair into the memory."""
        images = self._images(memory)
        images[0], images[1] = pair.left, pair.right

    def pair(self, memory: mmap) -> StereoPair:
        """Return the pair; its images are views of the memory and valid until that is reused."""
        left, right = self._images(memory)
        return StereoPair(self.index, self.stamp_ns, self.right_stamp_ns, left, right,
                          motion=self.motion, blur_px2=self.blur_px2)
