# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Small patches of the background of one view, and where they are in another image of it.

The patches are compared by inverse compositional Lucas-Kanade steps (Baker and Matthews 2004,
"Lucas-Kanade 20 years on", section 3): the gradients are those of the patches as they were learnt,
so that each image costs a sampling and a product.  Gain and offset of each patch drop out.
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

HALF_PX = 4  # of the samples of a patch, which are a pixel apart
BORDER_PX = HALF_PX + 2  # from a patch's middle to the edge of the image
_CELLS = (9, 12)  # rows and columns of an image that each give their best corners
_MASK_PX = HALF_PX  # about a patch, within which there is no other
_CORNER_PX = 5  # of the window that corners are sought in
_LEAST_CORNER = 1e-3  # of the strongest one; below it a patch is flat
_LEAST_INFORMATION, _LEAST_SQUARE, _LEAST_GAIN = 1e-3, 1e-3, 1e-3  # flat patches divide by none
_REACH = np.arange(-HALF_PX - 1, HALF_PX + 2)  # with a border for gradients


class Displaced(NamedTuple):
    """
    Where patches are.

    :param offset_px: (n, 2) from where they were looked for, along the axes of each.
    :param ncc: (n,) correlation with what they looked like.
    :param noise: (n,) mean square by which their samples differ from what they looked like.
    :param grey: (n, k, k) what they look like now, as bright and contrasty as they were.
    """

    offset_px: Array
    ncc: Array
    noise: Array
    grey: Patches


@dataclass(frozen=True, eq=False)
class Details:
    """
    Patches of one image.

    :param centres_px: (n, 2) their middles.
    :param grey: (n, k, k) grey values, with a border of one pixel about the m samples.
    """

    centres_px: Array
    grey: Patches

    @classmethod
    def of(cls, image: Grey, count: int, taken_px: Optional[Array] = None) -> Details:
        """
        Return the corners of an image, spread over it.

        :param count: how many, at most.
        :param taken_px: (k, 2) places that have been taken; those count too.
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
        """Return the samples (n, m), of zero mean."""
        inner = self.grey[:, 1:-1, 1:-1].reshape(len(self), -1)
        return np.asarray(inner - inner.mean(axis=1, keepdims=True))

    @cached_property
    def _square(self) -> Patches:
        """Return the sums (n,) of the squared samples."""
        return np.asarray(np.maximum(np.square(self._values).sum(axis=1), _LEAST_SQUARE))

    @cached_property
    def _slopes(self) -> Patches:
        """Return the gradients (n, 2, m), without any part along a constant or the patch."""
        by_u = (self.grey[:, 1:-1, 2:] - self.grey[:, 1:-1, :-2]) / 2
        by_v = (self.grey[:, 2:, 1:-1] - self.grey[:, :-2, 1:-1]) / 2
        slopes = np.stack([by_u, by_v], axis=1).reshape(len(self), 2, -1)
        slopes -= slopes.mean(axis=2, keepdims=True)
        along = slopes @ self._values[..., None] / self._square[:, None, None]
        return np.asarray(slopes - along * self._values[:, None])

    @cached_property
    def _axes(self) -> tuple[Array, Array]:
        """Return what each patch tells of its place along its axes (n, 2), and these (n, 2, 2)."""
        slopes = self._slopes.astype(np.float64)
        told, axes = np.linalg.eigh(slopes @ np.swapaxes(slopes, 1, 2))
        return np.maximum(told, _LEAST_INFORMATION), np.swapaxes(axes, 1, 2)

    @property
    def information(self) -> Array:
        """Return what each patch tells of its place along its two axes, per px^2: (n, 2)."""
        return self._axes[0]

    @property
    def axes(self) -> Array:
        """Return the two axes of each patch, along which its errors are independent (n, 2, 2)."""
        return self._axes[1]

    @cached_property
    def _steps(self) -> Patches:
        """Return the offsets (n, 2, m) along the axes per grey level of each sample."""
        told, axes = self._axes
        return np.asarray(axes @ self._slopes / told[..., None], np.float32)

    def find(self, image: Grey, places_px: Array) -> Displaced:
        """
        Return where the patches are in an image, by one step from where they may be.

        :param places_px: (n, 2).
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
    Return the grey values (n, k, k) about places (n, 2), and a border of one pixel, bilinearly.

    ``cv2.remap`` would round them to whole grey levels, and there are few of these by night.
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
    Return where an image has its best corners, as many in each of its cells: (n, 2) whole pixels.

    :param count: how many, at most.
    :param taken_px: (k, 2) places that have been taken; those count too.
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
    for i, j in np.ndindex(held.shape):
        cell = strength[rows[i]:rows[i + 1], columns[j]:columns[j + 1]]
        for _ in range(each - held[i, j]):
            v, u = np.unravel_index(int(np.argmax(cell)), cell.shape)
            if cell[v, u] <= least:
                break
            out.append((int(columns[j] + u), int(rows[i] + v)))
            _clear(strength, *out[-1])
    return np.array(out[:max(count - len(taken), 0)], dtype=np.float64).reshape(-1, 2)


def _clear(strength: NDArray[np.float32], u: int, v: int) -> None:
    """Take a place, so that no other patch is about the same."""
    strength[max(v - _MASK_PX, 0):max(v + _MASK_PX + 1, 0),
             max(u - _MASK_PX, 0):max(u + _MASK_PX + 1, 0)] = 0
