# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Normalised cross-correlation of patches (2012, eq. 17)."""
from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

_NO_CONTRAST = 1e-12

_Float = TypeVar('_Float', np.float32, np.float64)


def ncc(first: NDArray[_Float], second: NDArray[_Float]) -> NDArray[_Float]:
    """
    Return the correlation of corresponding rows, in [-1, 1]; 0 if either has no contrast.

    :param first: (..., G) grey values.
    :param second: (..., G), or (G,) to compare every row with one patch.
    :return: (...).
    """
    a, b = (p - p.mean(axis=-1, keepdims=True) for p in (first, second))
    length = np.sqrt(np.einsum('...g,...g', a, a) * np.einsum('...g,...g', b, b))
    return np.asarray(np.divide(np.einsum('...g,...g', a, b), length, out=np.zeros_like(length),
                                where=length > _NO_CONTRAST))
