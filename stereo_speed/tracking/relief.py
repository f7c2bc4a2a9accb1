# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The relief of a front: how far its parts stand out of its plane.

Bumpers, grilles and lights lie centimetres apart in depth.  As a vehicle comes nearer they shift
against each other, and on one plane this would be taken for motion: 5 cm cost 0.1 to 0.3 mph.  A
front does not change its shape, so its relief is a static unknown of the pass.
"""
from __future__ import annotations

from functools import lru_cache

import numpy as np
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
