# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What the looks of a pass say of its poses: least squares on their grey values.

- *Cross*: the left and the right patch of a pair agree (2012, eq. 16), which fixes the depth.
- *Temporal*: every patch agrees with the one texture of the front, itself unknown and eliminated
  by its weighted mean (variable projection), which fixes the motion.

Noise is what the residuals show; below it lies a floor of systematic error (interpolation, relief,
light) that no number of samples averages away, so that a look is never believed beyond it.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from .looks import Look
from ..records import Array

_INDEPENDENT = 0.35  # share of independent samples after the low-pass of a look
_MATCH_FLOOR_PX = 0.02  # systematic matching error of one look between the views
_TEXTURE_FLOOR_PX = 0.04  # systematic error of one look against the texture: relief, light
_MIN_TEXTURE_NCC = 0.5  # looks that agree less with the texture are occluded: not used
_LEAST_VARIANCE = 1e-4


@dataclass(frozen=True, eq=False)
class Photometry:
    """
    The looks of a pass as normal equations about their poses.

    :param H: (3 n, 3 n) information about s, a, b of each look.
    :param g: (3 n,) minus the gradient at the poses of the looks.
    :param cross_ncc: (n,) left-right NCC of each look.
    :param texture_ncc: (n,) NCC of each look with the texture.
    """

    H: Array
    g: Array
    cross_ncc: Array
    texture_ncc: Array


def photometry(looks: Sequence[Look]) -> Photometry:
    """Write down the cross and the temporal terms of all looks."""
    n = len(looks)
    H, g = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    cross = np.zeros(n)
    for k, look in enumerate(looks):
        cross[k] = float(np.mean(look.patches[0] * look.patches[1]))
        block = slice(3 * k, 3 * k + 3)
        dH, dg = _cross_term(look)
        H[block, block] += dH
        g[block] += dg
    texture = _temporal_terms(looks, H, g)
    return Photometry(H, g, cross, texture)


def _cross_term(look: Look) -> tuple[Array, Array]:
    """Agreement of the left and the right patch of one pair, with its systematic floor."""
    J = look.jacobian[0] - look.jacobian[1]
    r = look.patches[0] - look.patches[1]
    variance = max(float(np.mean(np.square(r))), _LEAST_VARIANCE)
    weight = _INDEPENDENT * look.pixels / len(r) / variance
    info = weight * float(J[:, 0] @ J[:, 0])
    per_px = info / max(float(look.disparity_px[0] ** 2), 1e-12)
    weight /= 1 + (_MATCH_FLOOR_PX ** 2 + look.skew_px ** 2) * per_px
    return weight * J.T @ J, -weight * J.T @ r


def _temporal_terms(looks: Sequence[Look], H: Array, g: Array) -> Array:
    """Add the agreement with the texture to H and g; the NCC of each look with it."""
    n = len(looks)
    patches = np.stack([look.patches for look in looks])  # (n, 2, G)
    pixels = np.array([look.pixels for look in looks])
    mean = np.tensordot(pixels, patches.mean(axis=1), 1) / pixels.sum()
    ncc = np.array([np.corrcoef(p.mean(axis=0), mean)[0, 1] for p in patches])
    if n < 2:
        return ncc
    J = np.stack([look.jacobian for look in looks])  # (n, 2, G, 3)
    w = _temporal_weights(looks, patches - mean, J, ncc)
    total = 2 * w.sum()
    if total <= 0:
        return ncc
    texture = np.einsum('k,kvg->g', w, patches) / total
    residual = patches - texture
    summed = np.einsum('k,kvgi->gki', w, J).reshape(patches.shape[2], 3 * n)
    H -= summed.T @ summed / total
    for k in range(n):
        block = slice(3 * k, 3 * k + 3)
        flat = J[k].reshape(-1, 3)
        H[block, block] += w[k] * flat.T @ flat
        g[block] -= w[k] * flat.T @ residual[k].ravel()
    return ncc


def _temporal_weights(looks: Sequence[Look], residual: Array, J: Array, ncc: Array) -> Array:
    """Weight (n,) of a grey value of each look: its noise, and not beyond the floor."""
    w = np.zeros(len(looks))
    for k, look in enumerate(looks):
        if ncc[k] < _MIN_TEXTURE_NCC:
            continue
        variance = max(float(np.mean(np.square(residual[k]))), _LEAST_VARIANCE)
        share = _INDEPENDENT * look.pixels / residual.shape[2]
        info = share / variance * float(np.square(J[k, :, :, 1]).sum())
        per_px = info / max(float(look.shift_px[0, 1] ** 2), 1e-9)
        w[k] = share / variance / (1 + _TEXTURE_FLOOR_PX ** 2 * per_px)
    return w
