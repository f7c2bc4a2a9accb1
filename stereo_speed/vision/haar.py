# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Partwise Haar-like features of a patch sampled on a fixed grid (2012, Section III-B.1, Fig. 2).

The grid is split into N_p parts; each part gives 16 numbers: its mean and the up-down, left-right
and diagonal differences of the whole part (level 1), and the same three differences of each of
its four quadrants (level 2).  On a part of 4 x 4 equal cells these are the 16 coefficients of the
two-level orthonormal Haar transform, so each part is one small matrix product.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError

FEATURES_PER_PART = 16
CELLS = 4  # cells across and down a part; with as many samples, each sample is a cell
# Parts across and down the front; fronts are wider than high, and so are the grids.
PART_LAYOUT = {4: (2, 2), 6: (3, 2), 8: (4, 2), 10: (5, 2), 12: (4, 3), 16: (4, 4)}

_FLOOR = 1e-6  # avoids division by 0 for a patch without contrast


def haar_basis() -> NDArray[np.float64]:
    """
    Return the two-level Haar basis of a part.

    :return: (16, 4, 4) orthonormal patterns over the part's 4 x 4 cells: mean, up-down,
        left-right, diagonal, then these three differences for each quadrant.
    """
    up_down = np.array([[1.0, 1.0], [-1.0, -1.0]])
    kinds = [up_down, up_down.T, up_down * up_down.T]
    patterns = [np.full((4, 4), 0.25)]
    patterns += [np.kron(kind, np.ones((2, 2))) / 4 for kind in kinds]
    for row in (0, 2):
        for col in (0, 2):
            for kind in kinds:
                pattern = np.zeros((4, 4))
                pattern[row:row + 2, col:col + 2] = kind / 2
                patterns.append(pattern)
    return np.array(patterns)


@dataclass(frozen=True)
class PartGrid:
    """
    The fixed sampling grid of the front and its parts.

    :param parts: N_p, one of 4, 6, 8, 10, 12, 16.
    :param samples_per_part: samples across and down one part, a multiple of 4.
    :raises InputError: other values.
    """

    parts: int = 10
    samples_per_part: int = 8

    def __post_init__(self) -> None:
        if self.parts not in PART_LAYOUT:
            raise InputError('configuration', 'parts', self.parts,
                             'one of ' + ', '.join(map(str, PART_LAYOUT)))
        if self.samples_per_part < 4 or self.samples_per_part % 4:
            raise InputError('configuration', 'samples_per_part', self.samples_per_part,
                             'a positive multiple of 4')

    @property
    def shape(self) -> tuple[int, int]:
        """Return the rows and columns of the grid."""
        across, down = PART_LAYOUT[self.parts]
        return down * self.samples_per_part, across * self.samples_per_part

    @cached_property
    def unit_xy(self) -> NDArray[np.float64]:
        """Return the sample centres in the unit square, (G, 2), row by row from the top left."""
        rows, cols = self.shape
        x, y = np.meshgrid((np.arange(cols) + 0.5) / cols, (np.arange(rows) + 0.5) / rows)
        return np.stack([x.ravel(), y.ravel()], axis=-1)

    @property
    def size(self) -> int:
        """Return the number of features of a patch, 16 N_p."""
        return FEATURES_PER_PART * self.parts

    @cached_property
    def _patterns(self) -> NDArray[np.float32]:
        """Return the matrix (samples, 16) that maps the samples of a part to its features."""
        cell = self.samples_per_part // 4
        # An orthonormal pattern of cells becomes one of samples if each of its cells is repeated
        # cell x cell times and scaled by 1 / cell.
        patterns = np.kron(haar_basis(), np.ones((1, cell, cell))) / cell
        return np.ascontiguousarray(patterns.reshape(FEATURES_PER_PART, -1).T, np.float32)

    def features(self, patches: NDArray[np.float32]) -> NDArray[np.float32]:
        """
        Return features of patches, with unit length so that light and contrast drop out.

        :param patches: (N, G) grey values on the grid.
        :return: (N, 16 N_p), rows of unit Euclidean length, orthogonal to a constant patch.
        """
        raw = self.transform(patches - patches.mean(axis=1, keepdims=True))
        return np.asarray(
            raw / (np.linalg.norm(raw, axis=1, keepdims=True) + np.float32(_FLOOR)))

    def transform(self, patches: NDArray[np.float32]) -> NDArray[np.float32]:
        """
        Return the Haar coefficients of patches, part by part.

        :param patches: (N, G) grey values on the grid.
        :return: (N, 16 N_p).
        """
        n, (rows, cols) = self.samples_per_part, self.shape
        by_part = patches.reshape(-1, rows // n, n, cols // n, n).swapaxes(2, 3)
        features = by_part.reshape(-1, n * n) @ self._patterns
        return np.asarray(features.reshape(len(patches), self.size))
