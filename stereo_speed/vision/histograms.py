# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of histograms."""
from __future__ import annotations

import numpy as np

from ..core.records import Array


def bhattacharyya(first: Array, second: Array) -> Array:
    """
    Return the Bhattacharyya coefficient of histograms: 0 for disjoint, 1 for equal ones.

    :param first: (..., B) histograms that sum to 1.
    :param second: (B,) or (..., B).
    """
    return np.asarray(np.sqrt(first * second).sum(axis=-1))
