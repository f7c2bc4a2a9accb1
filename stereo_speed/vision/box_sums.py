# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Sums over sliding windows, by differences of running sums."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def window_sums(values: NDArray[np.floating], width: int) -> NDArray[np.float64]:
    """
    Return the sums over all windows of the last axis.

    :param values: (..., w + k) values.
    :param width: width w of the windows.
    :return: (..., k + 1) sums.
    """
    total = np.cumsum(values, axis=-1, dtype=np.float64)
    total = np.concatenate([np.zeros_like(total[..., :1]), total], axis=-1)
    return np.asarray(total[..., width:] - total[..., :-width])
