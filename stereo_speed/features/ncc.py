# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Normalised cross-correlation of patches (2012, eq. 17)."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def normalise(patches: NDArray[np.float32]) -> NDArray[np.float32]:
    """
    Zero mean and unit Euclidean length per row; a row without contrast becomes zero.

    :param patches: (N, G) grey values.
    """
    centred = patches - patches.mean(axis=-1, keepdims=True)
    length = np.linalg.norm(centred, axis=-1, keepdims=True)
    return np.divide(centred, length, out=np.zeros_like(centred), where=length > 1e-6)


def ncc(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.float32]:
    """
    Correlation of matching rows, in [-1, 1]; 0 where either has no contrast.

    :param first: (N, G) grey values.
    :param second: (N, G), or (G,) to compare every row with one patch.
    :return: (N,).
    """
    return np.sum(normalise(first) * normalise(second), axis=-1)
