# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The equations of the observations of a pass for its poses: least squares on grey values.

- *Cross*: the left and the right patch of a pair agree (2012, eq. 16), which fixes the depth.
- *Temporal*: every patch agrees with the texture of the front, which fixes the motion.  The
  texture is unknown, and eliminated by its weighted mean (variable projection).

Each grey value has its own weight.  Clipped lamps keep their size in pixels while the front grows,
reflections slide over the paint, dirt on the glass stays in place: residuals have heavy tails, so
they are weighted by the t distribution, between the views and over time.  How much each
observation is blurred is unknown; the lens blurs a front more the further away it is.

The noise is estimated from the residuals.  In addition there is a floor of systematic error
(interpolation, relief, light) that does not average out over samples and limits the weight of an
observation.  Edges of clipped lamps, and image compression, shift the disparity of each pair
differently.  The scatter of the disparities of a pass is therefore unknown, and weighed by
evidence like the motion models.

A front that is partly occluded, by a pole or another vehicle, still looks much like itself, but
what occludes it moves differently and would drag it along.  Such an observation agrees worse than
the best ones do, also between the views, and does not count.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Callable, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .observation import Observation
from .observation_table import Columns, LEAST_SQUARE, ObservationTable
from .photometric_terms import temporal, TemporalTerms
from ..core.records import Array
from ..core.tracker_config import NoiseConfig, VisibilityConfig
from ..estimation.weights import normalise_log_weights
from ..vision.ncc import ncc as correlation


@dataclass(frozen=True, eq=False)
class Equations:
    """
    Normal equations of the images for poses and relief.

    :param H: (k, k) information.
    :param right: (k,) information times measurement.
    :param log_density: logarithm of the density of the measurements where the unknowns are 0, up
        to a constant that is the same for all scatters.
    """

    H: Array
    right: Array
    log_density: float


@dataclass(frozen=True, eq=False)
class Photometry:
    """
    The normal equations of a pass's observations for their poses and the relief of the front.

    There are k = 3 n + m unknowns: s, a, b of each observation and the relief.  Where the views
    have two stamps there are k = 5 n + m.  The speeds come before the relief, because the front
    moves on until the right view is exposed.  After it comes how far down each right view is off
    its epipolar line, px, which serves to find the time between the views
    (``steadying.view_lag``) and must not influence the speed.

    :param H: (k, k) information, for the least scatter of disparities.
    :param right: (k,) information times measurement.
    :param along: (n, k) part of H from each disparity alone: its row for the place s.
    :param along_right: (n,) the same part of ``right``.
    :param own_m: (n,) information of each disparity about its place s, 1/m^2.
    :param disparity_px: (n,) change of the disparity along the path, px/m.
    :param cross_ncc: (n,) left-right NCC of each observation.
    :param texture_ncc: (n,) NCC of each observation with the texture.
    :param limits: parameters; here, when an observation shows the vehicle, and all of it.
    :param lines: number of right views whose offset from the epipolar line is unknown.
    """

    H: Array
    right: Array
    along: Array
    along_right: Array
    own_m: Array
    disparity_px: Array
    cross_ncc: Array
    texture_ncc: Array
    limits: VisibilityConfig
    lines: int = 0

    def scattered(self, more_px: float) -> Equations:
        """
        Return the equations for a larger scatter of disparities.

        The additional error of each disparity is one more unknown, which is eliminated here.

        :param more_px: 1-sigma that is added to the least scatter, px.
        """
        square = more_px ** 2
        if not square:
            return Equations(self.H, self.right, 0.0)
        grown = np.square(self.disparity_px) + square * self.own_m
        share = square / np.maximum(grown, LEAST_SQUARE)
        right = self.along_right
        return Equations(
            self.H - (self.along.T * share) @ self.along,
            self.right - (share * right) @ self.along,
            0.5 * float(share @ np.square(right) + np.log1p(-share * self.own_m).sum()))

    def apart(self, rates_per_s: Array) -> Photometry:
        """
        Return the equations with the rates across the path expressed by the poses.

        :param rates_per_s: (n, n) derivatives of the rates of a by all a, 1/s.
        """
        n = len(rates_per_s)
        unknowns = np.eye(len(self.right))
        s, a, b, speeds, rates, lines = unknowns[:6 * n].reshape(n, 6, -1).swapaxes(0, 1)
        a = a + rates_per_s.T @ rates
        by = np.concatenate([
            np.stack([s, a, b], axis=1).reshape(3 * n, -1), speeds, unknowns[6 * n:], lines])
        return replace(self, H=by @ self.H @ by.T, right=by @ self.right,
                       along=self.along @ by.T, lines=n)

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """Return which observations (n,) show the vehicle at all."""
        return np.asarray(
            np.minimum(self.cross_ncc, self.texture_ncc) >= self.limits.least_ncc)

    @cached_property
    def unoccluded(self) -> NDArray[np.bool_]:
        """
        Return which observations (n,) agree about as well as the best, so are not occluded.

        An occluding object is nearer than the front, so the views disagree too.  If the views
        agree as well as noise allows, only the light has changed: a reflection, or the exposure.
        """
        cross, texture = (_lack(ncc, self.limits) for ncc in (self.cross_ncc, self.texture_ncc))
        deficit = self.limits.occlusion_deficit
        return np.asarray(self.seen & (cross <= deficit) & ((texture <= deficit) | (cross <= 0)))


