# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parts of an image, and grey values on grids mapped onto quadrilaterals in it."""
from __future__ import annotations

import math
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from .haar import PartGrid
from ..core.records import Array

Patches = NDArray[np.float32]

_Float = TypeVar('_Float', np.float32, np.float64)
_MARGIN_PX = 4
_BLOCK = 128  # quads that are sampled at once, so that their maps stay in the cache


def crop(image: NDArray[Any], low: Array, high: Array, margin_px: int
         ) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """
    Return the part of an image around some points, at least 2 x 2 pixels, as a view.

    :param low: (2,) least u, v of the points, px.
    :param high: (2,) greatest u, v of the points, px.
    :param margin_px: width of the margin around the points, px.
    :return: the part, and its origin (2,) in the image, px.
    """
    (left, right), (top, bottom) = (
        _reach(float(low[k]), float(high[k]), margin_px, image.shape[1 - k]) for k in (0, 1))
    return image[top:bottom, left:right], np.array([left, top])


def _reach(low: float, high: float, margin_px: int, size: int) -> tuple[int, int]:
    """Return the first pixel of a part along one axis of an image, and the one after its end."""
    first = min(max(math.floor(low) - margin_px, 0), size - 2)
    return first, max(min(math.ceil(high) + margin_px + 1, size), first + 2)


def low_pass_crop(image: NDArray[Any], low: Array, high: Array, step_px: float
                  ) -> tuple[Patches, NDArray[np.float32]]:
    """
    Return the part of an image that samples need, low-pass filtered to their spacing.

    :param low: (2,) least u, v of the samples, px.
    :param high: (2,) greatest u, v of the samples, px.
    :param step_px: spacing of the samples, px; finer detail would alias.
    :return: the part as float32, and its origin (2,) in the image, px.
    """
    sigma = 0.5 * max(step_px - 1.0, 0.0)
    part, first = crop(image, low, high, _MARGIN_PX + int(np.ceil(3 * sigma)))
    grey = part.astype(np.float32)
    if sigma > 0.1:
        grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE))
    return grey, first.astype(np.float32)


def quad_grid(corners: NDArray[_Float], unit_xy: Array) -> NDArray[_Float]:
    """
    Return points of the unit square mapped onto quadrilaterals by homographies.

    The homographies have a closed form (Heckbert 1989, "Fundamentals of texture mapping",
    section 2.2.3).

    :param corners: (N, 4, 2) images of (0, 0), (1, 0), (1, 1), (0, 1).
    :param unit_xy: (G, 2) points of the unit square.
    :return: (2, N, G) u and v, with the type of ``corners``.
    """
    p0, p1, p2, p3 = (corners[:, k] for k in range(4))
    d1, d2, d3 = p1 - p2, p3 - p2, p0 - p1 + p2 - p3
    det = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
    g = (d3[:, 0] * d2[:, 1] - d2[:, 0] * d3[:, 1]) / det
    h = (d1[:, 0] * d3[:, 1] - d3[:, 0] * d1[:, 1]) / det
    homography = np.ones((3, len(corners), 3), corners.dtype)
    homography[:2, :, 0] = (p1 - p0 + g[:, None] * p1).T
    homography[:2, :, 1] = (p3 - p0 + h[:, None] * p3).T
    homography[:2, :, 2] = p0.T
    homography[2, :, 0], homography[2, :, 1] = g, h
    xy1 = np.vstack([unit_xy.T, np.ones(len(unit_xy))]).astype(corners.dtype)
    mapped = homography @ xy1
    return np.asarray(mapped[:2] / mapped[2])


def sample_quads(image: NDArray[Any], quads: Array, grid: PartGrid) -> Patches:
    """
    Return the grey values on the grid mapped onto each quadrilateral.

    :param quads: (N, 4, 2) finite corners, px.
    :return: (N, G) grey values; outside the image the border values are repeated.
    """
    corners = quads.astype(np.float32)
    flat = corners.reshape(-1, 2)
    width = np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1))
    part, origin = low_pass_crop(image, flat.min(axis=0), flat.max(axis=0),
                                 float(width) / grid.shape[1])
    out = np.empty((len(quads), len(grid.unit_xy)), np.float32)
    for k in range(0, len(quads), _BLOCK):
        u, v = quad_grid(corners[k:k + _BLOCK] - origin, grid.unit_xy)
        cv2.remap(part, u, v, cv2.INTER_LINEAR, out[k:k + _BLOCK],
                  borderMode=cv2.BORDER_REPLICATE)
    return out
