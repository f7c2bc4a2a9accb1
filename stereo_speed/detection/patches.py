# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Correlation of a patch with windows of others."""
from __future__ import annotations

import numpy as np

from .patch_kernels import Floats, LEAST_VARIANCE
from .pyramid import Patches
from ..vision.box_sums import window_sums


def level_rows(values: Patches) -> Patches:
    """
    Return rows minus their means, because variation from row to row does not depend on depth.

    :param values: (n, rows, w).
    """
    return np.asarray(values - values.mean(axis=2, keepdims=True))


def slide(patch: Patches, wide: Patches) -> Floats:
    """
    Return the correlations of one patch with all windows of its width in wider patches.

    :param patch: (rows, w).
    :param wide: (n, rows, w + k).
    :return: (n, k + 1).
    """
    width, count = patch.shape[1], patch.size
    floor = LEAST_VARIANCE * count
    centred = patch - patch.mean()
    mixed = np.stack([np.einsum('nrw,rw->n', wide[:, :, k:k + width], centred)
                      for k in range(wide.shape[2] - width + 1)], axis=1)
    total = window_sums(wide.sum(axis=1, keepdims=True), width)[:, 0]
    square = window_sums((wide * wide).sum(axis=1, keepdims=True), width)[:, 0]
    spread = np.maximum(square - total ** 2 / count, floor)
    return np.asarray(mixed / np.sqrt(spread * max(float((centred ** 2).sum()), floor)))
