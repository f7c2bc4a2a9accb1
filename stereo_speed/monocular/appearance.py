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

from typing import Optional

import numpy as np
from numpy.typing import NDArray

from .background_model import Background
from .boxes import envelope
from .colour_bins import (
    BACKGROUND, BinImage, Boxes, Grid, grid_points, MARK_SAMPLES, ring_points, Samples)
from .config import MonocularConfig
from ..core.records import Array

USUAL_SHARE = 0.05  # of a new look in what is usual
_ALL = BACKGROUND + 1
_OWN = 0.2  # of what stands out in a mark that others must leave free, or it is read with them
_LOOKS = 2  # at the background in a mark before it is believed
_MORE = 0.1  # of the mark's background that must have become known for it to be read again


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

    def __init__(self, config: MonocularConfig, frame: BinImage, mark: Boxes) -> None:
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
                look = look._replace(covered=(self._behind & (look.bins != BACKGROUND)))
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
        index = _parts(self.config.parts, *MARK_SAMPLES) * _ALL + look.bins[0]
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
        share[BACKGROUND] = 1.0
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
    return frame.sample(mark, grid_points(*MARK_SAMPLES))


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
    stands_out = look.bins[0] != BACKGROUND
    enough = np.sum(free & stands_out) >= max(_OWN * np.sum(here & stands_out), 1)
    return free if enough else here


def _parts(count: int, across: int, down: int) -> NDArray[np.intp]:
    """Give the part, from the top, of each point of a grid."""
    return np.repeat(np.arange(down) * count // down, across)
