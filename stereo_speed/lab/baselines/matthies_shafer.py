# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Covariance of triangulated points.

L. Matthies and S. A. Shafer, "Error modeling in stereo navigation", IEEE J. Robotics and
Automation 3(3), 1987 (the 2012 paper's reference [36]).

Gaussian errors of the matched image points are propagated by the image Jacobian: with A the
(4, 3) derivative of both projections by the point, least-squares triangulation has the covariance
sigma^2 (A^T A)^-1.  For parallel cameras that is their J V J^T to first order.
"""
from __future__ import annotations

import numpy as np

from ...core.records import Array
from ...geometry.rig import StereoRig

_STEP = 1e-4  # step of the central differences, as a share of the depth


def covariances(rig: StereoRig, points_m: Array, std_px: float) -> Array:
    """
    Return the covariance of each triangulated point, (n, 3, 3) m^2.

    :param points_m: (n, 3), left optical frame.
    :param std_px: 1-sigma of each image coordinate in both raw views.
    """
    points_m = np.asarray(points_m, dtype=np.float64)
    step = _STEP * np.abs(points_m[:, 2])
    columns = []
    for axis in range(3):
        offset = step[:, None] * np.eye(3)[axis]
        ahead, behind = (np.concatenate(rig.project(points_m + s * offset)[:2], axis=1)
                         for s in (1.0, -1.0))
        columns.append((ahead - behind) / (2 * step[:, None]))
    a = np.stack(columns, axis=-1)
    return np.asarray(std_px ** 2 * np.linalg.inv(np.swapaxes(a, 1, 2) @ a), np.float64)