def _lack(ncc: Array, limits: VisibilityConfig) -> Array:
    """Return 1 - NCC of observations (n,), minus what noise explains in the best ones."""
    return np.asarray(1 - ncc - _explained(ncc, limits))


def _explained(ncc: Array, limits: VisibilityConfig) -> float:
    """Return the value of 1 - NCC that noise explains, judged by the best observations."""
    return limits.occlusion_noise_factor * float(
        np.quantile(1 - ncc, limits.occlusion_best_share))


def views_agree(cross_ncc: float, others: Array, limits: VisibilityConfig) -> bool:
    """
    Return whether the views of another observation agree as well as noise allows.

    :param cross_ncc: its left-right NCC.
    :param others: (n,) those of the observations so far.
    :param limits: parameters; here, when an observation shows the vehicle, and all of it.
    """
    return cross_ncc >= limits.least_ncc and 1 - cross_ncc <= _explained(others, limits)


def scatters_px(noise: NoiseConfig) -> list[tuple[float, float]]:
    """
    Return the possible scatters of the disparities of a pass, with their prior probabilities.

    Each is twice the previous one, from the floor on.  The prior is log-normal.

    :return: 1-sigma beyond the floor, px, and probability.
    """
    if not noise.match_floor_px:
        return [(0.0, 1.0)]
    times = 2.0 ** np.arange(noise.scatter_levels)
    more_px = noise.match_floor_px * np.sqrt(np.square(times) - 1)
    off = np.log(noise.match_floor_px * times / noise.scatter_px) / math.log(noise.scatter_factor)
    weights = normalise_log_weights(-0.5 * np.square(off))
    return [(float(px), float(w)) for px, w in zip(more_px, weights) if w > 0]


_Agree = Callable[[Columns, NDArray[np.int64], Array, Array, NoiseConfig, float], TemporalTerms]


