# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The likelihood of a box from its colours (2010, Section IV.D, eq. 23-24).

A joint RGB histogram of 16 bins a channel is compared with that of the marked box by their
Bhattacharyya coefficient. Three departures can be switched on, each from work that the paper
builds on: colours that the surroundings share count less (Comaniciu, Ramesh and Meer 2003, its
[1]); the box is divided into parts (Perez et al. 2002, its [27]); and the reference is renewed
slowly (Zhou, Chellappa and Moghaddam 2004, its [24]). A fourth, the contrast with the
surroundings, is our own: a box that is too small has the target's colours about it.
"""
from __future__ import annotations

from typing import NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray

from .background import Background
from .config import EnvironmentConfig
from ..records import Array

BINS = 16  # of each channel
_SHIFT = 4  # 256 levels to BINS
_BACKGROUND = BINS ** 3  # a colour of its own
_ALL = _BACKGROUND + 1
_RING = (1.15, 1.3)  # sizes of the frames around the box that are its surroundings
_RING_SAMPLES = 12  # along each side
_MARK_SAMPLES = (40, 60)  # across and down the marked box


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

    def sample(self, boxes: Boxes, grid: Grid) -> tuple[NDArray[np.uint16],
                                                        Optional[NDArray[np.bool_]]]:
        """
        Look up points of boxes, nearest pixel.

        :return: (N, M) bins, and whether each point is in the image; None where all are.
        """
        column, row = self._pixels(boxes, grid)
        left, right = int(column.min()), int(column.max())
        top, bottom = int(row.min()), int(row.max())
        if left >= 0 and top >= 0 and right < self.width and bottom < self.height:
            self._make(left, top, right + 1, bottom + 1)
            return self._bins.ravel()[row * self.width + column], None
        inside = (column >= 0) & (row >= 0) & (column < self.width) & (row < self.height)
        column, row = column.clip(0, self.width - 1), row.clip(0, self.height - 1)
        self._make(int(column.min()), int(row.min()), int(column.max()) + 1, int(row.max()) + 1)
        return self._bins.ravel()[row * self.width + column], inside

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
            bins[~self.background.foreground(self.image, left, top, right, bottom)] = _BACKGROUND
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


def similarity(candidate: Array, reference: Array) -> Array:
    """
    Give the Bhattacharyya coefficient: 1 - D_b^2 of eq. 24.

    :param candidate: (..., B) histograms that sum to 1.
    :param reference: (B,) or (..., B).
    """
    return np.asarray(np.sum(np.sqrt(candidate * reference), axis=-1))


class Appearance:
    """
    What a target looks like.

    :param config: its likelihood part.
    :param frame: the frame the target is marked in.
    :param mark: the marked box, one.
    """

    def __init__(self, config: EnvironmentConfig, frame: BinImage, mark: Boxes) -> None:
        self.config = config
        self.grid = grid_points(config.samples_across, config.samples_down)
        self.part = _parts(config.parts, config.samples_across, config.samples_down)
        # to average the points of each part
        self._of_part = (self.part[:, None] == np.arange(config.parts)).astype(np.float64)
        self._of_part /= self._of_part.sum(axis=0)
        self.ring = ring_points()
        self._surround = self._surroundings(frame, mark)
        self.reference = self._marked(frame, mark)
        self._weigh()

    def log_likelihood(self, frame: BinImage, boxes: Boxes) -> tuple[Array, Array, Array]:
        """
        Give each box's logarithm of the likelihood (eq. 23, up to a constant).

        :return: (N,) it; (N,) similarity, 0 to 1; (N,) share of the box in the image.
        """
        alike, visible = self.compare(frame, boxes)
        # what is outside the image looks like anything
        alike = visible * alike + (1.0 - visible) * self.config.unseen_similarity
        log_likelihood = -self.config.lambda_b * (1.0 - alike)
        if self.config.contrast_weight > 0:
            log_likelihood -= self.config.contrast_weight * self.around(frame, boxes)
        return log_likelihood, alike, visible

    def compare(self, frame: BinImage, boxes: Boxes) -> tuple[Array, Array]:
        """Give each box's similarity to the reference, and the share of it in the image."""
        found, visible = self._histograms(frame, boxes, self.grid, self.part)
        alike = np.einsum('npb,pb->np', np.sqrt(found), self._root) / self._self
        if visible.ndim == 1:
            return alike.mean(axis=1), visible
        # parts count as far as they are seen
        share = visible.mean(axis=1)
        return np.sum(alike * visible, axis=1) / np.maximum(visible.sum(axis=1), 1e-9), share

    def around(self, frame: BinImage, boxes: Boxes) -> Array:
        """Give the similarity (N,) of each box's surroundings to the reference."""
        found = self._histograms(frame, boxes, self.ring, None)[0]
        return np.asarray(np.sqrt(found[:, 0]) @ self._root_whole / self._self_whole)

    def renew(self, frame: BinImage, box: Boxes) -> None:
        """Blend the reference with what the target looks like now, by ``adaptation``."""
        share = self.config.adaptation
        if share > 0:
            self.reference = (1 - share) * self.reference + share * self._marked(frame, box)
            self._weigh()

    def _marked(self, frame: BinImage, mark: Boxes) -> Array:
        """Give the histogram (parts, bins) of one box, finely sampled."""
        bins, inside = frame.sample(mark, grid_points(*_MARK_SAMPLES))
        index = _parts(self.config.parts, *_MARK_SAMPLES) * _ALL + bins[0]
        if inside is not None:
            index = index[inside[0]]
        counts = np.bincount(index, minlength=self.config.parts * _ALL)
        counts = counts.reshape(self.config.parts, _ALL).astype(np.float64)
        # a part that is wholly outside the image looks like the rest
        whole = counts.sum(axis=0)
        counts[counts.sum(axis=1) == 0] = whole
        return counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)

    def _surroundings(self, frame: BinImage, mark: Boxes) -> Array:
        """Give the histogram (bins,) of what is around the marked box."""
        bins, inside = BinImage(frame.image).sample(mark, self.ring)
        seen = bins if inside is None else bins[inside]
        counts = np.bincount(seen.ravel(), minlength=_ALL).astype(np.float64)
        share = counts / max(counts.sum(), 1.0)
        share[_BACKGROUND] = 1.0
        return share

    def _weigh(self) -> None:
        """Keep the bins the reference has, as their roots times their weights."""
        whole = self.reference.mean(axis=0)
        kept = np.flatnonzero(whole)
        weight = 1.0 / (1.0 + self.config.surround_weight
                        * self._surround[kept] / (whole[kept] + 1e-3))
        # bin 0 is every other colour, the last one what is outside the image
        self._kept = np.zeros(_ALL, dtype=np.int32)
        self._kept[kept] = np.arange(1, len(kept) + 1)
        self._count = len(kept) + 2
        self._root = np.zeros((self.config.parts, self._count - 1))
        self._root[:, 1:] = np.sqrt(self.reference[:, kept]) * weight
        self._self = self.reference[:, kept] @ weight
        self._root_whole = np.zeros(self._count - 1)
        self._root_whole[1:] = np.sqrt(whole[kept]) * weight
        self._self_whole = float(whole[kept] @ weight)

    def _histograms(self, frame: BinImage, boxes: Boxes, grid: Grid,
                    part: Optional[NDArray[np.intp]]) -> tuple[Array, Array]:
        """
        Give histograms over the reference's bins, and the share of each box in the image.

        :return: (N, parts, kept bins + 1) and (N,).
        """
        bins, inside = frame.sample(boxes, grid)
        parts = 1 if part is None else self.config.parts
        found = self._kept[bins]
        visible = np.ones(len(bins))
        if inside is not None:
            visible = inside @ self._of_part if part is not None \
                else inside.mean(axis=1, keepdims=True)
            found[~inside] = self._count - 1
        first = np.arange(len(bins), dtype=np.int32)[:, None] * (parts * self._count)
        index = found + first if part is None else found + (first + part * self._count)
        counts = np.bincount(index.ravel(), minlength=len(bins) * parts * self._count)
        counts = counts.reshape(len(bins), parts, self._count)[..., :-1]
        return counts / np.maximum(counts.sum(axis=-1, keepdims=True), 1), visible


def _parts(count: int, across: int, down: int) -> NDArray[np.intp]:
    """Give the part, from the top, of each point of a grid."""
    return np.repeat(np.arange(down) * count // down, across)
