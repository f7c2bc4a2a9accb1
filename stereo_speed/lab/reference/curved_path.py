# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A space curve from its two image curves, and motion along it (Zhu 2012, eq. 25-27).

``road.fit`` replaces the reconstruction, because it weights picks by their accuracy.
"""
from __future__ import annotations

import numpy as np

from ...core.records import Array
from ...geometry.rig import StereoRig
from ...road.curve_matching import CurveMatches, match_curves
from ...road.path import CAMERA_UP, Path, SplinePath


def curved_path(
        rig: StereoRig, left_px: Array, right_px: Array, up: Array = CAMERA_UP) -> SplinePath:
    """
    Reconstruct one line from its picks in the two raw views, without any smoothing.

    :param left_px: (n, 2), raw picks in order along travel.
    :param right_px: (m, 2), raw picks in order along travel.
    :param up: (3,), approximate up direction.
    """
    return SplinePath(match_curves(rig, left_px, right_px).points_m, up)


def depth_std_m(matches: CurveMatches, rig: StereoRig, pick_std_px: float) -> Array:
    """
    Return the depth 1-sigmas (n,) of matched points, given that of the picks.

    A disparity error of ``pick_std_px / sine`` moves a point by ``Z^2 / (f b)`` of it.

    :param pick_std_px: 1-sigma of a pick across its line, in the left view.
    """
    z = matches.points_m[:, 2]
    return np.asarray(
        z * z / (rig.left.K[0, 0] * rig.baseline_m) * pick_std_px / matches.sine)


def chord_step(path: Path, s_m: Array, chord_m: Array) -> Array:
    """
    Return the arc lengths (...,) ahead of ``s_m`` at the given straight distance (eq. 25).

    :param s_m: (...,) arc lengths now.
    :param chord_m: (...,) distances covered, m; 0 stays.
    """
    s_m, chord_m = np.broadcast_arrays(np.asarray(s_m, float), np.asarray(chord_m, float))
    start, ahead = path.position(s_m), s_m + chord_m
    for _ in range(20):
        across = path.position(ahead) - start
        distance = np.linalg.norm(across, axis=-1)
        slope = np.sum(across * path.tangent(ahead), axis=-1) / np.where(distance, distance, 1.0)
        step = np.where(distance > 0, (chord_m - distance) / np.maximum(slope, 0.1), 0.0)
        ahead = ahead + step
        if not np.any(np.abs(step) > 1e-10):
            break
    return ahead


def motion_along(path: Path, s0_m: Array, s1_m: Array) -> tuple[Array, Array]:
    """
    Return rotation (..., 3, 3) and translation (..., 3) that carry the path's frame (eq. 26, 27).

    :param s0_m: (...,) arc lengths before.
    :param s1_m: (...,) arc lengths after.
    """
    rotation = path.frame(s1_m) @ np.swapaxes(path.frame(s0_m), -1, -2)
    carried = (rotation @ path.position(s0_m)[..., None])[..., 0]
    return rotation, path.position(s1_m) - carried
