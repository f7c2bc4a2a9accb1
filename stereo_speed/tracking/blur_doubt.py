# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Uncertainty of a pass from making both views equally sharp.

The image of a lens out of focus, of clipped lamps most of all, is not just a blurred sharp image.
The change of the states with less blur shows how large the error may be.
"""
from __future__ import annotations

from typing import Optional, Sequence

import numpy as np

from .posterior import Posterior
from ..core.records import Array


def doubt_of_blur(posterior: Posterior, others: Sequence[Optional[Posterior]], share: float,
                  unknown_mps: float) -> Array:
    """
    Return the covariance (4 n, 4 n) to add to a pass of n pairs for its blurring.

    :param posterior: posterior of the pass.
    :param others: posteriors with less blur, possibly of fewer pairs; None for one that could not
        be solved.
    :param share: share of each change that counts as a 1-sigma.
    :param unknown_mps: 1-sigma, common to all speeds, for a posterior that is missing, m/s.
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
    """Return the change (n, 4) of the states, interpolated for pairs that the other lacks."""
    at_s = (other.first_ns - posterior.first_ns) * 1e-9 + other.stamps_s
    both = np.flatnonzero(np.isin(_stamps_ns(posterior), _stamps_ns(other)))
    change = other.mean - posterior.mean[both]
    return np.column_stack([np.interp(posterior.stamps_s, at_s, one) for one in change.T])


def _stamps_ns(posterior: Posterior) -> Array:
    """Return the stamps (n,) of a posterior's pairs, ns."""
    return posterior.first_ns + np.rint(posterior.stamps_s * 1e9)
