# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Rays and planes ``n^T P = d``; leading axes broadcast."""
from __future__ import annotations

import numpy as np

from ..core.records import Array


def back_project(rays: Array, n: Array, d: Array) -> Array:
    """
    Meet rays with a plane; NaN where they do not meet in front of the camera.

    :param rays: (..., 3) at depth 1.
    :param n: (..., 3) unit normals.
    :param d: (...,) m.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        depth = d / np.sum(rays * np.asarray(n), axis=-1)
        depth = np.where((depth > 0) & np.isfinite(depth), depth, np.nan)
    return rays * depth[..., None]
