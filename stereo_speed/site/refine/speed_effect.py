# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The effect of an error of the path or of the rig on a measured speed.

A point travels at constant speed, at a fixed offset across and above the true path. It is seen by
the true rig and measured with the assumed path and rig: least squares over its pixels gives the
arc lengths at all times and its offsets across and above the path. The measured speed is the
slope of the arc lengths, each weighted by how well it can be determined.
"""
from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ...core.records import Array
from ...geometry.rig import StereoRig
from ...road.lanes import LanePath
from ...road.path import Path, SplinePath
from ...road.path_effect import FRONT_STD_PX, OFFSET_CHANGE_STD_M, PLACES, seen_stretch

_LOOKED_AT = 101  # places of a path whose visibility in both views is checked
_SPACING_M, _LEAST_POINTS = 1.0, 8  # spacing and fewest points of a rotated path
_ABOVE_M = 0.6  # height of the middle of a front above the path


@dataclass(frozen=True, eq=False)
class Setup:
    """
    A path and a rig that sees it.

    :param path: path of the lane.
    :param rig: the rig.
    """

    path: Path
    rig: StereoRig


def speed_error(true: Setup, used: Setup) -> float:
    """
    Return the relative error of the mean speed of a pass.

    :param true: true path and rig.
    :param used: path and rig that are measured with.
    :return: NaN if too little of the path is visible.
    """
    s = _seen(true)
    if not len(s):
        return float('nan')
    frame, place = true.path.frame(s), true.path.position(s)
    points = place + _ABOVE_M * frame[..., 2]
    seen = true.rig.project(points)[:2]
    path, rig = used.path, used.rig
    start = np.zeros((len(s), 3))
    start[:, 0] = path.arc_length(place)
    start[:, 2] = _ABOVE_M

    def residuals(x: Array) -> Array:
        along, beside, above = x[:-2].reshape(-1, 3).T
        axes = path.frame(along)
        at = path.position(along) + beside[:, None] * axes[..., 1] + above[:, None] * axes[..., 2]
        off = [a - b for a, b in zip(rig.project(at)[:2], seen)]
        change = np.concatenate([beside - x[-2], above - x[-1]]) / OFFSET_CHANGE_STD_M
        return np.asarray(np.nan_to_num(np.concatenate(
            [off[0].ravel(), off[1].ravel(), FRONT_STD_PX * change])))

    solution = least_squares(residuals, np.append(start.ravel(), [0.0, _ABOVE_M]), x_scale='jac',
                             xtol=1e-10, ftol=1e-10)
    weight = points[:, 2]**-4.0
    along, middle = solution.x[:-2].reshape(-1, 3)[:, 0], np.average(s, weights=weight)
    slope = np.sum(weight * (s - middle) * along) / np.sum(weight * (s - middle)**2)
    return float(slope - 1)


def heading_effect(path: Path, rig: StereoRig, heading_std_rad: Array) -> float:
    """
    Return the relative 1-sigma of the mean speed of a pass by an uncertain direction of the path.

    :param heading_std_rad: (2,) 1-sigma of the path's direction in its middle, across and up, rad.
    """
    s = np.linspace(0, path.length_m, max(int(path.length_m / _SPACING_M), _LEAST_POINTS))
    points, frames = path.position(s), path.frame(s)
    middle, axes = points[len(s) // 2], frames[len(s) // 2]
    out = []
    for axis, std in ((2, heading_std_rad[0]), (1, heading_std_rad[1])):
        rotation = Rotation.from_rotvec(float(std) * axes[:, axis]).as_matrix()
        rotated = SplinePath(
            (points - middle) @ rotation.T + middle, frames[..., 2] @ rotation.T)
        out.append(speed_error(Setup(path, rig), Setup(rotated, rig)))
    return math.hypot(*out)


def lane_speed_std(lane: LanePath, rig: StereoRig) -> float:
    """Return the relative 1-sigma of speeds on a lane by all uncertainty of its path."""
    heading = float(np.nan_to_num(heading_effect(lane.path, rig, lane.heading_std_rad)))
    return math.hypot(lane.scale_std, lane.shape_std, heading)


def _seen(setup: Setup) -> Array:
    """Return evenly spaced arc lengths (n,) of the visible part of a path, m; maybe none."""
    path = setup.path
    s = np.linspace(0, path.length_m, _LOOKED_AT)
    ends = seen_stretch(setup.rig, path.position(s) + _ABOVE_M * path.frame(s)[..., 2])
    return np.zeros(0) if ends is None else path.length_m * np.linspace(*ends, PLACES)
