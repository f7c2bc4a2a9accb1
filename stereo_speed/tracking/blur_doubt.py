# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What making both views equally sharp leaves in doubt of a pass.

What a lens out of focus makes of a front, of lamps that clip first of all, is no blur of what a
sharp one shows: states with less of it are as far off as these may be.
"""
from __future__ import annotations

from typing import Optional, Sequence

import numpy as np

from .posterior import Posterior
from ..core.records import Array


def doubt_of_blur(posterior: Posterior, others: Sequence[Optional[Posterior]], share: float,
                  unknown_mps: float) -> Array:
    """
    Return what blurring adds to the covariance (4 n, 4 n) of a pass of n pairs.

    :param posterior: of the pass, and
    :param others: with less of the blur, maybe of fewer pairs; None where it cannot be solved.
    :param share: of each change that counts as a 1-sigma.
    :param unknown_mps: 1-sigma, common to all speeds, where there is none to compare with.
    """
    doubt = np.zeros_like(posterior.covariance)
    for other in others:
        if other is None:
            change = np.zeros_like(posterior.mean)
            change[:, 3] = unknown_mps
        else:
            change = share * _change(posterior, other)
        doubt += np.outer(change, change)
    return doubt


def _change(posterior: Posterior, other: Posterior) -> Array:
    """Return how much the states (n, 4) change, in pairs that the other lacks as beside them."""
    at_s = (other.first_ns - posterior.first_ns) * 1e-9 + other.stamps_s
    both = np.flatnonzero(np.isin(_stamps_ns(posterior), _stamps_ns(other)))
    change = other.mean - posterior.mean[both]
    return np.column_stack([np.interp(posterior.stamps_s, at_s, one) for one in change.T])


def _stamps_ns(posterior: Posterior) -> Array:
    """Return the stamps (n,) of its pairs, ns."""
    return posterior.first_ns + np.rint(posterior.stamps_s * 1e9)
