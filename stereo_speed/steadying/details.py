# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Small patches of the background of one view, and their places in another image of it.

The patches are matched by inverse compositional Lucas-Kanade steps (Baker and Matthews 2004,
"Lucas-Kanade 20 years on", section 3).  The gradients are those of the learnt patches, so that
each image costs only a sampling and a product.  Gain and offset of each patch are eliminated.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any, NamedTuple, Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.records import Array

Patches = NDArray[np.float32]
Grey = NDArray[Any]  # (H, W) uint8 or uint16

HALF_PX = 4  # half size of a patch, whose samples are a pixel apart
BORDER_PX = HALF_PX + 2  # least distance of a patch's centre from the edge of the image
_CELLS = (9, 12)  # rows and columns of cells that each contribute their best corners
_MASK_PX = HALF_PX  # half size of the area around a patch without other patches
_CORNER_PX = 5  # window of the corner detector
_LEAST_CORNER = 1e-3  # least strength of a corner, as a share of that of the strongest one
_LEAST_INFORMATION, _LEAST_SQUARE, _LEAST_GAIN = 1e-3, 1e-3, 1e-3  # avoid division by 0
_REACH = np.arange(-HALF_PX - 1, HALF_PX + 2)  # pixels of a patch, with a border for gradients


class Displaced(NamedTuple):
    """
    The places of patches in an image.

    :param offset_px: (n, 2) offsets from the expected places, along the axes of each patch.
    :param ncc: (n,) correlation with the learnt patches.
    :param noise: (n,) mean squared difference of the samples from the learnt ones.
    :param grey: (n, k, k) current grey values, with the gain and offset of the learnt patches.
    """

    offset_px: Array
    ncc: Array
    noise: Array
    grey: Patches


@dataclass(frozen=True, eq=False)
class Details:
    """
    Patches of one image.

    :param centres_px: (n, 2) their centres.
    :param grey: (n, k, k) grey values, with a border of one pixel around the m samples.
    """

    centres_px: Array
    grey: Patches

    @classmethod
    def of(cls, image: Grey, count: int, taken_px: Optional[Array] = None) -> Details:
        """
        Return patches at the corners of an image, spread over it.

        :param count: largest number of patches, including those at ``taken_px``.
        :param taken_px: (k, 2) places of patches that exist already.
        """
        return cls.at(image, corners(image, count, taken_px))

    @classmethod
    def at(cls, image: Grey, centres_px: Array) -> Details:
        """Return the patches at whole pixels (n, 2) of an image."""
        u, v = np.asarray(centres_px, dtype=int).T[:, :, None, None]
        return cls(np.asarray(centres_px, dtype=np.float64),
                   image[v + _REACH[:, None], u + _REACH].astype(np.float32))

    def __len__(self) -> int:
        return len(self.centres_px)

    @cached_property
    def _mean(self) -> Patches:
        """Return the mean samples (n,)."""
        return np.asarray(self.grey[:, 1:-1, 1:-1].mean(axis=(1, 2)))

    @cached_property
    def _values(self) -> Patches:
        """Return the samples (n, m), with zero mean."""
        inner = self.grey[:, 1:-1, 1:-1].reshape(len(self), -1)
        return np.asarray(inner - inner.mean(axis=1, keepdims=True))

    @cached_property
    def _square(self) -> Patches:
        """Return the sums (n,) of the squared samples."""
        return np.asarray(np.maximum(np.square(self._values).sum(axis=1), _LEAST_SQUARE))

    @cached_property
    def _slopes(self) -> Patches:
        """Return the gradients (n, 2, m), orthogonal to a constant and to the patch itself."""
        by_u = (self.grey[:, 1:-1, 2:] - self.grey[:, 1:-1, :-2]) / 2
        by_v = (self.grey[:, 2:, 1:-1] - self.grey[:, :-2, 1:-1]) / 2
        slopes = np.stack([by_u, by_v], axis=1).reshape(len(self), 2, -1)
        slopes -= slopes.mean(axis=2, keepdims=True)
        along = slopes @ self._values[..., None] / self._square[:, None, None]
        return np.asarray(slopes - along * self._values[:, None])

    @cached_property
    def _axes(self) -> tuple[Array, Array]:
        """Return the information of each patch on its place along its axes, and the axes."""
        slopes = self._slopes.astype(np.float64)
        information, axes = np.linalg.eigh(slopes @ np.swapaxes(slopes, 1, 2))
        return np.maximum(information, _LEAST_INFORMATION), np.swapaxes(axes, 1, 2)

    @property
    def information(self) -> Array:
        """Return how well each patch determines its place along its axes, (n, 2), per px^2."""
        return self._axes[0]

    @property
    def axes(self) -> Array:
        """Return the two axes of each patch, (n, 2, 2), along which errors are independent."""
        return self._axes[1]

    @cached_property
    def _steps(self) -> Patches:
        """Return the offsets (n, 2, m), along the axes, per grey level of each sample."""
        information, axes = self._axes
        return np.asarray(axes @ self._slopes / information[..., None], np.float32)

    def find(self, image: Grey, places_px: Array) -> Displaced:
        """
        Return the places of the patches in an image, by one step from expected places.

        :param places_px: (n, 2) expected places.
        """
        grey = _between_pixels(image, places_px)
        now = grey[:, 1:-1, 1:-1].reshape(len(self), -1)
        mean = now.mean(axis=1, keepdims=True)
        now = now - mean
        common = np.einsum('nm,nm->n', now, self._values)
        square = np.maximum(np.einsum('nm,nm->n', now, now), _LEAST_SQUARE)
        ncc = common / np.sqrt(square * self._square)
        gain = np.maximum(common / self._square, _LEAST_GAIN)[:, None]
        offset = -(self._steps @ (now / gain)[..., None])[..., 0]
        noise = (square / gain[:, 0] ** 2 - self._square) / now.shape[1]
        level = self._mean[:, None, None] + (grey - mean[..., None]) / gain[..., None]
        return Displaced(offset, ncc.astype(np.float64),
                         noise.astype(np.float64), level)


