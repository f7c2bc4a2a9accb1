# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What the observations of a pass say of its poses: least squares on their grey values.

- *Cross*: the left and the right patch of a pair agree (2012, eq. 16), which fixes the depth.
- *Temporal*: every patch agrees with the one texture of the front, itself unknown and eliminated
  by its weighted mean (variable projection), which fixes the motion.

Noise is what the residuals show; below it lies a floor of systematic error (interpolation, relief,
light) that no number of samples averages away, so that an observation is never believed beyond it.

A front that is occluded in part, by a pole or another vehicle, still looks much like itself, but
what occludes it moves otherwise and would drag it along: such an observation agrees worse than the
best do, and counts for nothing.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .observation import Observation
from ..core.config import NoiseConfig, VisibilityConfig
from ..core.records import Array
from ..vision.ncc import ncc as correlation

_LEAST_VARIANCE = 1e-4  # of residuals, in those of a patch: identical patches prove little


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
        """Return which observations (n,) agree about as well as the best do: nothing occludes."""
        agree = [_lacks_little(ncc, self.limits) for ncc in (self.cross_ncc, self.texture_ncc)]
        return np.asarray(self.seen & agree[0] & agree[1])


def _lacks_little(ncc: Array, limits: VisibilityConfig) -> NDArray[np.bool_]:
    """Return which observations (n,) lack little more than noise makes the best ones lack."""
    lack = 1 - ncc
    noise = np.quantile(lack, limits.occlusion_best_share)
    return np.asarray(lack <= limits.occlusion_deficit + limits.occlusion_noise_factor * noise)


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
        r = observation.patches[0] - observation.patches[1]
        variance = max(float(np.mean(np.square(r))), _LEAST_VARIANCE)
        weight = self.noise.independent_share * observation.pixels / len(r) / variance
        info = weight * float(J[0] @ J[0])
        per_px = info / max(float(observation.disparity_px[0] ** 2), 1e-12)
        weight /= 1 + (self.noise.match_floor_px ** 2 + observation.skew_px ** 2) * per_px
        relief = observation.relief_jacobian[0] - observation.relief_jacobian[1]
        both = np.concatenate([J, relief * self.basis])
        # As the residual would be on a plane, to first order.
        flat = r - relief * (observation.relief @ self.basis)
        return weight * both @ both.T, -weight * both @ flat

    def _add_temporal_terms(self, observations: Sequence[Observation],
                            counts: NDArray[np.bool_], patches: Array, H: Array, g: Array
                            ) -> Array:
        """Add the agreement with the texture to H and g; return each observation's NCC with it."""
        n, m = len(observations), len(self.basis)
        pixels = np.where(counts, [o.pixels for o in observations], 0.0)
        both = patches.mean(axis=1)
        mean = pixels @ both / pixels.sum()
        ncc = correlation(both, mean)
        if n < 2:
            return ncc
        J = np.stack([o.jacobian for o in observations])  # (n, 2, 3, G)
        D = np.stack([o.relief_jacobian for o in observations])  # (n, 2, G)
        w = np.where(counts, self._temporal_weights(observations, patches - mean, J, ncc), 0.0)
        total = 2 * w.sum()
        if total <= 0:
            return ncc
        relief = np.stack([o.relief for o in observations]) @ self.basis
        flat = patches - D * relief[:, None]  # as they would be on a plane, to first order
        residual = flat - w @ flat.sum(axis=1) / total
        # The texture is eliminated: what all observations would have in common says nothing.
        by_pose = w[:, None, None] * J.sum(axis=1)
        summed = np.concatenate([by_pose.reshape(3 * n, -1), w @ D.sum(axis=1) * self.basis])
        H -= summed @ summed.T / total
        nodes = slice(3 * n, 3 * n + m)
        H[nodes, nodes] += (w @ np.square(D).sum(axis=1) * self.basis) @ self.basis.T
        g[nodes] -= self.basis @ (w @ (D * residual).sum(axis=1))
        weighted = w[:, None, None, None] * J
        blocks = (weighted @ J.swapaxes(2, 3)).sum(axis=1)  # (n, 3, 3)
        mixed = (weighted * D[:, :, None]).sum(axis=1) @ self.basis.T  # (n, 3, m)
        for k in range(n):
            block = slice(3 * k, 3 * k + 3)
            H[block, block] += blocks[k]
            H[block, nodes] += mixed[k]
            H[nodes, block] += mixed[k].T
        g[:3 * n] -= (weighted @ residual[..., None]).sum(axis=1).ravel()
        return ncc

    def _temporal_weights(self, observations: Sequence[Observation], residual: Array, J: Array,
                          ncc: Array) -> Array:
        """Return the weight (n,) of a grey value of each: its noise, and not beyond the floor."""
        pixels = np.array([o.pixels for o in observations])
        shift_px = np.array([o.shift_px[0, 1] for o in observations])
        variance = np.maximum(np.square(residual).mean(axis=(1, 2)), _LEAST_VARIANCE)
        w = self.noise.independent_share * pixels / residual.shape[2] / variance
        per_px = w * np.square(J[:, :, 1]).sum(axis=(1, 2)) / np.maximum(shift_px ** 2, 1e-9)
        floor = self.noise.texture_floor_px ** 2 * per_px
        return np.where(ncc < self.limits.least_ncc, 0.0, w / (1 + floor))
