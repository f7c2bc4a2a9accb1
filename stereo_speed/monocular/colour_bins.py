# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Colour bins of a frame's pixels, sampled in the boxes of all targets."""
from __future__ import annotations

from typing import NamedTuple, Optional, Union

import numpy as np
from numpy.typing import NDArray

from .background_model import BackgroundModel
from ..core.records import Array

BINS = 16  # of each channel, as in the paper
BACKGROUND = BINS ** 3  # the bin of pixels that look like the background
ALL_BINS = BACKGROUND + 1  # number of bins, including the background's
INITIAL_SAMPLES = (40, 60)  # across and down; fine, because the initial box is sampled once
_SHIFT = 4  # bits to shift, from 256 levels to BINS
_RING = (1.15, 1.3)  # sizes of two rectangles around the box, as shares of its size
_RING_SAMPLES = 12  # samples along each side of each rectangle


class Boxes(NamedTuple):
    """
    Boxes to sample.

    :param centre_px: (N, 2), centres.
    :param size_px: (N, 2), widths and heights.
    :param angle_rad: (N,), angles, or None where all are upright.
    """

    centre_px: Array
    size_px: Array
    angle_rad: Optional[Array]

    @classmethod
    def one(cls, box_px: Array, angle_rad: float, upright: bool) -> Boxes:
        """Return a single box, given as (4,) x, y, w, h and its angle."""
        return cls(box_px[None, :2] + box_px[None, 2:] / 2, box_px[None, 2:],
                   None if upright else np.array([angle_rad]))


class Points(NamedTuple):
    """
    Points as shares of a box, whose centre is (0, 0) and whose edges are at 0.5.

    :param x: (M,).
    :param y: (M,).
    """

    x: Array
    y: Array


class Grid(NamedTuple):
    """
    A grid of points as shares of a box: every x with every y, row by row.

    :param x: (C,).
    :param y: (R,).
    """

    x: Array
    y: Array

    @property
    def points(self) -> Points:
        """Return the points of the grid as a list."""
        return Points(np.tile(self.x, len(self.y)), np.repeat(self.y, len(self.x)))


class Samples(NamedTuple):
    """
    The pixels at the points of boxes.

    :param bins: (N, M), indices of their colour bins.
    :param outside: (N, M), whether they are outside the image; None where none is.
    :param occluded: (N, M), whether they show an occluding target; None where none does.
    """

    bins: NDArray[np.uint16]
    outside: Optional[NDArray[np.bool_]]
    occluded: Optional[NDArray[np.bool_]]

    @property
    def unseen(self) -> Optional[NDArray[np.bool_]]:
        """Return which points are outside or occluded; None where none is."""
        if self.outside is None or self.occluded is None:
            return self.occluded if self.outside is None else self.outside
        return self.outside | self.occluded


