# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Robust scale: what outliers leave alone."""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SIGMAS_PER_MEDIAN = 1.4826  # 1-sigma of a normal variable over its median absolute value


def robust_std(deviations: NDArray[np.floating[Any]]) -> float:
    """
    Return the 1-sigma of normal deviations of which fewer than half may be outliers.

    :param deviations: (...,) from where they should be, which need not be their own median.
    """
    return SIGMAS_PER_MEDIAN * float(np.median(np.abs(deviations)))
