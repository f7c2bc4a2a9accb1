# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What the looks of a pass say of its poses: least squares on their grey values.

- *Cross*: the left and the right patch of a pair agree (2012, eq. 16), which fixes the depth.
- *Temporal*: every patch agrees with the one texture of the front, itself unknown and eliminated
  by its weighted mean (variable projection), which fixes the motion.

Noise is what the residuals show; below it lies a floor of systematic error (interpolation, relief,
light) that no number of samples averages away, so that a look is never believed beyond it.

A front that is hidden in part, by a pole or another vehicle, still looks much like itself, but
what hides it moves otherwise and would drag it along: such a look agrees worse than the best do,
and counts for nothing.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence

import numpy as np

from .observation import Observation
from ..core.records import Array
from ..vision.ncc import ncc as correlation

_INDEPENDENT = 0.35  # share of independent samples after the low-pass of a look
_MATCH_FLOOR_PX = 0.0125  # systematic matching error of one look between the views
_TEXTURE_FLOOR_PX = 0.025  # systematic error of one look against the texture: relief, light
_MIN_NCC = 0.5  # left-right and texture agreement below this is not the vehicle
_HIDDEN_LACK = 0.03  # of agreement, beyond
_NOISE_LACKS = 3.0  # times that of the best looks, which is noise, is of looks hidden in part
_BEST = 0.1  # share of them
_LEAST_VARIANCE = 1e-4


@dataclass(frozen=True, eq=False)
class Photometry:
    """
    The looks of a pass as normal equations about their poses and the relief of the front.

    :param H: (3 n + m, 3 n + m) information about s, a, b of each look and the relief's m nodes.
    :param right: (3 n + m,) information times measurement.
    :param cross_ncc: (n,) left-right NCC of each look.
    :param texture_ncc: (n,) NCC of each look with the texture.
    """

    H: Array
    right: Array
    cross_ncc: Array
    texture_ncc: Array

    def seen(self) -> Array:
        """Tell which looks (n,) show the vehicle at all."""
        return np.minimum(self.cross_ncc, self.texture_ncc) >= _MIN_NCC

    def clear(self) -> Array:
        """Tell which looks (n,) agree about as well as the best do: nothing hides the front."""
        return self.seen() & _whole(self.cross_ncc) & _whole(self.texture_ncc)


def _whole(ncc: Array) -> Array:
    """Tell which looks (n,) lack little more agreement than noise makes the best ones lack."""
    lack = 1 - ncc
    return np.asarray(lack <= _HIDDEN_LACK + _NOISE_LACKS * np.quantile(lack, _BEST))


class PassPhotometry:
    """
    Writes down the looks of a pass again and again as they are retaken.

    :param basis: (G, m) share of the relief's nodes in each sample.
    """

    def __init__(self, basis: Array) -> None:
        self.basis = np.ascontiguousarray(basis.T)
        self._cross: dict[int, tuple[Observation, Array, Array]] = {}

    def __call__(self, looks: Sequence[Observation], counts: Optional[Array] = None) -> Photometry:
        """
        Write down the cross and the temporal terms of the looks.

        :param counts: (n,) whether each look does, one at least; None for all.
        """
        n, m = len(looks), len(self.basis)
        counts = np.ones(n, dtype=bool) if counts is None else counts
        H, g = np.zeros((3 * n + m, 3 * n + m)), np.zeros(3 * n + m)
        # The cross term of a look is its own; it is made once and kept while the look is.
        self._cross = {id(look): self._cross.get(id(look)) or (
            look, *_cross_term(look, self.basis)) for look in looks}
        for k in np.flatnonzero(counts):
            _, dH, dg = self._cross[id(looks[k])]
            at = np.r_[3 * k:3 * k + 3, 3 * n:3 * n + m]
            H[np.ix_(at, at)] += dH
            g[at] += dg
        patches = np.stack([look.patches for look in looks])  # (n, 2, G)
        texture = _add_temporal_terms(looks, counts, patches, self.basis, H, g)
        cross = np.einsum('ng,ng->n', patches[:, 0], patches[:, 1]) / patches.shape[2]
        at = np.concatenate([look.pose for look in looks] + [np.zeros(m)])
        return Photometry(H, g + H @ at, cross, texture)