def _between_pixels(image: Grey, places_px: Array) -> Patches:
    """
    Return the bilinear grey values (n, k, k) around places (n, 2), with a border of one pixel.

    ``cv2.remap`` would round them to integers, which is too coarse at night.
    """
    floor = np.floor(places_px)
    u, v = floor.astype(int).T[:, :, None, None]
    reach = np.arange(-HALF_PX - 1, HALF_PX + 3)
    height, width = image.shape
    grey = image[np.clip(v + reach[:, None], 0, height - 1),
                 np.clip(u + reach, 0, width - 1)].astype(np.float32)
    right, down = (places_px - floor).astype(np.float32).T[:, :, None, None]
    grey = grey[:, :, :-1] + right * (grey[:, :, 1:] - grey[:, :, :-1])
    return np.asarray(grey[:, :-1] + down * (grey[:, 1:] - grey[:, :-1]))


def corners(image: Grey, count: int, taken_px: Optional[Array] = None) -> Array:
    """
    Return the best corners of an image, equally many in each of its cells: (n, 2) whole pixels.

    :param count: largest number of corners, including ``taken_px``.
    :param taken_px: (k, 2) places that are taken already.
    """
    height, width = image.shape
    if min(height, width) <= 2 * BORDER_PX:
        return np.zeros((0, 2))
    strength: NDArray[np.float32] = np.asarray(cv2.cornerMinEigenVal(
        image if image.dtype == np.uint8 else image.astype(np.float32), _CORNER_PX), np.float32)
    least = _LEAST_CORNER * float(strength.max())
    rows = np.linspace(BORDER_PX, height - BORDER_PX, _CELLS[0] + 1).astype(int)
    columns = np.linspace(BORDER_PX, width - BORDER_PX, _CELLS[1] + 1).astype(int)
    taken = np.zeros((0, 2)) if taken_px is None else taken_px
    held = np.histogram2d(taken[:, 1], taken[:, 0], bins=(rows, columns))[0].astype(int)
    each = math.ceil(count / held.size)
    for u, v in np.round(taken).astype(int):
        _clear(strength, int(u), int(v))
    out: list[tuple[int, int]] = []
    ranks: list[int] = []  # number of each corner in its cell
    for i, j in np.ndindex(held.shape):
        cell = strength[rows[i]:rows[i + 1], columns[j]:columns[j + 1]]
        for rank in range(held[i, j], each):
            v, u = np.unravel_index(int(np.argmax(cell)), cell.shape)
            if cell[v, u] <= least:
                break
            out.append((int(columns[j] + u), int(rows[i] + v)))
            ranks.append(rank)
            _clear(strength, *out[-1])
    kept = np.argsort(ranks, kind='stable')[:max(count - len(taken), 0)]
    return np.array(out, dtype=np.float64).reshape(-1, 2)[np.sort(kept)]


def _clear(strength: NDArray[np.float32], u: int, v: int) -> None:
    """Clear the corner strength around a place, so that patches do not overlap much."""
    strength[max(v - _MASK_PX, 0):max(v + _MASK_PX + 1, 0),
             max(u - _MASK_PX, 0):max(u + _MASK_PX + 1, 0)] = 0
