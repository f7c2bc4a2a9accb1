# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Likelihood of a batch of particles in both views (2012, eq. 12-18).

All particles are sampled by one ``cv2.remap`` a view, their features are matrix products.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .front import quad_grid
from ..core.config import TrackerConfig
from ..core.records import Array
from ..vision.haar import PartGrid
from ..vision.ncc import ncc

Patches = NDArray[np.float32]

_MARGIN_PX = 4
_BLOCK = 128  # particles sampled at once, so that their maps stay in the cache
_IMPOSSIBLE = -np.inf


def crop_for(image: NDArray[Any], low: Array, high: Array, step_px: float
             ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """
    Cut out the part of an image that samples need, low-passed to their spacing.

    :param low: (2,) least u, v of the samples, px.
    :param high: (2,) greatest u, v, px.
    :param step_px: spacing of the samples; detail finer than this would alias.
    :return: the crop as float32 and (2,) its origin in the image, px.
    """
    sigma = 0.5 * max(step_px - 1.0, 0.0)
    margin = _MARGIN_PX + int(np.ceil(3 * sigma))
    size = np.array(image.shape[1::-1])
    first = np.clip(np.floor(low).astype(int) - margin, 0, size - 2)
    last = np.clip(np.ceil(high).astype(int) + margin + 1, first + 2, size)
    crop = image[first[1]:last[1], first[0]:last[0]].astype(np.float32)
    if sigma > 0.1:
        crop = cv2.GaussianBlur(crop, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return crop, first.astype(np.float32)


def sample_quads(image: NDArray[Any], quads: Array, grid: PartGrid) -> Patches:
    """
    Sample the grid mapped onto each quadrilateral.

    :param quads: (N, 4, 2) finite corners in px.
    :return: (N, G) grey values; outside the image the border value repeats.
    """
    corners = quads.astype(np.float32)
    flat = corners.reshape(-1, 2)
    width = np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1))
    crop, origin = crop_for(image, flat.min(axis=0), flat.max(axis=0),
                            float(width) / grid.shape[1])
    out = np.empty((len(quads), len(grid.unit_xy)), np.float32)
    for k in range(0, len(quads), _BLOCK):
        u, v = quad_grid(corners[k:k + _BLOCK] - origin, grid.unit_xy)
        cv2.remap(crop, u, v, cv2.INTER_LINEAR, out[k:k + _BLOCK],
                  borderMode=cv2.BORDER_REPLICATE)
    return out


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
        """Blend in the features at the estimated state: g = eps g + (1 - eps) f (eq. 14)."""
        return Reference(*(_unit(epsilon * old + (1 - epsilon) * new)
                           for old, new in ((self.left, left), (self.right, right))))


@dataclass(frozen=True, eq=False)
class Scores:
    """
    What the images say of each particle.

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
    Evaluate all particles in one batch.

    :param quads: (N, 4, 2) corners in the left and the right view, px; NaN where not seen.
    :param reference: None scores the cross-view term alone (the first pair).
    """
    shown = [np.isfinite(q).all(axis=(1, 2)) for q in quads]
    seen = shown[0] & shown[1]
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
