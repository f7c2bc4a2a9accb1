# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The likelihood of a box from its colours (2010, Section IV.D, eq. 23-24).

A joint RGB histogram of 16 bins a channel is compared with that of the marked box by their
Bhattacharyya coefficient. Three departures can be switched on, each from work that the paper
builds on: colours that the surroundings share count less (Comaniciu, Ramesh and Meer 2003, its
[1]); the box is divided into parts (Perez et al. 2002, its [27]); and the reference is renewed
slowly (Zhou, Chellappa and Moghaddam 2004, its [24]). Two are our own: the contrast with the
surroundings (a box that is too small has the target's colours about it), and that targets hide
those behind them.

A mark may be made before the background about it was ever seen, as in the first frame. Then the
ground in it passes for the target, and the mark is read again as the background becomes known.
"""
from __future__ import annotations

from typing import NamedTuple, Optional

import numpy as np
from numpy.typing import NDArray

from .background import Background
from .boxes import envelope
from .config import EnvironmentConfig
from ..records import Array

BINS = 16  # of each channel
USUAL_SHARE = 0.05  # of a new look in what is usual
_SHIFT = 4  # 256 levels to BINS
_BACKGROUND = BINS ** 3  # a colour of its own
_ALL = _BACKGROUND + 1
_RING = (1.15, 1.3)  # sizes of the frames around the box that are its surroundings
_RING_SAMPLES = 12  # along each side
_MARK_SAMPLES = (40, 60)  # across and down the marked box
_OWN = 0.2  # of what stands out in a mark that others must leave free, or it is read with them
_LOOKS = 2  # at the background in a mark before it is believed
_MORE = 0.1  # of the mark's background that must have become known for it to be read again


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
        look = self.sample(mark, grid_points(*_MARK_SAMPLES))
        inside = look.bins if look.outside is None else look.bins[~look.outside]
        return float(np.mean(inside == _BACKGROUND)) if inside.size else 0.0

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
            covered = covered & (bins != _BACKGROUND) if covered.any() else None
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

    ``usual`` is the similarity that the target has as a rule, as told to :meth:`note`; 0 at
    first: one just marked is not hidden.
    """

    def __init__(self, config: EnvironmentConfig, frame: BinImage, mark: Boxes) -> None:
        self.config = config
        self.grid = grid_points(config.samples_across, config.samples_down)
        self.part = _parts(config.parts, config.samples_across, config.samples_down)
        # to average the points of each part
        self._of_part = (self.part[:, None] == np.arange(config.parts)).astype(np.float64)
        self._of_part /= self._of_part.sum(axis=0)
        self.ring = ring_points()
        self.usual, self._noted = 0.0, 0
        self._surround = self._surroundings(frame, mark)
        look = _look_at_mark(frame, mark)
        self.reference = self._histogram(look)
        self._mark, self._known = mark, 0.0
        self._behind = None if look.covered is None else look.covered[0]
        # until all of its background is known
        self._mark_image = None if frame.background is None else frame.image.copy()
        self._weigh()

    @property
    def unseen(self) -> float:
        """Give the similarity that counts for what is not seen."""
        return self.config.unseen_share * self.usual

    def log_likelihood(self, frame: BinImage, boxes: Boxes) -> tuple[Array, Array, Array]:
        """
        Give each box's logarithm of the likelihood (eq. 23, up to a constant).

        :return: (N,) it; (N,) similarity, 0 to 1; (N,) share of the box in the image.
        """
        alike, seen, visible = self.compare(frame, boxes)
        # what is outside the image, or behind others, looks like anything
        alike = seen * alike + (1.0 - seen) * self.unseen
        log_likelihood = -self.config.lambda_b * (1.0 - alike)
        if self.config.contrast_weight > 0:
            log_likelihood -= self.config.contrast_weight * self.around(frame, boxes)
        return log_likelihood, alike, visible

    def compare(self, frame: BinImage, boxes: Boxes) -> tuple[Array, Array, Array]:
        """
        Compare what is seen of each box with the reference.

        Once colours have weights, a box with more of the weighty ones than the mark would be
        more than alike; it counts as alike.

        :return: (N,) similarity, 0 to 1; (N,) share of the box that is seen: in the image, and
            not behind others; (N,) share in the image.
        """
        found, seen, visible = self._histograms(frame, boxes, self.grid, self.part)
        alike = np.einsum('npb,pb->np', np.sqrt(found), self._root) / self._self
        alike = np.minimum(alike, 1.0)
        if seen is None:
            return alike.mean(axis=1), visible, visible
        # parts count as far as they are seen
        share = seen.mean(axis=1)
        return np.sum(alike * seen, axis=1) / np.maximum(seen.sum(axis=1), 1e-9), share, visible

    def around(self, frame: BinImage, boxes: Boxes) -> Array:
        """Give the similarity (N,) of what is seen around each box to the reference."""
        found = self._histograms(frame, boxes, self.ring, None)[0]
        alike = np.sqrt(found[:, 0]) @ self._root_whole / self._self_whole
        return np.asarray(np.minimum(alike, 1.0))

    def note(self, alike: float) -> None:
        """Take a similarity of the target into what is usual: a mean, later a running one."""
        self._noted += 1
        self.usual += max(1.0 / self._noted, USUAL_SHARE) * (alike - self.usual)

    def review(self, background: Background, now_px: Array) -> bool:
        """
        Read the mark again when more of the background in it has become known.

        What was behind another target when it was marked still is.

        :param now_px: (4,) where the target is now: what is learnt there is not believed.
        :return: whether it was read again.
        """
        if self._mark_image is None:
            return False
        mark = self._mark
        upright = np.concatenate([mark.centre_px[0] - mark.size_px[0] / 2, mark.size_px[0]])
        angle = 0.0 if mark.angle_rad is None else float(mark.angle_rad[0])
        known = background.known(envelope(upright, angle), now_px, _LOOKS)
        again = known >= self._known + _MORE or known == 1.0
        if again:
            self._known = known
            look = _look_at_mark(BinImage(self._mark_image, background), mark)
            if self._behind is not None:
                look = look._replace(covered=(self._behind & (look.bins != _BACKGROUND)))
            self.reference = self._histogram(look)
            self._noted = 0  # what was usual was so with the other reference
            self._weigh()
        if known == 1.0:
            self._mark_image = None
        return again

    def renew(self, frame: BinImage, box: Boxes) -> None:
        """Blend the reference with what the target looks like now, by ``adaptation``."""
        share = self.config.adaptation
        if share > 0:
            now = self._histogram(_look_at_mark(frame, box))
            self.reference = (1 - share) * self.reference + share * now
            self._weigh()

    def _histogram(self, look: Samples) -> Array:
        """Give the histogram (parts, bins) of one box, looked at as a mark is."""
        index = _parts(self.config.parts, *_MARK_SAMPLES) * _ALL + look.bins[0]
        index = index[_to_read(look)]
        counts = np.bincount(index, minlength=self.config.parts * _ALL)
        counts = counts.reshape(self.config.parts, _ALL).astype(np.float64)
        # a part that is wholly outside the image looks like the rest
        whole = counts.sum(axis=0)
        counts[counts.sum(axis=1) == 0] = whole
        return counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)

    def _surroundings(self, frame: BinImage, mark: Boxes) -> Array:
        """Give the histogram (bins,) of what is around the marked box."""
        look = BinImage(frame.image).sample(mark, self.ring)
        seen = look.bins if look.outside is None else look.bins[~look.outside]
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
                    part: Optional[NDArray[np.intp]]) -> tuple[Array, Optional[Array], Array]:
        """
        Give histograms of what is seen, over the reference's bins.

        :return: (N, parts, kept bins + 1) them; (N, parts) share of each that is seen, None
            where all is; (N,) share of the points in the image.
        """
        look = frame.sample(boxes, grid)
        bins, unseen = look.bins, look.unseen
        parts = 1 if part is None else self.config.parts
        found = self._kept[bins]
        visible = np.ones(len(bins)) if look.outside is None else 1.0 - look.outside.mean(axis=1)
        seen = None
        if unseen is not None:
            seen = ~unseen @ self._of_part if part is not None \
                else 1.0 - unseen.mean(axis=1, keepdims=True)
            found[unseen] = self._count - 1
        first = np.arange(len(bins), dtype=np.int32)[:, None] * (parts * self._count)
        index = found + first if part is None else found + (first + part * self._count)
        counts = np.bincount(index.ravel(), minlength=len(bins) * parts * self._count)
        counts = counts.reshape(len(bins), parts, self._count)[..., :-1]
        return counts / np.maximum(counts.sum(axis=-1, keepdims=True), 1), seen, visible


def _look_at_mark(frame: BinImage, mark: Boxes) -> Samples:
    """Look at one box, finely sampled."""
    return frame.sample(mark, grid_points(*_MARK_SAMPLES))


def _to_read(look: Samples) -> NDArray[np.bool_]:
    """
    Tell which points (M,) of a mark tell what the target looks like; there always are some.

    A mark that others cover almost wholly is read with them in it: it was marked there, so
    something of the target shows. One outside the image is read at the edge.
    """
    here = np.ones(look.bins.shape[1], dtype=bool)
    if look.outside is not None and not look.outside[0].all():
        here = ~look.outside[0]
    if look.covered is None:
        return here
    free = here & ~look.covered[0]
    stands_out = look.bins[0] != _BACKGROUND
    enough = np.sum(free & stands_out) >= max(_OWN * np.sum(here & stands_out), 1)
    return free if enough else here


def _parts(count: int, across: int, down: int) -> NDArray[np.intp]:
    """Give the part, from the top, of each point of a grid."""
    return np.repeat(np.arange(down) * count // down, across)