class PassPhotometry:
    """
    Turns the observations of a pass into normal equations.

    :param basis: (G, m) share of the relief's nodes in each sample.
    :param noise: precision of observations.
    :param limits: parameters; here, when an observation shows the vehicle, and all of it.
    """

    def __init__(self, basis: Array, noise: NoiseConfig, limits: VisibilityConfig) -> None:
        self.basis, self.noise, self.limits = np.ascontiguousarray(basis.T), noise, limits
        self._table = ObservationTable(self.basis, noise)
        self._table_apart = ObservationTable(self.basis, noise, apart=True)

    def __call__(self, observations: Sequence[Observation],
                 counts: Optional[NDArray[np.bool_]] = None, more_px: float = 0.0,
                 rates_per_s: Optional[Array] = None) -> Photometry:
        """
        Return the normal equations of the cross and the temporal terms.

        :param counts: (n,) whether each observation counts, at least one of them; None for all.
        :param more_px: present estimate of the scatter of disparities beyond the least one, px,
            which is added to the floor of the texture's error.
        :param rates_per_s: (n, n) derivatives of the rates of a by all a, 1/s, where the views
            have two stamps; None where they do not.
        """
        counts = np.ones(len(observations), dtype=bool) if counts is None else counts
        if rates_per_s is None:
            return self._equations(observations, self._table, _temporal, counts, more_px)
        return self._equations(
            observations, self._table_apart, _apart_temporal, counts, more_px).apart(rates_per_s)

    def _equations(self, observations: Sequence[Observation], of: ObservationTable,
                   agree: _Agree, counts: NDArray[np.bool_], more_px: float) -> Photometry:
        """
        Return the normal equations of the unknowns of each observation.

        :param of: table of observations, for views of one stamp or of two.
        :param agree: computes the agreement of such observations with the texture.
        """
        table, rows = of.take(observations)
        m, (n, k) = len(self.basis), table.pose[rows].shape
        H, g = np.zeros((k * n + m, k * n + m)), np.zeros(k * n + m)
        poses, nodes = slice(0, k * n), slice(k * n, None)
        count = counts.astype(float)
        blocks, mixed = count[:, None, None] * table.poses[rows], table.mixed[rows]
        mixed *= count[:, None, None]
        right = count[:, None] * table.right[rows]
        _add_blocks(H[poses, poses], blocks)
        H[poses, nodes] += mixed.reshape(k * n, m)
        H[nodes, nodes] += np.tensordot(count, table.nodes[rows], 1)
        g[poses] += right.ravel()
        g[nodes] += count @ table.nodes_right[rows]
        along = np.zeros((n, k * n + m))
        along[np.arange(n)[:, None], np.arange(k * n).reshape(n, k)] = blocks[:, 0]
        along[:, nodes] = mixed[:, 0]
        texture = self._add_temporal_terms(agree, table, rows, counts, H, g, more_px)
        H[nodes, poses] = H[poses, nodes].T
        at_poses = np.concatenate([table.pose[rows].ravel(), np.zeros(m)])
        return Photometry(
            H, g + H @ at_poses, along, right[:, 0] + along @ at_poses, blocks[:, 0, 0],
            table.disparity_px[rows], table.across[rows], texture, self.limits)

    def _add_temporal_terms(self, agree: _Agree, table: Columns, rows: NDArray[np.int64],
                            counts: NDArray[np.bool_], H: Array, g: Array, more_px: float
                            ) -> Array:
        """
        Add the agreement with the texture to H and g; return each observation's NCC with it.

        Of the block of H between poses and relief, only the one above the diagonal is filled.
        """
        n, noise = len(rows), self.noise
        pixels, both = np.where(counts, table.pixels[rows], 0.0), table.both[rows]
        ncc = correlation(both, pixels @ both / pixels.sum())
        pixels[ncc < self.limits.least_ncc] = 0.0
        if n < 2 or not pixels.any():
            return ncc
        by_blur = pixels @ table.by_blur[rows] / pixels.sum()
        clipped_share = float(table.clips[rows] @ pixels / pixels.sum())
        floor_px = math.hypot(_texture_floor_px(noise, clipped_share), more_px)
        # The texture is eliminated, so that what all observations have in common does not count.
        terms = agree(table, rows, pixels, by_blur, noise, floor_px)
        poses, nodes = slice(0, len(terms.right)), slice(len(terms.right), None)
        H[poses, poses] -= terms.shared @ terms.shared.T
        _add_blocks(H[poses, poses], terms.blocks)
        H[poses, nodes] += terms.mixed @ self.basis.T
        H[nodes, nodes] += self._table.node_sums(terms.relief)
        g[poses] += terms.right
        g[nodes] += self.basis @ terms.relief_right
        return ncc


