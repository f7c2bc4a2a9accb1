# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Maxima to a fraction of a sample."""
from __future__ import annotations

import numpy as np

from ..core.records import Array

_LEAST_BEND = 1e-9  # avoids division by 0 at a flat top


def parabola_peak(scores: Array) -> tuple[Array, Array]:
    """
    Return the place of the greatest score along the first axis, and that score.

    The place is the vertex of the parabola through the greatest score and its neighbours, or the
    end if the greatest score is there.

    :param scores: (k, ...) scores, with k >= 3.
    :return: (...) places from 0 to k - 1, and (...) scores.
    """
    top = np.argmax(scores, axis=0)
    inner = np.clip(top, 1, len(scores) - 2)
    low, mid, high = (np.take_along_axis(scores, inner[None] + k, axis=0)[0] for k in (-1, 0, 1))
    bend = np.minimum(low - 2 * mid + high, -_LEAST_BEND)
    part = np.clip((low - high) / (2 * bend), -1.0, 1.0)
    return np.where(top == inner, inner + part, top), scores.max(axis=0)
