# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A robust estimate of scale, which outliers hardly affect."""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

SIGMAS_PER_MEDIAN = 1.4826  # ratio of a Gaussian's 1-sigma to its median absolute value


def robust_std(deviations: NDArray[np.floating[Any]]) -> float:
    """
    Return the 1-sigma of Gaussian deviations, fewer than half of which may be outliers.

    :param deviations: (...,) deviations from the expected value, not from their own median.
    """
    return SIGMAS_PER_MEDIAN * float(np.median(np.abs(deviations)))