class BinImage:
    """
    A frame as colour bins, sampled by all targets.

    Bins are computed only where they are needed.

    :param image: (H, W, 3) uint8, BGR.
    :param background: model of the background, whose pixels belong to no target and have their
        own bin; None where all pixels may belong to a target.
    """

    def __init__(self, image: NDArray[np.uint8],
                 background: Optional[BackgroundModel] = None) -> None:
        self.image, self.background = image, background
        self.height, self.width = image.shape[:2]
        self._bins = np.empty((self.height, self.width), dtype=np.uint16)
        self._computed: list[tuple[int, int, int, int]] = []
        self._occluders: Optional[NDArray[np.bool_]] = None

    def occlude(self, box_px: Array) -> None:
        """
        Mark the foreground in an upright box as occluding, for all later samples.

        :param box_px: (4,).
        """
        if self._occluders is None:
            self._occluders = np.zeros((self.height, self.width), dtype=bool)
        left, top = np.maximum(np.rint(box_px[:2]), 0).astype(int)
        right, bottom = np.maximum(np.rint(box_px[:2] + box_px[2:]), 0).astype(int)
        self._occluders[top:bottom, left:right] = True

    def background_share(self, box: Boxes) -> float:
        """Return the share of a single box that looks like the background, 0 to 1."""
        samples = self.sample(box, grid_points(*INITIAL_SAMPLES))
        inside = samples.bins if samples.outside is None else samples.bins[~samples.outside]
        return float(np.mean(inside == BACKGROUND)) if inside.size else 0.0

    def background_changed(self) -> None:
        """Discard the bins, so that they are recomputed with the current background."""
        self._computed.clear()

    def sample(self, boxes: Boxes, at: Union[Grid, Points]) -> Samples:
        """Look up the pixels nearest to points of boxes."""
        column, row = _pixels(boxes, at)
        left, right = int(column.min()), int(column.max())
        top, bottom = int(row.min()), int(row.max())
        if left >= 0 and top >= 0 and right < self.width and bottom < self.height:
            self._compute(left, top, right + 1, bottom + 1)
            return self._samples(column, row, None)
        outside = (column < 0) | (row < 0) | (column >= self.width) | (row >= self.height)
        column, row = column.clip(0, self.width - 1), row.clip(0, self.height - 1)
        self._compute(int(column.min()), int(row.min()), int(column.max()) + 1,
                      int(row.max()) + 1)
        return self._samples(column, row, outside)

    def _samples(self, column: NDArray[np.int32], row: NDArray[np.int32],
                 outside: Optional[NDArray[np.bool_]]) -> Samples:
        """Look up pixels whose bins are computed."""
        index = row * self.width + column
        bins = self._bins.ravel()[index]
        occluded = None
        if self._occluders is not None:
            occluded = self._occluders.ravel()[index]
            # where the background is visible, nothing occludes it
            occluded = occluded & (bins != BACKGROUND) if occluded.any() else None
        return Samples(bins, outside, occluded)

    def _compute(self, left: int, top: int, right: int, bottom: int) -> None:
        """Compute the bins of a rectangle unless they are already computed."""
        for a, b, c, d in self._computed:
            if a <= left and b <= top and c >= right and d >= bottom:
                return
        part = self.image[top:bottom, left:right]
        # concatenate the upper four bits of each channel
        bins = (part[..., 2] & 0xf0).astype(np.uint16) << 4
        bins |= part[..., 1] & 0xf0
        bins |= part[..., 0] >> _SHIFT
        if self.background is not None:
            bins[~self.background.foreground(self.image, left, top, right, bottom)] = BACKGROUND
        self._bins[top:bottom, left:right] = bins
        self._computed.append((left, top, right, bottom))


def _pixels(boxes: Boxes, at: Union[Grid, Points]
            ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the column and row (N, M) of the pixel nearest to each point of each box."""
    if boxes.angle_rad is not None:
        points = at.points if isinstance(at, Grid) else at
        x, y = points.x[None] * boxes.size_px[:, :1], points.y[None] * boxes.size_px[:, 1:]
        c, s = np.cos(boxes.angle_rad)[:, None], np.sin(boxes.angle_rad)[:, None]
        return (_nearest(c * x - s * y, boxes.centre_px[:, :1]),
                _nearest(s * x + c * y, boxes.centre_px[:, 1:]))
    column = _nearest(at.x[None] * boxes.size_px[:, :1], boxes.centre_px[:, :1])
    row = _nearest(at.y[None] * boxes.size_px[:, 1:], boxes.centre_px[:, 1:])
    if isinstance(at, Points):
        return column, row
    # the columns are the same in every row of the grid
    shape = (len(column), len(at.y), len(at.x))
    return (np.broadcast_to(column[:, None], shape).reshape(len(column), -1),
            np.broadcast_to(row[:, :, None], shape).reshape(len(column), -1))


def _nearest(offset_px: Array, centre_px: Array) -> NDArray[np.int32]:
    """Return the indices (N, M) of the pixels nearest to offsets from centres (N, 1)."""
    return np.floor(offset_px + (centre_px + 0.5)).astype(np.int32)


def grid_points(across: int, down: int) -> Grid:
    """Return a regular grid of points."""
    return Grid((np.arange(across) + 0.5) / across - 0.5, (np.arange(down) + 0.5) / down - 0.5)


def ring_points() -> Points:
    """Return points on the rectangles around a box."""
    along = (np.arange(_RING_SAMPLES) + 0.5) / _RING_SAMPLES - 0.5
    x, y = [], []
    for size in _RING:
        edge = np.full(_RING_SAMPLES, size / 2)
        x += [size * along, size * along, -edge, edge]
        y += [-edge, edge, size * along, size * along]
    return Points(np.concatenate(x), np.concatenate(y))
