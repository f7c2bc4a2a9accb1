# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Resampling of weighted particles."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.records import Array


def systematic(weights: Array, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """
    Draw ancestors by systematic resampling: one uniform number, ``count`` equal steps.

    Each particle is drawn floor or ceil of ``count * weight`` times (Arulampalam et al. 2002,
    algorithm 2, the paper's reference [15]).

    :param weights: (N,) normalised weights.
    :param count: number of ancestors to draw.
    :param rng: source of randomness.
    :return: (count,) indices into the particles, ascending.
    """
    positions = (rng.random() + np.arange(count)) / count
    # Rounding may leave the last sum just below 1; the last particle gets the rest.
    cumulative = np.cumsum(weights)
    cumulative[-1] = 1.0
    return np.searchsorted(cumulative, positions, side='right').clip(0, len(weights) - 1)
