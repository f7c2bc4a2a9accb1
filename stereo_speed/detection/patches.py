# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Correlation of batches of patches: with one another, shifted, and with their mirror images."""
from __future__ import annotations

from typing import Any, Optional

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from .pyramid import Patches
from ..vision.box_sums import window_sums

Floats = NDArray[np.float64]

_LEAST_VARIANCE = 1.0  # in squared grey levels: patches with less are noise and do not correlate


def level_rows(values: Patches, mask: Optional[NDArray[np.bool_]] = None) -> Patches:
    """
    Return rows without their means: what varies up and down only tells nothing of depth.

    :param values: (n, rows, w).
    :param mask: (n, w) columns that count; the others become 0.
    """
    if mask is None:
        return np.asarray(values - values.mean(axis=2, keepdims=True))
    weight = mask[:, None, :].astype(np.float32)
    mean = (values * weight).sum(axis=2, keepdims=True) / weight.sum(axis=2, keepdims=True)
    return np.asarray((values - mean) * weight)


def correlate(a: Patches, b: Patches) -> Floats:
    """
    Return the correlations of patches (n, rows, w) of zero mean; 0 for those without contrast.

    :return: (n,).
    """
    mixed, of_a, of_b = (np.einsum('nrw,nrw->n', p, q, dtype=np.float64)
                         for p, q in ((a, b), (a, a), (b, b)))
    floor = _LEAST_VARIANCE * np.maximum(np.count_nonzero(a.any(axis=1), axis=1), 1) * a.shape[1]
    return np.asarray(mixed / np.sqrt(np.maximum(of_a, floor) * np.maximum(of_b, floor)))


def slide(patch: Patches, wide: Patches) -> Floats:
    """
    Return the correlations of one patch with every window of its width in each of wider ones.

    :param patch: (rows, w).
    :param wide: (n, rows, w + k).
    :return: (n, k + 1).
    """
    width, count = patch.shape[1], patch.size
    floor = _LEAST_VARIANCE * count
    centred = patch - patch.mean()
    mixed = np.stack([np.einsum('nrw,rw->n', wide[:, :, k:k + width], centred)
                      for k in range(wide.shape[2] - width + 1)], axis=1)
    total = window_sums(wide.sum(axis=1, keepdims=True), width)[:, 0]
    square = window_sums((wide * wide).sum(axis=1, keepdims=True), width)[:, 0]
    spread = np.maximum(square - total ** 2 / count, floor)
    return np.asarray(mixed / np.sqrt(spread * max(float((centred ** 2).sum()), floor)))


def mirrored(values: Patches, width: int) -> tuple[Floats, Floats]:
    """
    Return the product of each window with its mirror image, both about the means of their rows.

    :param values: (n, rows, w + k).
    :param width: w of the windows, odd.
    :return: (n, k + 1) the sums, and what they would be were the windows symmetric.
    """
    every = sliding_window_view(values, width, axis=2)  # (n, rows, windows, width)
    half = width // 2
    front, back = every[..., :half], every[..., :half:-1]
    mixed = 2 * np.einsum('nrwk,nrwk->nw', front, back) + np.einsum(
        'nrw,nrw->nw', every[..., half], every[..., half])
    mean = (window_sums(values, width) ** 2).sum(axis=1) / width
    square = window_sums((values * values).sum(axis=1, keepdims=True), width)[:, 0]
    floor = _LEAST_VARIANCE * width * values.shape[1]
    return np.asarray(mixed - mean), np.maximum(square - mean, floor)


def cut(values: Patches, start: NDArray[np.int64], width: int) -> Patches:
    """Return columns ``start`` (n,) to ``start + width`` of each of (n, rows, w)."""
    columns: NDArray[Any] = start[:, None] + np.arange(width)
    return np.take_along_axis(values, columns[:, None, :], axis=2)
