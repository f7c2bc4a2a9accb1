# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The relief of a front: how far its parts stand out of its plane.

Bumpers, grilles and lights lie centimetres apart in depth.  As a vehicle comes nearer they shift
against each other, and on one plane this would be taken for motion: 5 cm cost 0.1 to 0.3 mph.  A
front does not change its shape, so its relief is a static unknown of the pass.
"""
from __future__ import annotations

import numpy as np

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
