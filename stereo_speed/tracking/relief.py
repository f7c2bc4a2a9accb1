# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The relief of a front: how far its parts stand out of its plane.

Bumpers, grilles and lights lie centimetres apart in depth.  As a vehicle comes nearer they shift
against each other, and on one plane this would be taken for motion: 5 cm cost 0.1 to 0.3 mph.  The
shape of a front does not change, so its relief is a static unknown of the pass.

Not all fronts are nearly plane: a rider sits most of a metre behind the fork; forced close to the
plane, his image would seem to scale and turn differently.  So the prior of the relief has heavy
tails: parts that the images show far off the plane are hardly held to it.
"""
from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import cho_solve
from scipy.sparse import csr_matrix

from ..core.records import Array

NODES = (8, 4)  # across and down the front


def relief_basis(unit_xy: Array) -> Array:
    """
    Return bilinear basis functions of a grid of nodes over the front.

    :param unit_xy: (G, 2) grid samples in the unit square.
    :return: (G, M) share of each of the M nodes in the relief at each sample; rows sum to 1.
    """
    across, down = (np.maximum(1 - np.abs(unit_xy[:, axis, None] * (count - 1)
                                          - np.arange(count)), 0)
                    for axis, count in enumerate(NODES))
    return np.asarray((down[:, :, None] * across[:, None, :]).reshape(len(unit_xy), -1))


def node_weights(square_m2: Array, std_m: float, dof: float) -> Array:
    """
    Return the factors on the usual information that holds nodes to the plane.

    They are a step of expectation maximisation for the t distribution: 1 for a node at the usual
    distance from the plane.

    :param square_m2: (M,) posterior mean square of the relief of each node, m^2.
    :param std_m: usual distance from the plane, m.
    :param dof: degrees of freedom of the t distribution.
    """
    return np.asarray((dof + 1) / (dof + square_m2 / std_m ** 2))


def node_variances(factor: tuple[Array, bool], gain: Array, poses: Array) -> Array:
    """
    Return the variances (M,) of the relief with uncertain poses.

    :param factor: Cholesky factor of the information (M, M) of the relief for known poses.
    :param gain: (M, k) change of the relief per pose.
    :param poses: (k, k) covariance of the poses.
    """
    known = cho_solve(factor, np.eye(len(gain)), check_finite=False)
    return np.asarray(np.diag(known) + ((gain @ poses) * gain).sum(axis=1))


class NodeSums:
    """
    Sums over samples of weights times the shares of each two nodes.

    A sample has shares of four nodes at most, so almost all products of two shares are 0.

    :param basis: (m, G) share of each node in the relief at each sample.
    """

    def __init__(self, basis: Array) -> None:
        self._count = len(basis)
        self._products = _products(basis.tobytes(), *basis.shape)

    def __call__(self, weights: Array) -> Array:
        """Return the sums (m, m) for weights (G,) of the samples."""
        return np.asarray(self._products @ weights).reshape(self._count, self._count)


@lru_cache(maxsize=8)
def _products(basis: bytes, nodes: int, samples: int) -> csr_matrix:
    """Return the products (m m, G) of the shares of two nodes in each sample."""
    shares = np.frombuffer(basis).reshape(nodes, samples)
    return csr_matrix((shares[:, None] * shares).reshape(nodes * nodes, samples))
