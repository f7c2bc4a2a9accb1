# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What the observations of a pass say of its poses: least squares on their grey values.

- *Cross*: the left and the right patch of a pair agree (2012, eq. 16), which fixes the depth.
- *Temporal*: every patch agrees with the one texture of the front, itself unknown and eliminated
  by its weighted mean (variable projection), which fixes the motion.

A grey value counts by its own evidence.  Lamps that clip keep their size in pixels while the front
grows, reflections slide over the paint, dirt on the glass stays where it is: their residuals have
heavy tails, and each is weighed by the t distribution, between the views and over time.

Noise is what the residuals show; below it lies a floor of systematic error (interpolation, relief,
light) that no number of samples averages away, so that an observation is never believed beyond it.

A front that is occluded in part, by a pole or another vehicle, still looks much like itself, but
what occludes it moves otherwise and would drag it along: such an observation agrees worse than the
best do, between the views too, and counts for nothing.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .observation import Observation
from ..core.config import NoiseConfig, VisibilityConfig
from ..core.records import Array
from ..estimation.student import student_weights
from ..vision.ncc import ncc as correlation

_LEAST_VARIANCE = 1e-4  # of residuals, in those of a patch: identical patches prove little
_ROUNDS = 3  # of texture, gains and weights, each of which follows from the others


