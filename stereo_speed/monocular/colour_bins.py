# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Frames as numbers of colour bins, looked up in boxes by all targets."""
from __future__ import annotations

from typing import NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray

from .background_model import Background
from ..core.records import Array

BINS = 16  # of each channel
BACKGROUND = BINS ** 3  # a colour of its own
MARK_SAMPLES = (40, 60)  # across and down the marked box
_SHIFT = 4  # 256 levels to BINS
_RING = (1.15, 1.3)  # sizes of the frames around the box that are its surroundings
_RING_SAMPLES = 12  # along each side


class Boxes(NamedTuple):
    """
    Boxes to look at.

    :param centre_px: (N, 2).
    :param size_px: (N, 2).
    :param angle_rad: (N,), or None where all are upright.
    """

    centre_px: Array
    size_px: Array
    angle_rad: Optional[Array]


class Grid(NamedTuple):
    """
    Points in shares of a box, its centre at (0, 0) and its edges at 0.5.

    :param x: (C,).
    :param y: (R,); the grid has every x with every y, row by row. None pairs each x with the y
        of the same number in ``paired_y``.
    :param paired_y: (C,) or None.
    """

    x: Array
    y: Optional[Array]
    paired_y: Optional[Array] = None


class Samples(NamedTuple):
    """
    Points of boxes, looked up.

    :param bins: (N, M) numbers of their colour bins.
    :param outside: (N, M) whether they are outside the image; None where none is.
    :param covered: (N, M) whether a target is there that hides what is behind; None where none
        is.
    """

    bins: NDArray[np.uint16]
    outside: Optional[NDArray[np.bool_]]
    covered: Optional[NDArray[np.bool_]]

    @property
    def unseen(self) -> Optional[NDArray[np.bool_]]:
        """Tell which points are outside or covered; None where none is."""
        if self.outside is None or self.covered is None:
            return self.covered if self.outside is None else self.outside
        return self.outside | self.covered


class BinImage:
    """
    A frame whose pixels are numbers of colour bins; looked up by all targets.

    Bins are made where they are asked for only.

    :param image: (H, W, 3) uint8, BGR.
    :param background: tells which pixels are no target's: these have a colour of their own. None
        where all may be a target's.
    """

    def __init__(self, image: NDArray[np.uint8],
                 background: Optional[Background] = None) -> None:
        self.image, self.background = image, background
        self.height, self.width = image.shape[:2]
        self._bins = np.empty((self.height, self.width), dtype=np.uint16)
        self._made: list[tuple[int, int, int, int]] = []
        self._cover: Optional[NDArray[np.bool_]] = None

    def cover(self, box_px: Array) -> None:
        """
        Let what stands out in an upright box hide, from now on, what is behind it.

        :param box_px: (4,).
        """
        if self._cover is None:
            self._cover = np.zeros((self.height, self.width), dtype=bool)
        left, top = np.maximum(np.rint(box_px[:2]), 0).astype(int)
        right, bottom = np.maximum(np.rint(box_px[:2] + box_px[2:]), 0).astype(int)
        self._cover[top:bottom, left:right] = True

    def background_share(self, mark: Boxes) -> float:
        """Give the share of a box, one, that looks as the background does: 0 to 1."""
        look = self.sample(mark, grid_points(*MARK_SAMPLES))
        inside = look.bins if look.outside is None else look.bins[~look.outside]
        return float(np.mean(inside == BACKGROUND)) if inside.size else 0.0

    def background_changed(self) -> None:
        """Make the bins anew where they are asked for next."""
        self._made.clear()

    def sample(self, boxes: Boxes, grid: Grid) -> Samples:
        """Look up points of boxes, nearest pixel."""
        column, row = self._pixels(boxes, grid)
        left, right = int(column.min()), int(column.max())
        top, bottom = int(row.min()), int(row.max())
        if left >= 0 and top >= 0 and right < self.width and bottom < self.height:
            self._make(left, top, right + 1, bottom + 1)
            return self._samples(column, row, None)
        outside = (column < 0) | (row < 0) | (column >= self.width) | (row >= self.height)
        column, row = column.clip(0, self.width - 1), row.clip(0, self.height - 1)
        self._make(int(column.min()), int(row.min()), int(column.max()) + 1, int(row.max()) + 1)
        return self._samples(column, row, outside)

    def _samples(self, column: NDArray[np.int32], row: NDArray[np.int32],
                 outside: Optional[NDArray[np.bool_]]) -> Samples:
        """Look up pixels, whose bins are made."""
        index = row * self.width + column
        bins = self._bins.ravel()[index]
        covered = None
        if self._cover is not None:
            covered = self._cover.ravel()[index]
            # where the background is seen nothing is in front of it
            covered = covered & (bins != BACKGROUND) if covered.any() else None
        return Samples(bins, outside, covered)

    def _pixels(self, boxes: Boxes, grid: Grid) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Give the column and row (N, M) of each point of each box."""
        x = grid.x[None] * boxes.size_px[:, :1]
        y = (grid.paired_y if grid.y is None else grid.y)[None] * boxes.size_px[:, 1:]
        if boxes.angle_rad is None:  # the columns are the same in every row
            column = np.floor(x + (boxes.centre_px[:, :1] + 0.5)).astype(np.int32)
            row = np.floor(y + (boxes.centre_px[:, 1:] + 0.5)).astype(np.int32)
            if grid.y is None:
                return column, row
            shape = (len(x), len(grid.y), len(grid.x))
            return (np.broadcast_to(column[:, None], shape).reshape(len(x), -1),
                    np.broadcast_to(row[:, :, None], shape).reshape(len(x), -1))
        if grid.y is not None:
            x, y = np.tile(x, (1, y.shape[1])), np.repeat(y, x.shape[1], axis=1)
        c, s = np.cos(boxes.angle_rad)[:, None], np.sin(boxes.angle_rad)[:, None]
        column = np.floor(c * x - s * y + (boxes.centre_px[:, :1] + 0.5)).astype(np.int32)
        return column, np.floor(s * x + c * y + (boxes.centre_px[:, 1:] + 0.5)).astype(np.int32)

    def _make(self, left: int, top: int, right: int, bottom: int) -> None:
        """Make the bins of a rectangle, if they are not there yet."""
        for a, b, c, d in self._made:
            if a <= left and b <= top and c >= right and d >= bottom:
                return
        part = self.image[top:bottom, left:right]
        # the upper four bits of each channel, beside one another
        bins = (part[..., 2] & 0xf0).astype(np.uint16) << 4
        bins |= part[..., 1] & 0xf0
        bins |= part[..., 0] >> _SHIFT
        if self.background is not None:
            bins[~self.background.foreground(self.image, left, top, right, bottom)] = BACKGROUND
        self._bins[top:bottom, left:right] = bins
        self._made.append((left, top, right, bottom))


def grid_points(across: int, down: int) -> Grid:
    """Give a regular grid of points."""
    return Grid((np.arange(across) + 0.5) / across - 0.5, (np.arange(down) + 0.5) / down - 0.5)


def ring_points() -> Grid:
    """Give points around a box."""
    along = (np.arange(_RING_SAMPLES) + 0.5) / _RING_SAMPLES - 0.5
    x, y = [], []
    for size in _RING:
        edge = np.full(_RING_SAMPLES, size / 2)
        x += [size * along, size * along, -edge, edge]
        y += [-edge, edge, size * along, size * along]
    return Grid(np.concatenate(x), None, np.concatenate(y))
