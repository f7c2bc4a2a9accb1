# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What a fixed camera sees where nothing moves, learnt as the frames come.

The paper takes the environment as static (2010, Section III.B). So it looks the same in every
frame, and a pixel that looks like it is none of a target. The background is a running mean of
each pixel, at half the resolution, over the frames in which no target is there.
"""
from __future__ import annotations

from typing import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from .boxes import TargetEstimate
from ..core.records import Array

_STEP = 2  # pixels of the image to one of the background, each way
_BANDS = 4  # every fourth row is learnt in a frame,
_NEAR = 1.0  # and all this near to a target, as a share of its box
_MARGIN = 0.1  # about a target's box, as a share of it, where nothing is learnt


class Background:
    """
    The background of a video and what stands out from it.

    :param width: of the frames, px.
    :param height: of the frames, px.
    :param contrast: levels of any channel by which a foreground pixel differs at least.
    :param frames: frames that the running mean spans.
    """

    def __init__(self, width: int, height: int, contrast: float, frames: float) -> None:
        self.contrast = contrast
        self._looks = np.float32(max(frames / _BANDS, 1.0))  # at each row
        self._band = -1
        shape = (-(-height // _STEP), -(-width // _STEP))
        self.mean = np.zeros((*shape, 3), np.float32)
        self.seen = np.zeros(shape, np.float32)

    def foreground(self, image: NDArray[np.uint8], left: int, top: int, right: int,
                   bottom: int) -> NDArray[np.bool_]:
        """
        Tell which pixels of a rectangle are not known to be background.

        :param image: (H, W, 3) uint8, BGR.
        :param right: column after its last one; ``bottom`` likewise.
        :return: (bottom - top, right - left); pixels never seen without a target are foreground.
        """
        # a little more, so that the median has neighbours
        rows = slice(max(top // _STEP - 1, 0), -(-bottom // _STEP) + 1)
        columns = slice(max(left // _STEP - 1, 0), -(-right // _STEP) + 1)
        here = np.ascontiguousarray(image[::_STEP, ::_STEP][rows, columns])
        off = cv2.split(cv2.absdiff(here, cv2.convertScaleAbs(
            np.ascontiguousarray(self.mean[rows, columns]))))
        most = cv2.max(cv2.max(off[0], off[1]), off[2])
        mask = (most > self.contrast) | (self.seen[rows, columns] == 0)
        mask = cv2.medianBlur(mask.view(np.uint8), 3)
        large = np.repeat(np.repeat(mask, _STEP, axis=0), _STEP, axis=1)
        y, x = top - _STEP * rows.start, left - _STEP * columns.start
        return np.asarray(large[y:y + bottom - top, x:x + right - left].view(np.bool_))

    def known(self, box_px: Array, but_px: Array, looks: int) -> float:
        """
        Tell the share of a box whose background was seen without a target.

        :param box_px: (4,).
        :param but_px: (4,) a box in which nothing counts.
        :param looks: least number of looks at a place.
        :return: 0 to 1; 1 for a box outside the image.
        """
        x, y, w, h = box_px / _STEP
        rows, columns = _span(y, h, 0.0), _span(x, w, 0.0)
        known = self.seen[rows, columns] >= looks
        x, y, w, h = but_px / _STEP
        hidden, across = _span(y, h, _MARGIN), _span(x, w, _MARGIN)
        known[max(hidden.start - rows.start, 0):max(hidden.stop - rows.start, 0),
              max(across.start - columns.start, 0):max(across.stop - columns.start, 0)] = False
        return float(known.mean()) if known.size else 1.0

    def forget(self, box_px: Array) -> None:
        """Take what is in an upright box (4,) as never seen."""
        x, y, w, h = box_px / _STEP
        self.seen[_span(y, h, _MARGIN), _span(x, w, _MARGIN)] = 0

    def learn(self, image: NDArray[np.uint8], targets: Iterable[TargetEstimate]) -> None:
        """Average a frame in, but for the boxes of the targets."""
        free = np.ones(self.seen.shape, np.float32)
        near = []
        for target in targets:
            x, y, w, h = target.envelope_px / _STEP
            free[_span(y, h, _MARGIN), _span(x, w, _MARGIN)] = 0
            near.append((_span(y, h, _NEAR), _span(x, w, _NEAR)))
        small = image[::_STEP, ::_STEP]
        # elsewhere a band at a time is enough, once there is a first look
        bands = slice(self._band, None, _BANDS) if self._band >= 0 else slice(None)
        self._band = (self._band + 1) % _BANDS
        for here in [(bands, slice(None)), *near]:
            self.seen[here] += free[here]
            share = free[here] / np.clip(self.seen[here], 1.0, self._looks)
            self.mean[here] += share[..., None] * (small[here] - self.mean[here])


def _span(first: float, size: float, margin: float) -> slice:
    """Give the cells of a side of a box, widened by a share of it."""
    return slice(max(int(first - margin * size), 0),
                 max(int(np.ceil(first + (1 + margin) * size)), 0))
