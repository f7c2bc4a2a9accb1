# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Histograms of grey levels and outline gradients of many quadrilaterals, as cues of their content.

Histograms are compared by the Bhattacharyya coefficient, as P. Perez, C. Hue, J. Vermaak, M.
Gangnet, "Color-based probabilistic tracking", ECCV 2002, do for colours (the 2012 paper's
reference [4]). Gradients along the outline follow S. Birchfield, "Elliptical head tracking using
intensity gradients and color histograms", CVPR 1998.
"""
from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ...core.records import Array
from ...vision.haar import PartGrid
from ...vision.sampling import low_pass_crop, sample_quads

BINS = 16
_EDGE_SAMPLES = 12  # samples along each side of a quad
_GRADIENT_BLUR_PX = 1.0  # blur before the gradient, against noise of single pixels
_MARGIN_PX = 3  # margin around the quads, for the blur


def histograms(image: NDArray[np.uint8], quads: Array, grid: PartGrid) -> Array:
    """
    Return the histogram of the grey levels in each quad.

    Samples near the outline, which most likely show background, have less weight (Epanechnikov
    kernel).

    :param quads: (N, 4, 2) finite corners, px.
    :param grid: samples of a quad.
    :return: (N, BINS), rows that sum to one.
    """
    patches = sample_quads(image, quads, grid)
    bins = np.clip(patches * np.float32(BINS / 256), 0, BINS - 1).astype(np.intp)
    kernel = 1 - 0.5 * np.square(2 * grid.unit_xy - 1).sum(axis=1)
    at = bins + BINS * np.arange(len(bins))[:, None]
    weights = np.broadcast_to(kernel / kernel.sum(), bins.shape)
    counts = np.bincount(at.ravel(), weights.ravel(), BINS * len(bins))
    return np.asarray(counts.reshape(len(bins), BINS))


def bhattacharyya(first: Array, second: Array) -> Array:
    """
    Return the Bhattacharyya coefficient of histograms: 0 for disjoint, 1 for equal ones.

    :param first: (..., B) histograms that sum to 1.
    :param second: (B,) or (..., B).
    """
    return np.asarray(np.sqrt(first * second).sum(axis=-1))


def outline_gradient(image: NDArray[np.uint8], quads: Array) -> Array:
    """
    Return the mean gradient across the outline of each quad, grey levels per pixel.

    :param quads: (N, 4, 2) finite corners, px.
    :return: (N,).
    """
    flat = quads.reshape(-1, 2)
    part, origin = low_pass_crop(
        image, flat.min(axis=0) - _MARGIN_PX, flat.max(axis=0) + _MARGIN_PX, 1.0)
    smooth = cv2.GaussianBlur(part, (0, 0), _GRADIENT_BLUR_PX)
    slope_v, slope_u = np.gradient(smooth)
    ends = np.roll(quads, -1, axis=1)
    share = (np.arange(_EDGE_SAMPLES) + 0.5) / _EDGE_SAMPLES
    along = ends - quads
    at = quads[:, :, None] + share[:, None] * along[:, :, None]  # (N, 4, K, 2)
    u, v = ((at[..., k] - origin[k]).reshape(len(quads), -1).astype(np.float32) for k in (0, 1))
    du, dv = (_sampled(np.ascontiguousarray(s), u, v) for s in (slope_u, slope_v))
    length = np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-6)
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1) / length
    normal = np.repeat(normal, _EDGE_SAMPLES, axis=1)
    return np.asarray(np.abs(du * normal[..., 0] + dv * normal[..., 1]).mean(axis=1))


def _sampled(image: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32]
             ) -> NDArray[np.float32]:
    """Sample an image at (N, K) pixels, in parts because of the size limit of ``cv2.remap``."""
    step = 1 << 14
    return np.concatenate([
        cv2.remap(image, u[k:k + step], v[k:k + step], cv2.INTER_LINEAR,
                  borderMode=cv2.BORDER_REPLICATE) for k in range(0, len(u), step)])
