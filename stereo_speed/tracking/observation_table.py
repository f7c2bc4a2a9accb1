# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A table of what the photometry needs of observations, so that arrays cover all of them at once.

Observations do not change.  What follows from one alone is computed when it is first used, and no
array is assembled anew for each solution.
"""
from __future__ import annotations

from itertools import count
from typing import NamedTuple, Sequence

import numpy as np
from numpy.typing import NDArray

from .observation import Observation
from .photometric_terms import cross
from .relief import NodeSums
from ..core.records import Array
from ..core.tracker_config import NoiseConfig

LEAST_SQUARE = 1e-12  # px^2/m^2, lower limit for disparities that do not depend on the place
_MORE = 8  # least number of rows that a table grows by


class Columns(NamedTuple):
    """
    The values of an observation; in a table, each array has one more axis in front.

    Each observation has k unknowns: s, a, b and, where the views have two stamps, the rates of s
    and a, and how far down the right view is off its epipolar line.  The last five fields are the
    equations of the agreement of the two views.

    :param pose: (k,) unknowns at which it was taken, m, m/s and px.
    :param right_s: how much later the right view was exposed, s.
    :param right_m: change of b in the right view per px off its epipolar line, m/px.
    :param patches: (2, G) left and right patch.
    :param both: (G,) mean of the two patches.
    :param across: correlation of the two patches.
    :param jacobian: (2, 3, G) derivatives of the patches by the pose, 1/m.
    :param relief_jacobian: (2, G) derivatives of the patches by the relief, 1/m.
    :param outlines: (2, G) change by moving outlines, of unit length, or 0.
    :param clips: 1 if it shows clipped pixels, 0 if not.
    :param glare: (2, G) share of each sample that lies in the glare of clipped areas.
    :param by_blur: (G,) change of the mean patch by blur.
    :param relief: (G,) relief that it was taken with at each sample, m.
    :param pixels: number of pixels that it counts with.
    :param shift_px: motion of the front in the left view per metre of a, px/m.
    :param disparity_px: change of the disparity per metre of s, px/m.
    :param poses: (k, k) information of the unknowns.
    :param mixed: (k, m) information between the unknowns and the relief.
    :param nodes: (m, m) information of the relief.
    :param right: (k,) information times measurement of the unknowns.
    :param nodes_right: (m,) information times measurement of the relief.
    """

    pose: Array
    right_s: Array
    right_m: Array
    patches: Array
    both: Array
    across: Array
    jacobian: Array
    relief_jacobian: Array
    outlines: Array
    clips: Array
    glare: Array
    by_blur: Array
    relief: Array
    pixels: Array
    shift_px: Array
    disparity_px: Array
    poses: Array
    mixed: Array
    nodes: Array
    right: Array
    nodes_right: Array


class ObservationTable:
    """
    A table with one row per observation; rows no longer used are overwritten.

    :param basis: (m, G) share of the relief's nodes in each sample.
    :param noise: precision of observations.
    :param apart: whether the views have two stamps.
    """

    def __init__(self, basis: Array, noise: NoiseConfig, *, apart: bool = False) -> None:
        self.basis, self.node_sums, self.noise = basis, NodeSums(basis), noise
        self.apart = apart
        self._rows: dict[Observation, int] = {}
        self._columns: list[Array] = []

    def take(self, observations: Sequence[Observation]) -> tuple[Columns, NDArray[np.int64]]:
        """Return a table that contains all of the observations, and their rows in it."""
        kept = {o: self._rows[o] for o in observations if o in self._rows}
        taken = set(kept.values())
        free = (k for k in count() if k not in taken)
        for observation in observations:
            if observation not in kept:
                kept[observation] = row = next(free)
                self._write(row, self._row(observation))
        self._rows = kept
        return Columns(*self._columns), np.array([kept[o] for o in observations])

    def _write(self, row: int, values: Columns) -> None:
        if not self._columns:
            self._columns = [np.zeros((0, *np.shape(value))) for value in values]
        have = len(self._columns[0])
        if row >= have:
            more = max(have, _MORE)
            self._columns = [np.concatenate([c, np.zeros((more, *c.shape[1:]))])
                             for c in self._columns]
        for column, value in zip(self._columns, values):
            column[row] = value

    def _row(self, observation: Observation) -> Columns:
        """
        Return the values of one observation, with the equations of its two patches.

        Their information is limited by the least scatter of a disparity.
        """
        o, noise, relief = observation, self.noise, observation.relief @ self.basis
        parts, pose = o.apart_jacobian, o.pose
        up_m = -1 / max(float(o.shift_px[1, 2]), LEAST_SQUARE)
        if self.apart:  # a faster vehicle travels further until the right view is exposed
            goes, lies = o.lag_s * o.jacobian[1, :2], up_m * o.jacobian[1, 2]
            parts, pose = np.vstack([parts, -goes, -lies]), np.append(
                pose, [*o.velocity_mps[:2], 0.0])
        terms = cross(o.patches, parts, o.apart_relief, o.outlines, relief, o.pixels,
                      noise.tail_dof, noise.independent_share)
        per_px = terms.block[0, 0] / max(o.disparity_px[0] ** 2, LEAST_SQUARE)
        share = 1 / (1 + (noise.match_floor_px ** 2 + o.skew_px ** 2) * per_px)
        return Columns(
            pose=pose, right_s=np.asarray(o.lag_s),
            right_m=np.asarray(up_m), patches=o.patches, both=o.patches.mean(axis=0),
            across=np.asarray(o.patches[0] @ o.patches[1] / len(relief)), jacobian=o.jacobian,
            relief_jacobian=o.relief_jacobian, outlines=o.outlines,
            clips=np.asarray(float(o.outlines.any())),
            glare=o.glare, by_blur=o.by_blur.mean(axis=0), relief=relief,
            pixels=np.asarray(o.pixels), shift_px=o.shift_px[0, 1],
            disparity_px=o.disparity_px[0], poses=share * terms.block,
            mixed=share * terms.mixed @ self.basis.T,
            nodes=self.node_sums(share * terms.relief),
            right=share * terms.right, nodes_right=self.basis @ (share * terms.relief_right))