def _texture_floor_px(noise: NoiseConfig, clipped_share: float) -> float:
    """
    Return the systematic error of matching an observation to the texture, px.

    :param clipped_share: share of the observed pixels that are of observations in which some clip.
    """
    more = max(noise.clipped_floor_px ** 2 - noise.texture_floor_px ** 2, 0.0)
    return math.sqrt(noise.texture_floor_px ** 2 + clipped_share * more)


def _temporal(table: Columns, rows: NDArray[np.int64], pixels: Array, by_blur: Array,
              noise: NoiseConfig, floor_px: float) -> TemporalTerms:
    """
    Return the agreement of observations with their texture.

    :param rows: (n,) rows of the observations in the table.
    :param pixels: (n,) number of pixels that each counts with, 0 to leave it out.
    :param by_blur: (G,) change of the texture by blur.
    :param floor_px: systematic error of matching, which does not average out over samples.
    """
    return temporal(
        rows, table.patches, table.jacobian, table.relief_jacobian, table.outlines, table.glare,
        by_blur, table.relief, pixels, table.shift_px, noise.tail_dof, noise.independent_share,
        floor_px, math.hypot(noise.glare_floor_px, floor_px))


def _apart_temporal(table: Columns, rows: NDArray[np.int64], pixels: Array, by_blur: Array,
                    noise: NoiseConfig, floor_px: float) -> TemporalTerms:
    """
    Return the same for views that have two stamps.

    Each view is an observation with its own pose: that of the right view is further along by the
    lag times the speed, and off its epipolar line.  So the blur of each is unknown.
    Arguments are those of :func:`_temporal`.

    :param rows: (n,) rows of the observations in the table.
    """
    k, _, samples = table.patches.shape
    alone = temporal(
        np.stack([2 * rows, 2 * rows + 1], axis=-1).ravel(),
        table.patches.reshape(2 * k, 1, samples), table.jacobian.reshape(2 * k, 1, 3, samples),
        table.relief_jacobian.reshape(2 * k, 1, samples),
        table.outlines.reshape(2 * k, 1, samples), table.glare.reshape(2 * k, 1, samples), by_blur,
        np.repeat(table.relief, 2, axis=0), np.repeat(pixels, 2), np.repeat(table.shift_px, 2),
        noise.tail_dof, noise.independent_share,
        # the mean of two views has floor_px
        math.sqrt(2) * floor_px, math.sqrt(2) * math.hypot(noise.glare_floor_px, floor_px))
    n = len(rows)
    to_views = np.zeros((n, 2, 3, 6))  # derivatives of the poses of both views by the unknowns
    to_views[:, :, :, :3] = np.eye(3)
    to_views[:, 1, 0, 3] = to_views[:, 1, 1, 4] = table.right_s[rows]
    to_views[:, 1, 2, 5] = table.right_m[rows]

    def by_pose(of_views: Array) -> Array:
        """Return derivatives (6 n, …) by the unknowns from those by the poses of both views."""
        each = of_views.reshape(n, 2, 3, -1)
        return np.asarray(
            np.einsum('nvij,nvic->njc', to_views, each).reshape(6 * n, -1))

    return TemporalTerms(
        shared=by_pose(alone.shared), mixed=by_pose(alone.mixed), relief=alone.relief,
        relief_right=alone.relief_right, right=by_pose(alone.right)[:, 0],
        blocks=np.einsum('nvij,nvik,nvkl->njl', to_views, alone.blocks.reshape(n, 2, 3, 3),
                         to_views))


def _add_blocks(H: Array, blocks: Array) -> None:
    """Add blocks (n, k, k) to the diagonal of H (n k, n k), in place."""
    n, k, _ = blocks.shape
    at = np.arange(n * k).reshape(n, k)
    H[at[:, :, None], at[:, None, :]] += blocks
