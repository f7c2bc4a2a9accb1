# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The equations of the images with the relief of the front eliminated."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from .motion_prior import Indices
from .photometry import Equations
from .relief import node_variances
from ..core.records import Array


@dataclass(frozen=True, eq=False)
class PoseEquations(Equations):
    """
    Equations of the images for the poses alone, and the speeds where views have two stamps.

    The m eliminated unknowns are the nodes of the relief, then how far right views are off their
    epipolar lines.

    :param alone: (m,) eliminated unknowns where the poses are 0.
    :param gain: (m, k) their decrease per unit of the poses.
    :param factor: Cholesky factor of their information (m, m) where the poses are known.
    :param nodes: number of nodes of the relief.
    """

    alone: Array
    gain: Array
    factor: tuple[Array, bool]
    nodes: int

    @property
    def unknowns(self) -> Indices:
        """Return the indices (k,) of the unknowns of these equations."""
        return np.arange(len(self.right))

    def relief(self, poses: Array) -> Array:
        """Return the relief of each node, m, for given poses (k,)."""
        return np.asarray(self.alone - self.gain @ poses)[:self.nodes]

    def relief_variances(self, poses: Array) -> Array:
        """Return the variance of each node, m^2, given the covariance (k, k) of the poses."""
        return node_variances(self.factor, self.gain, poses)[:self.nodes]


def without_relief(images: Equations, held: Array, nodes: int) -> PoseEquations:
    """
    Return the equations of the images for the poses alone.

    :param images: their equations for poses, relief and lines of right views.
    :param held: (m,) prior information of each node of the relief, 1/m^2, and of the lines.
    :param nodes: number of nodes of the relief.
    """
    n = len(images.right) - len(held)
    factor = cho_factor(images.H[n:, n:] + np.diag(held), lower=True, check_finite=False)
    gain = cho_solve(factor, images.H[n:, :n], check_finite=False)
    alone = cho_solve(factor, images.right[n:], check_finite=False)
    log_density = images.log_density + 0.5 * float(images.right[n:] @ alone) - float(
        np.log(np.diag(factor[0])).sum())
    return PoseEquations(
        images.H[:n, :n] - images.H[:n, n:] @ gain, images.right[:n] - images.H[:n, n:] @ alone,
        log_density, alone, gain, factor, nodes)
