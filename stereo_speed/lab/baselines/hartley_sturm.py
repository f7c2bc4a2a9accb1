# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Optimal triangulation of R. Hartley and P. Sturm, "Triangulation", CVIU 68(2), 1997.

Of all pairs of image points on corresponding epipolar lines it finds the one with the least sum
of squared distances to the measured pair in both images: the maximum likelihood under equal
Gaussian errors (the 2012 paper's reference [27]).
"""
from __future__ import annotations

import cv2
import numpy as np

from ...core.records import Array
from ...geometry.rig import StereoRig


def fundamental(rig: StereoRig) -> Array:
    """Return the (3, 3) F with ``x_right^T F x_left = 0`` in undistorted pixels."""
    return np.linalg.inv(rig.right.K).T @ rig.essential @ np.linalg.inv(rig.left.K)


def triangulate(rig: StereoRig, uv_left: Array, uv_right: Array) -> Array:
    """
    Triangulate matched raw pixels; NaN where their rays do not meet ahead of the cameras.

    Errors are assumed equal in undistorted pixels, which equals raw pixels where the distortion
    hardly changes the scale.

    :param uv_left: (n, 2), raw pixels.
    :param uv_right: (n, 2), their matches, raw pixels.
    :return: (n, 3), left optical frame, m.
    """
    left, right = ((camera.rays(uv) @ camera.K.T)[:, :2] for camera, uv in
                   ((rig.left, uv_left), (rig.right, uv_right)))
    good = np.isfinite(left).all(axis=1) & np.isfinite(right).all(axis=1)
    out = np.full((len(left), 3), np.nan)
    if not good.any():
        return out
    fixed = cv2.correctMatches(fundamental(rig), left[None, good], right[None, good])
    views = rig.left.K @ np.eye(3, 4), rig.right.K @ np.column_stack([rig.R, rig.t])
    with np.errstate(divide='ignore', invalid='ignore'):
        meeting = cv2.triangulatePoints(*views, fixed[0][0].T, fixed[1][0].T)
        points = (meeting[:3] / meeting[3]).T
        ahead = (points[:, 2] > 0) & (rig.to_right(points)[:, 2] > 0)
    out[good] = np.where(ahead[:, None], points, np.nan)
    return out
