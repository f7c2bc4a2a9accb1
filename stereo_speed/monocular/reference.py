# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Colour histograms of the parts of a box, and the reference they are compared with.

Only the few colours in the reference are counted individually; all others share one bin.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Optional, Union

import numpy as np
from numpy.typing import NDArray

from .colour_bins import ALL_BINS, BACKGROUND, Grid, grid_points, Points, ring_points, Samples
from ..core.records import Array

_LEAST_SHARE = 1e-3  # added to a colour's share of the box, so that rare colours keep some weight


@dataclass(frozen=True, eq=False)
class Layout:
    """
    The sample points of a box, and the part of the box that each belongs to.

    :param at: the points (M,).
    :param part: (M,), index of the part, from 0 at the top.
    :param parts: number of parts.
    """

    at: Union[Grid, Points]
    part: NDArray[np.intp]
    parts: int

    @classmethod
    def grid(cls, across: int, down: int, parts: int) -> Layout:
        """Return a grid over the box, divided into parts from top to bottom."""
        return cls(grid_points(across, down),
                   np.repeat(np.arange(down) * parts // down, across), parts)

    @classmethod
    def ring(cls) -> Layout:
        """Return points around the box, as one part."""
        points = ring_points()
        return cls(points, np.zeros(len(points.x), dtype=np.intp), 1)

    @cached_property
    def averaging(self) -> Array:
        """Return the matrix (M, parts) that averages the points of each part."""
        chosen = (self.part[:, None] == np.arange(self.parts)).astype(np.float64)
        return np.asarray(chosen / chosen.sum(axis=0))


@dataclass(frozen=True, eq=False, kw_only=True)
class Histograms:
    """
    Histograms of the seen parts of boxes, over the colours of a reference.

    :param shares: (N, parts, K), share of each colour; the first stands for all other colours.
    :param seen: (N, parts), seen share of each part; None where all is seen.
    :param visible: (N,), share of the points in the image.
    """

    shares: Array
    seen: Optional[Array]
    visible: Array


class Reference:
    """
    The histograms of a target, and weights of their colours.

    A colour counts less the more it occurs around the initial box (Comaniciu, Ramesh and Meer
    2003).

    :param histogram: (parts, bins), histogram of the initial box; rows sum to 1.
    :param surroundings: (bins,), share of each colour around the initial box.
    :param surround_weight: how much shared colours are down-weighted; 0 for not at all.
    """

    def __init__(self, histogram: Array, surroundings: Array, surround_weight: float) -> None:
        self.histogram = histogram
        whole = histogram.mean(axis=0)
        kept = np.flatnonzero(whole)
        weight = 1.0 / (1.0 + surround_weight * surroundings[kept] / (whole[kept] + _LEAST_SHARE))
        self._colour_of_bin = np.zeros(ALL_BINS, dtype=np.int32)  # 0 is every other colour
        self._colour_of_bin[kept] = np.arange(1, len(kept) + 1)
        self._colours = len(kept) + 1
        self._roots = np.zeros((len(histogram), self._colours))  # times weights
        self._roots[:, 1:] = np.sqrt(histogram[:, kept]) * weight
        self._norms = histogram[:, kept] @ weight
        self._root_of_whole = np.zeros(self._colours)
        self._root_of_whole[1:] = np.sqrt(whole[kept]) * weight
        self._norm_of_whole = float(whole[kept] @ weight)

    def histograms(self, samples: Samples, layout: Layout) -> Histograms:
        """Return the histograms of sampled boxes over the reference's colours."""
        unseen, outside = samples.unseen, samples.outside
        colours, count = self._colour_of_bin[samples.bins], len(samples.bins)
        seen = None
        if unseen is not None:
            seen = ~unseen @ layout.averaging
            colours[unseen] = self._colours  # an extra column, which is dropped
        columns = self._colours + 1
        first = np.arange(count, dtype=np.int32)[:, None] * (layout.parts * columns)
        index = colours + (first + layout.part * columns)
        counts = np.bincount(index.ravel(), minlength=count * layout.parts * columns)
        counts = counts.reshape(count, layout.parts, columns)[..., :-1]
        return Histograms(
            shares=counts / np.maximum(counts.sum(axis=-1, keepdims=True), 1), seen=seen,
            visible=np.ones(count) if outside is None else 1.0 - outside.mean(axis=1))

    def similarity(self, found: Histograms) -> Array:
        """
        Return the weighted Bhattacharyya coefficient (N, parts) of each part, 0 to 1.

        The result is capped at 1, which a box with more of the heaviest colours than the reference
        would exceed.
        """
        alike = np.einsum('npb,pb->np', np.sqrt(found.shares), self._roots) / self._norms
        return np.asarray(np.minimum(alike, 1.0))

    def similarity_to_whole(self, found: Histograms) -> Array:
        """Return the coefficient (N,) of the first part with the whole reference, 0 to 1."""
        alike = np.sqrt(found.shares[:, 0]) @ self._root_of_whole / self._norm_of_whole
        return np.asarray(np.minimum(alike, 1.0))


def box_histogram(samples: Samples, layout: Layout, least_free_share: float) -> Array:
    """
    Return the histogram (parts, bins) of a single box.

    :param samples: samples of the box.
    :param layout: its sample points.
    :param least_free_share: see :class:`.MonocularConfig`, ``initial_free_share``.
    """
    index = (layout.part * ALL_BINS + samples.bins[0])[_showing_target(samples, least_free_share)]
    counts = np.bincount(index, minlength=layout.parts * ALL_BINS)
    counts = counts.reshape(layout.parts, ALL_BINS).astype(np.float64)
    # a part that is completely outside the image is assumed to look like the rest
    counts[counts.sum(axis=1) == 0] = counts.sum(axis=0)
    return np.asarray(counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0))


def _showing_target(samples: Samples, least_free_share: float) -> NDArray[np.bool_]:
    """
    Return which points (M,) of an initial box show the target; at least one does.

    A box that is almost completely occluded by other targets is sampled including them: a person
    marked it, so part of the target must be visible. A box outside the image is sampled at the
    image's edge.
    """
    inside = np.ones(samples.bins.shape[1], dtype=bool)
    if samples.outside is not None and not samples.outside[0].all():
        inside = ~samples.outside[0]
    if samples.occluded is None:
        return inside
    free = inside & ~samples.occluded[0]
    stands_out = samples.bins[0] != BACKGROUND
    enough = max(least_free_share * float(np.sum(inside & stands_out)), 1.0)
    return free if np.sum(free & stands_out) >= enough else inside
