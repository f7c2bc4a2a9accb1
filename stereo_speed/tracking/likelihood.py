# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Likelihood of a batch of particles in both views (2012, eq. 12-18).

All particles are sampled by one ``cv2.remap`` per view; their features are matrix products.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.records import Array
from ..core.tracker_config import TrackerConfig
from ..vision.haar import PartGrid
from ..vision.ncc import ncc
from ..vision.sampling import Patches, sample_quads

_IMPOSSIBLE = -np.inf
_LEAST_PX = 1.0  # least width and height of a front that shows any texture


@dataclass(frozen=True, eq=False)
class Reference:
    """
    Reference features g of both views (eq. 14).

    :param left: (16 N_p,) of unit length.
    :param right: (16 N_p,) of unit length.
    """

    left: Patches
    right: Patches

    def updated(self, left: Patches, right: Patches, epsilon: float) -> Reference:
        """Return g = eps g + (1 - eps) f of the features f at the estimated state (eq. 14)."""
        return Reference(*(_unit(epsilon * old + (1 - epsilon) * new)
                           for old, new in ((self.left, left), (self.right, right))))


@dataclass(frozen=True, eq=False)
class Scores:
    """
    Scores of particles by the images.

    :param log_likelihood: (N,) logarithm of eq. 12; -inf where the front is not seen.
    :param cross_ncc: (N,) left-right NCC (eq. 17).
    :param left: (N, 16 N_p) features in the left view.
    :param right: (N, 16 N_p) features in the right view.
    """

    log_likelihood: Array
    cross_ncc: Array
    left: Patches
    right: Patches


def score(left_image: NDArray[Any], right_image: NDArray[Any], quads: tuple[Array, Array],
          reference: Reference | None, *, grid: PartGrid, config: TrackerConfig) -> Scores:
    """
    Return the scores of all particles, in one batch.

    :param quads: (N, 4, 2) corners in the left and the right view, px; NaN where not seen.
    :param reference: reference features; None to score the cross-view term alone (first pair).
    """
    size_px = np.min([np.ptp(q, axis=1) for q in quads], axis=(0, 2))
    seen = np.isfinite(size_px) & (size_px >= _LEAST_PX)
    if not seen.any():
        empty = np.zeros((len(seen), grid.size), np.float32)
        return Scores(np.full(len(seen), _IMPOSSIBLE), np.zeros(len(seen)), empty, empty)
    fill = int(np.argmax(seen))
    patches = [sample_quads(image, np.where(seen[:, None, None], q, q[fill]), grid)
               for image, q in zip((left_image, right_image), quads)]
    features = [grid.features(p) for p in patches]
    cross = ncc(patches[0], patches[1]).astype(float)
    log_l = -config.lambda_c * np.square(1 - cross)  # eq. 18
    if reference is not None:
        for f, g in zip(features, (reference.left, reference.right)):
            log_l = log_l - config.lambda_d * np.square(f - g).sum(axis=1)  # eq. 13
    return Scores(np.where(seen, log_l, _IMPOSSIBLE), cross, features[0], features[1])


def _unit(vector: Patches) -> Patches:
    return vector / max(float(np.linalg.norm(vector)), 1e-6)
