# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The relief of a front: how far its parts stand out of its plane.

Bumpers, grilles and lights lie centimetres apart in depth.  As a vehicle comes nearer they shift
against each other, and on one plane this would be taken for motion: 5 cm cost 0.1 to 0.3 mph.  A
front does not change its shape, so its relief is a static unknown of the pass.

Not all fronts are nearly planes: a rider sits most of a metre behind the fork, and held near it
would be taken to scale and to turn otherwise than he does.  So the relief has heavy tails: what
lies far off the plane, as the images show it, is hardly held to it.
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
    Return bilinear functions on a net of nodes over the front.

    :param unit_xy: (G, 2) grid samples in the unit square.
    :return: (G, M) share of each of the M nodes in the relief at each sample; rows sum to 1.
    """
    across, down = (np.maximum(1 - np.abs(unit_xy[:, axis, None] * (count - 1)
                                          - np.arange(count)), 0)
                    for axis, count in enumerate(NODES))
    return np.asarray((down[:, :, None] * across[:, None, :]).reshape(len(unit_xy), -1))


def node_weights(square_m2: Array, std_m: float, dof: float) -> Array:
    """
    Return the shares of the usual information by which nodes are held to the plane.

    It is the step of the t distribution's expectation maximisation: 1 for a node that lies as far
    off as is usual.

    :param square_m2: (M,) mean square of the relief of each node, as far as is known.
    :param std_m: what is usual.
    :param dof: degrees of freedom of the t distribution.
    """
    return np.asarray((dof + 1) / (dof + square_m2 / std_m ** 2))


def node_variances(factor: tuple[Array, bool], gain: Array, poses: Array) -> Array:
    """
    Return the variances (M,) of the relief where the poses are not known exactly.

    :param factor: Cholesky's of the information (M, M) of the relief where they are.
    :param gain: (M, k) change of the relief by the poses.
    :param poses: (k, k) their covariance.
    """
    known = cho_solve(factor, np.eye(len(gain)), check_finite=False)
    return np.asarray(np.diag(known) + ((gain @ poses) * gain).sum(axis=1))


class NodeSums:
    """
    Sums over samples of weights times the shares of any two nodes.

    A sample has a share of four nodes at most, so almost all products of two shares are 0.

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