def _cross_term(look: Observation, basis: Array) -> tuple[Array, Array]:
    """
    Agreement of the left and the right patch of one pair: (3 + m, 3 + m) and (3 + m,).

    :param basis: (m, G).
    """
    J = look.jacobian[0] - look.jacobian[1]
    r = look.patches[0] - look.patches[1]
    variance = max(float(np.mean(np.square(r))), _LEAST_VARIANCE)
    weight = _INDEPENDENT * look.pixels / len(r) / variance
    info = weight * float(J[0] @ J[0])
    per_px = info / max(float(look.disparity_px[0] ** 2), 1e-12)
    weight /= 1 + (_MATCH_FLOOR_PX ** 2 + look.skew_px ** 2) * per_px
    relief = look.relief_jacobian[0] - look.relief_jacobian[1]
    both = np.concatenate([J, relief * basis])
    flat = r - relief * (look.relief @ basis)  # as it would be on a plane, to first order
    return weight * both @ both.T, -weight * both @ flat


def _add_temporal_terms(looks: Sequence[Observation], counts: Array, patches: Array, basis: Array,
                        H: Array, g: Array) -> Array:
    """Add the agreement with the texture to H and g; the NCC of each look with it."""
    n, m = len(looks), len(basis)
    pixels = np.where(counts, [look.pixels for look in looks], 0.0)
    both = patches.mean(axis=1)
    mean = pixels @ both / pixels.sum()
    ncc = correlation(both, mean)
    if n < 2:
        return ncc
    J = np.stack([look.jacobian for look in looks])  # (n, 2, 3, G)
    D = np.stack([look.relief_jacobian for look in looks])  # (n, 2, G)
    w = np.where(counts, _temporal_weights(looks, patches - mean, J, ncc), 0.0)
    total = 2 * w.sum()
    if total <= 0:
        return ncc
    relief = np.stack([look.relief for look in looks]) @ basis
    flat = patches - D * relief[:, None]  # as they would be on a plane, to first order
    residual = flat - w @ flat.sum(axis=1) / total
    # The texture is eliminated: what all looks would have in common says nothing.
    by_pose = w[:, None, None] * J.sum(axis=1)
    summed = np.concatenate([by_pose.reshape(3 * n, -1), w @ D.sum(axis=1) * basis])
    H -= summed @ summed.T / total
    nodes = slice(3 * n, 3 * n + m)
    H[nodes, nodes] += (w @ np.square(D).sum(axis=1) * basis) @ basis.T
    g[nodes] -= basis @ (w @ (D * residual).sum(axis=1))
    weighted = w[:, None, None, None] * J
    blocks = (weighted @ J.swapaxes(2, 3)).sum(axis=1)  # (n, 3, 3)
    mixed = (weighted * D[:, :, None]).sum(axis=1) @ basis.T  # (n, 3, m)
    for k in range(n):
        block = slice(3 * k, 3 * k + 3)
        H[block, block] += blocks[k]
        H[block, nodes] += mixed[k]
        H[nodes, block] += mixed[k].T
    g[:3 * n] -= (weighted @ residual[..., None]).sum(axis=1).ravel()
    return ncc


def _temporal_weights(looks: Sequence[Observation], residual: Array, J: Array, ncc: Array) -> Array:
    """Weight (n,) of a grey value of each look: its noise, and not beyond the floor."""
    pixels = np.array([look.pixels for look in looks])
    shift_px = np.array([look.shift_px[0, 1] for look in looks])
    variance = np.maximum(np.square(residual).mean(axis=(1, 2)), _LEAST_VARIANCE)
    w = _INDEPENDENT * pixels / residual.shape[2] / variance
    per_px = w * np.square(J[:, :, 1]).sum(axis=(1, 2)) / np.maximum(shift_px ** 2, 1e-9)
    return np.where(ncc < _MIN_NCC, 0.0, w / (1 + _TEXTURE_FLOOR_PX ** 2 * per_px))
