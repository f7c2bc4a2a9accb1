# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The background of a fixed camera, learnt frame by frame.

The paper assumes a static environment (2010, Section III.B). Its appearance is then the same in
every frame, and a pixel that looks like the background belongs to no target. The background is a
running mean of each pixel, at half resolution, over the frames in which no target covers it.
"""
from __future__ import annotations

from typing import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from .boxes import TargetEstimate
from ..core.records import Array

_STEP = 2  # pixels of the image to one cell of the background, each way
_BANDS = 4  # away from targets only every such row is learnt per frame, to save time
_NEAR = 1.0  # margin around a target, as a share of its box, that is learnt in every frame
_MARGIN = 0.1  # a target's box is excluded with this margin, because boxes are not exact


class BackgroundModel:
    """
    The background of a video, and the foreground that differs from it.

    :param width: width of the frames, px.
    :param height: height of the frames, px.
    :param contrast: least difference of a foreground pixel in any channel, grey levels.
    :param frames: frames that the running mean spans.
    """

    def __init__(self, width: int, height: int, contrast: float, frames: float) -> None:
        self.contrast = contrast
        self._span_count = np.float32(max(frames / _BANDS, 1.0))  # updates that the mean spans
        self._band = -1
        shape = (-(-height // _STEP), -(-width // _STEP))
        self.mean = np.zeros((*shape, 3), np.float32)
        self.count = np.zeros(shape, np.float32)  # updates of each cell

    def foreground(self, image: NDArray[np.uint8], left: int, top: int, right: int,
                   bottom: int) -> NDArray[np.bool_]:
        """
        Return a mask of the pixels of a rectangle that are not known to be background.

        :param image: (H, W, 3) uint8, BGR.
        :param right: column after the last one; ``bottom`` likewise for rows.
        :return: (bottom - top, right - left); pixels never seen without a target are foreground.
        """
        # one more cell on each side, for the median filter
        rows = slice(max(top // _STEP - 1, 0), -(-bottom // _STEP) + 1)
        columns = slice(max(left // _STEP - 1, 0), -(-right // _STEP) + 1)
        here = np.ascontiguousarray(image[::_STEP, ::_STEP][rows, columns])
        off = cv2.split(cv2.absdiff(here, cv2.convertScaleAbs(
            np.ascontiguousarray(self.mean[rows, columns]))))
        most = cv2.max(cv2.max(off[0], off[1]), off[2])
        mask = (most > self.contrast) | (self.count[rows, columns] == 0)
        mask = cv2.medianBlur(mask.view(np.uint8), 3)
        large = np.repeat(np.repeat(mask, _STEP, axis=0), _STEP, axis=1)
        y, x = top - _STEP * rows.start, left - _STEP * columns.start
        return np.asarray(large[y:y + bottom - top, x:x + right - left].view(np.bool_))

    def known_share(self, box_px: Array, excluded_px: Array, least_count: int) -> float:
        """
        Return the share of a box whose background is known.

        :param box_px: (4,), the box.
        :param excluded_px: (4,), a box inside which nothing counts as known.
        :param least_count: updates after which a cell is known.
        :return: 0 to 1; 1 for a box outside the image.
        """
        rows, columns = _cells(box_px, 0.0)
        known = self.count[rows, columns] >= least_count
        out_rows, out_columns = _cells(excluded_px, _MARGIN)
        known[max(out_rows.start - rows.start, 0):max(out_rows.stop - rows.start, 0),
              max(out_columns.start - columns.start, 0):
              max(out_columns.stop - columns.start, 0)] = False
        return float(known.mean()) if known.size else 1.0

    def forget(self, box_px: Array) -> None:
        """Discard the background inside an upright box (4,)."""
        self.count[_cells(box_px, _MARGIN)] = 0

    def learn(self, image: NDArray[np.uint8], targets: Iterable[TargetEstimate]) -> None:
        """Include a frame in the mean, except for the boxes of the targets."""
        free = np.ones(self.count.shape, np.float32)
        near = []
        for target in targets:
            free[_cells(target.envelope_px, _MARGIN)] = 0
            near.append(_cells(target.envelope_px, _NEAR))
        small = image[::_STEP, ::_STEP]
        # the first frame is learnt in full
        bands = slice(self._band, None, _BANDS) if self._band >= 0 else slice(None)
        self._band = (self._band + 1) % _BANDS
        for here in [(bands, slice(None)), *near]:
            self.count[here] += free[here]
            share = free[here] / np.clip(self.count[here], 1.0, self._span_count)
            self.mean[here] += share[..., None] * (small[here] - self.mean[here])


def _cells(box_px: Array, margin: float) -> tuple[slice, slice]:
    """Return the rows and columns of cells in a box, widened by a share of it on each side."""
    x, y, w, h = box_px / _STEP
    return _span(y, h, margin), _span(x, w, margin)


def _span(first: float, size: float, margin: float) -> slice:
    """Return the cells along a side of a box, widened by a share of it."""
    return slice(max(int(first - margin * size), 0),
                 max(int(np.ceil(first + (1 + margin) * size)), 0))
