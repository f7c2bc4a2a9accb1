# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Planes ``n^T P = d`` and their intersections with rays."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Union

import numpy as np

from ..core.records import Array


@dataclass(frozen=True, eq=False)
class Plane:
    """
    A plane ``normal^T P = distance_m``.

    :param normal: (3,) unit normal.
    :param distance_m: distance of the origin from the plane, m.
    """

    normal: Array
    distance_m: float


def back_project(rays: Array, n: Array, d: Union[Array, float]) -> Array:
    """
    Return the points (..., 3) where rays meet planes; NaN if they are not in front of the camera.

    Leading axes broadcast.

    :param rays: (..., 3) rays at depth 1.
    :param n: (..., 3) unit normals of the planes.
    :param d: (...,) distances of the planes from the origin, m.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        depth = d / np.sum(rays * np.asarray(n), axis=-1)
        depth = np.where((depth > 0) & np.isfinite(depth), depth, np.nan)
    return np.asarray(rays * depth[..., None])
