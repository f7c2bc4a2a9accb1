# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Image pyramids, sampled at the level that suits the spacing of the samples."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..records import Array, StereoPair

Patches = NDArray[np.float32]

LEVELS = 4
_MAX_ROWS = 1 << 14  # cv2.remap takes maps of fewer than 32768 rows


@dataclass(frozen=True, eq=False)
class View:
    """
    One image at full, half, quarter and eighth size.

    :param levels: float32 grey images, the first of full size.
    """

    levels: tuple[Patches, ...]

    @classmethod
    def of(cls, image: NDArray[Any]) -> View:
        """Build the pyramid of an image."""
        levels = [image.astype(np.float32)]
        for _ in range(LEVELS - 1):
            levels.append(cv2.pyrDown(levels[-1]))
        return cls(tuple(levels))

    def sample(self, uv_px: NDArray[np.float32], level: int) -> Patches:
        """
        Sample one level; what lies outside repeats the border.

        :param uv_px: (..., W, 2) full-size pixels, finite.
        """
        flat = uv_px.reshape(-1, *uv_px.shape[-2:])
        if level:
            flat = ((flat + 0.5) / 2 ** level - 0.5).astype(np.float32)
        out = np.empty(flat.shape[:2], np.float32)
        for k in range(0, len(flat), _MAX_ROWS):
            out[k:k + _MAX_ROWS] = cv2.remap(
                self.levels[level], np.ascontiguousarray(flat[k:k + _MAX_ROWS]), None,
                cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return out.reshape(uv_px.shape[:-1])


@dataclass(frozen=True, eq=False)
class PairViews:
    """
    Both views of a pair.

    :param stamp_ns: of the left image.
    :param right_lag_s: from the left to the right stamp.
    :param left: left view.
    :param right: right view.
    """

    stamp_ns: int
    right_lag_s: float
    left: View
    right: View

    @classmethod
    def of(cls, pair: StereoPair) -> PairViews:
        """Build both pyramids of a pair."""
        return cls(pair.stamp_ns, (pair.right_stamp_ns - pair.stamp_ns) * 1e-9,
                   View.of(pair.left), View.of(pair.right))


def level_of(step_px: Array) -> NDArray[np.int64]:
    """Give the level whose pixels are the next finer than steps (...,) of full-size pixels."""
    with np.errstate(invalid='ignore'):
        levels = np.floor(np.log2(np.maximum(np.nan_to_num(step_px, nan=1.0), 1.0)))
    return np.clip(levels, 0, LEVELS - 1).astype(np.int64)
