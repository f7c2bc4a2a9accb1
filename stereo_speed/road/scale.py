# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What extrinsic drift, a rotation of the right camera, does to lengths along a path.

A pan adds the same disparity everywhere. Road, lines and vehicles are then seen in one and the
same distorted space, in which a length at range Z along the line of sight is wrong by about
``2 Z pan / baseline`` of itself: no residual shows it, but it is in every speed.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from .lanes import LanePath
from .path import Path
from ..core.records import Array
from ..geometry.rig import StereoRig

_PLACES = 41  # along a path; the effect is smooth
_STEP_RAD = 1e-6  # of the differences by the rotation: 1e-3 px
_STEP_M = 0.25  # half of the lengths that are compared


def scale_by_drift(path: Path, rig: StereoRig, s_m: Array) -> Array:
    """
    Return how lengths along a path change, as a share, with the rotation of the right camera.

    The points of the path are seen with the rig and triangulated with a rotated one.

    :param s_m: (n,) arc lengths.
    :return: (n, 3) per rad of pan, tilt and roll; NaN where a camera cannot see the path.
    """
    h = _STEP_M
    points = path.position(s_m[:, None] + np.array([-h, h]))
    left, right, seen_left, seen_right = rig.project(points)
    moved = []
    for axis in range(3):
        for sign in (1, -1):
            drift = np.zeros(3)
            drift[axis] = sign * _STEP_RAD
            found = rig.drifted(drift).triangulate(left, right)
            moved.append(np.linalg.norm(found[:, 1] - found[:, 0], axis=-1))
    lengths = np.array(moved).reshape(3, 2, -1)
    slope = (lengths[:, 0] - lengths[:, 1]).T / (2 * _STEP_RAD * 2 * h)
    seen = np.all(seen_left & seen_right, axis=-1, keepdims=True)
    return np.where(seen, slope, np.nan)


def with_scale(lane: LanePath, rig: StereoRig, covariance_rad2: Array) -> LanePath:
    """
    Return a lane with what the uncertain rotation of the right camera does to its lengths.

    The speed of a pass is the slope of its places over time, each weighted by how well disparity
    determines it, ``1 / Z^4``.

    :param covariance_rad2: (3, 3) of pan, tilt and roll.
    """
    s = np.linspace(0.0, lane.path.length_m, _PLACES)
    slope = scale_by_drift(lane.path, rig, s)
    known = np.isfinite(slope).all(axis=-1)
    if not known.any():
        return lane
    s, slope = s[known], slope[known]
    weight = lane.path.position(s)[:, 2]**-4.0
    lever = weight * (s - np.average(s, weights=weight))
    # by how much each place is off, m per rad
    off = np.concatenate([np.zeros((1, 3)), np.cumsum(
        (slope[1:] + slope[:-1]) / 2 * np.diff(s)[:, None], axis=0)])
    mean = lever @ off / (lever @ s)
    profile = np.sqrt(np.einsum('ni,ij,nj->n', slope, covariance_rad2, slope))
    return replace(lane, scale_std=float(np.sqrt(mean @ covariance_rad2 @ mean)),
                   scale_profile=(s, profile))