@dataclass(frozen=True, eq=False)
class Photometry:
    """
    The observations of a pass as normal equations about their poses and the relief of the front.

    :param H: (3 n + m, 3 n + m) information about s, a, b of each observation and the relief.
    :param right: (3 n + m,) information times measurement.
    :param cross_ncc: (n,) left-right NCC of each observation.
    :param texture_ncc: (n,) NCC of each observation with the texture.
    :param limits: when an observation shows the vehicle, and the whole of it.
    """

    H: Array
    right: Array
    cross_ncc: Array
    texture_ncc: Array
    limits: VisibilityConfig

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Return which observations (n,) show the vehicle at all."""
        return np.asarray(
            np.minimum(self.cross_ncc, self.texture_ncc) >= self.limits.least_ncc)

    @property
    def unoccluded(self) -> NDArray[np.bool_]:
        """
        Return which observations (n,) agree about as well as the best do: nothing occludes.

        What occludes lies nearer, so that the views disagree, too.  While they agree as well as
        noise allows, it is light that has changed: a reflection, an exposure.
        """
        cross, texture = (_lack(ncc, self.limits) for ncc in (self.cross_ncc, self.texture_ncc))
        deficit = self.limits.occlusion_deficit
        return np.asarray(self.seen & (cross <= deficit) & ((texture <= deficit) | (cross <= 0)))


def _lack(ncc: Array, limits: VisibilityConfig) -> Array:
    """Return by how much observations (n,) lack more than noise makes the best ones lack."""
    lack = 1 - ncc
    noise = np.quantile(lack, limits.occlusion_best_share)
    return np.asarray(lack - limits.occlusion_noise_factor * noise)


class PassPhotometry:
    """
    Turns the observations of a pass into normal equations.

    :param basis: (G, m) share of the relief's nodes in each sample.
    :param noise: how precise observations are.
    :param limits: when they show the vehicle, and the whole of it.
    """

    def __init__(self, basis: Array, noise: NoiseConfig, limits: VisibilityConfig) -> None:
        self.basis, self.noise, self.limits = np.ascontiguousarray(basis.T), noise, limits
        self._cross: dict[Observation, tuple[Array, Array]] = {}

    def __call__(self, observations: Sequence[Observation],
                 counts: Optional[NDArray[np.bool_]] = None) -> Photometry:
        """
        Return the normal equations of the cross and the temporal terms.

        :param counts: (n,) whether each observation does, one at least; None for all.
        """
        n, m = len(observations), len(self.basis)
        counts = np.ones(n, dtype=bool) if counts is None else counts
        H, g = np.zeros((3 * n + m, 3 * n + m)), np.zeros(3 * n + m)
        # The cross term of an observation is its own; it is made once and kept while that is.
        self._cross = {o: self._cross.get(o) or self._cross_term(o) for o in observations}
        for k, observation in enumerate(observations):
            if counts[k]:
                dH, dg = self._cross[observation]
                at = np.r_[3 * k:3 * k + 3, 3 * n:3 * n + m]
                H[np.ix_(at, at)] += dH
                g[at] += dg
        patches = np.stack([o.patches for o in observations])  # (n, 2, G)
        texture = self._add_temporal_terms(observations, counts, patches, H, g)
        cross = np.einsum('ng,ng->n', patches[:, 0], patches[:, 1]) / patches.shape[2]
        at_poses = np.concatenate([o.pose for o in observations] + [np.zeros(m)])
        return Photometry(H, g + H @ at_poses, cross, texture, self.limits)

    def _cross_term(self, observation: Observation) -> tuple[Array, Array]:
        """Return the agreement of the two patches of one pair: (3 + m, 3 + m) and (3 + m,)."""
        J = observation.jacobian[0] - observation.jacobian[1]
        left, right = observation.patches
        outlines = _orthonormal(observation.outlines)
        weights = np.ones((1, len(left)))
        for _ in range(_ROUNDS):
            residual = _without(outlines, _beside(left[None], right, weights))
            weights, variance = self._student(residual, weights)
        r, J = residual[0], _without(outlines, J)
        w = self.noise.independent_share * observation.pixels / len(r) / variance * weights[0]
        per_px = float(w @ np.square(J[0])) / max(float(observation.disparity_px[0] ** 2), 1e-12)
        w = w / (1 + (self.noise.match_floor_px ** 2 + observation.skew_px ** 2) * per_px)
        relief = observation.relief_jacobian[0] - observation.relief_jacobian[1]
        both = np.concatenate([J, relief * self.basis])
        # As the residual would be on a plane, to first order.
        flat = r - relief * (observation.relief @ self.basis)
        return (w * both) @ both.T, -both @ (w * flat)

    def _student(self, residual: Array, weights: Array) -> tuple[Array, Array]:
        return student_weights(residual, weights, self.noise.tail_dof, _LEAST_VARIANCE)

    def _add_temporal_terms(self, observations: Sequence[Observation],
                            counts: NDArray[np.bool_], patches: Array, H: Array, g: Array
                            ) -> Array:
        """Add the agreement with the texture to H and g; return each observation's NCC with it."""
        n, m = len(observations), len(self.basis)
        pixels = np.where(counts, [o.pixels for o in observations], 0.0)
        both = patches.mean(axis=1)
        ncc = correlation(both, pixels @ both / pixels.sum())
        pixels[ncc < self.limits.least_ncc] = 0.0
        if n < 2 or not pixels.any():
            return ncc
        J = np.stack([o.jacobian for o in observations])  # (n, 2, 3, G)
        D = np.stack([o.relief_jacobian for o in observations])  # (n, 2, G)
        residual, w = self._temporal_residuals(observations, patches, pixels, J)
        relief = np.stack([o.relief for o in observations]) @ self.basis
        flat = residual - D * relief[:, None]  # as they would be on a plane, to first order
        total = w.sum(axis=(0, 1))
        flat = flat - (w * flat).sum(axis=(0, 1)) / total
        # The texture is eliminated: what all observations would have in common says nothing.
        weighted, shared = w[:, :, None] * J, w * D
        summed = np.concatenate([weighted.sum(axis=1).reshape(3 * n, -1),
                                 shared.sum(axis=(0, 1)) * self.basis])
        H -= (summed / total) @ summed.T
        nodes = slice(3 * n, 3 * n + m)
        H[nodes, nodes] += ((shared * D).sum(axis=(0, 1)) * self.basis) @ self.basis.T
        g[nodes] -= self.basis @ (shared * flat).sum(axis=(0, 1))
        blocks = (weighted @ J.swapaxes(2, 3)).sum(axis=1)  # (n, 3, 3)
        mixed = (weighted * D[:, :, None]).sum(axis=1) @ self.basis.T  # (n, 3, m)
        for k in range(n):
            block = slice(3 * k, 3 * k + 3)
            H[block, block] += blocks[k]
            H[block, nodes] += mixed[k]
            H[nodes, block] += mixed[k].T
        g[:3 * n] -= (weighted @ flat[..., None]).sum(axis=1).ravel()
        return ncc

    def _temporal_residuals(self, observations: Sequence[Observation], patches: Array,
                            pixels: Array, J: Array) -> tuple[Array, Array]:
        """
        Return what the texture does not explain, and the weight of each grey value in that.

        :param patches: (n, 2, G).
        :param pixels: (n,) pixels that each observation counts with, 0 for none.
        :param J: (n, 2, 3, G) derivatives of the patches.
        :return: (n, 2, G) residuals, (n, 2, G) weights, not beyond the floor.
        """
        n, _, samples = patches.shape
        outlines = np.concatenate([o.outlines for o in observations])  # (2 n, G)
        weights = np.ones_like(patches)
        for _ in range(_ROUNDS):
            share = pixels[:, None, None] * weights
            texture = (share * patches).sum(axis=(0, 1)) / share.sum(axis=(0, 1))
            residual = _beside(patches.reshape(2 * n, -1), texture, weights.reshape(2 * n, -1))
            residual = residual - np.einsum('ng,ng->n', residual, outlines)[:, None] * outlines
            rows, variance = self._student(residual.reshape(n, -1), weights.reshape(n, -1))
            weights = rows.reshape(patches.shape)
        scale = self.noise.independent_share * pixels / samples / variance
        w = scale[:, None, None] * weights
        shift_px = np.array([o.shift_px[0, 1] for o in observations])
        per_px = (w * np.square(J[:, :, 1])).sum(axis=(1, 2)) / np.maximum(shift_px ** 2, 1e-9)
        floor = self.noise.texture_floor_px ** 2 * per_px
        return residual.reshape(patches.shape), w / (1 + floor)[:, None, None]


def _beside(patches: Array, texture: Array, weights: Array) -> Array:
    """
    Return patches (N, G) less the gain and the level of a texture (G,) that fit each best.

    :param weights: (N, G) of the samples.  What is an outlier has changed gain and level, too.
    """
    share = weights / weights.sum(axis=1, keepdims=True)
    deviation = texture - (share @ texture)[:, None]
    patches = patches - (share * patches).sum(axis=1, keepdims=True)
    along = share * deviation
    gain = (along * patches).sum(axis=1) / np.maximum((along * deviation).sum(axis=1), 1e-12)
    return np.asarray(patches - gain[:, None] * deviation)


def _orthonormal(rows: Array) -> Array:
    """Return an orthonormal basis (q, G) of what rows (n, G) of unit length, or 0, span."""
    size, basis = np.linalg.svd(rows, full_matrices=False)[1:]
    return np.asarray(basis[size > 1e-3])


def _without(basis: Array, rows: Array) -> Array:
    """Return rows (n, G) without their parts along an orthonormal basis (q, G)."""
    return np.asarray(rows - (rows @ basis.T) @ basis)
