# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The effect of extrinsic drift, a rotation of the right camera, on lengths along a path.

A pan adds the same disparity everywhere. Road, lines and vehicles are then reconstructed in the
same distorted space, where the relative error of a length at range Z along the line of sight is
about ``2 Z pan / baseline``. No residual reveals this error, but it affects every speed.
"""
from __future__ import annotations

from dataclasses import replace
import math

import numpy as np

from .lanes import LanePath
from .path import Path
from ..core.records import Array
from ..geometry.rig import StereoRig

_PLACES = 41  # samples along a path, where the effect is smooth
_FEWEST, _DENSE_M = 10, 0.5  # fewest visible samples, and spacing of those where there are fewer
_STEP_RAD = 1e-6  # step for finite differences by the rotation, about 1e-3 px
_STEP_M = 0.25  # half of the lengths that are compared


def scale_by_drift(path: Path, rig: StereoRig, s_m: Array) -> Array:
    """
    Return the relative change of lengths along a path with the rotation of the right camera.

    The points of the path are projected with the rig and triangulated with a rotated one.

    :param s_m: (n,) arc lengths, m.
    :return: (n, 3) relative changes per rad of pan, tilt and roll; NaN where a camera does not see
        the path.
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
    Return a lane whose scale is uncertain by the rotation of the right camera.

    The speed of a pass is the slope of its positions over time, each weighted by how well
    disparity determines it, ``1 / Z^4``.

    :param covariance_rad2: (3, 3) covariance of pan, tilt and roll, rad^2.
    """
    s, slope = _seen_scales(lane.path, rig)
    if not len(s):
        return lane
    mean = _over_pass(lane.path, s, slope)
    profile = np.sqrt(np.einsum('ni,ij,nj->n', slope, covariance_rad2, slope))
    return replace(lane, scale_std=float(np.sqrt(mean @ covariance_rad2 @ mean)),
                   scale_profile=(s, profile))


def pass_scale_by_drift(path: Path, rig: StereoRig) -> Array:
    """
    Return the relative change of the speed of a pass with the rotation of the right camera.

    :return: (3,) signed changes per rad of pan, tilt and roll; NaN if the cameras do not see the
        path.
    """
    s, slope = _seen_scales(path, rig)
    return _over_pass(path, s, slope) if len(s) else np.full(3, np.nan)


def _seen_scales(path: Path, rig: StereoRig) -> tuple[Array, Array]:
    """Return arc lengths (n,) that both cameras see, m, and :func:`scale_by_drift` there."""
    s = np.linspace(0.0, path.length_m, _PLACES)
    slope = scale_by_drift(path, rig, s)
    known = np.isfinite(slope).all(axis=-1)
    if known.sum() < _FEWEST:  # of a surveyed line that goes on far beyond the view
        dense = np.linspace(0.0, path.length_m, math.ceil(path.length_m / _DENSE_M) + 1)
        seen = dense[np.isfinite(scale_by_drift(path, rig, dense)).all(axis=-1)]
        if len(seen) > known.sum():
            s = np.linspace(seen[0], seen[-1], _PLACES)
            slope = scale_by_drift(path, rig, s)
            known = np.isfinite(slope).all(axis=-1)
    return s[known], slope[known]


def _over_pass(path: Path, s_m: Array, slope: Array) -> Array:
    """
    Return the relative change (3,) of the speed over given places of a path, per rad.

    :param s_m: (n,) arc lengths of the places, m.
    :param slope: (n, 3) relative changes of lengths there, per rad.
    """
    weight = path.position(s_m)[:, 2]**-4.0
    lever = weight * (s_m - np.average(s_m, weights=weight))
    # Displacement of each place, m per rad.
    off = np.concatenate([np.zeros((1, 3)), np.cumsum(
        (slope[1:] + slope[:-1]) / 2 * np.diff(s_m)[:, None], axis=0)])
    return np.asarray(lever @ off / (lever @ s_m))
