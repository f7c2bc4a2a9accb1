# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What an error of the path or of the rig does to a measured speed.

A point travels at constant speed, at a fixed place beside and above the true path. It is seen by
the rig that takes the images and measured with the path and the rig at hand: arc lengths at all
times and one place beside and above the path, by least squares of its pixels. The slope of the
arc lengths, each weighted by what it can be known to, is the speed.
"""
from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ...core.records import Array
from ...geometry.rig import StereoRig
from ...road.path import Path, SplinePath

_PLACES = 13
_ABOVE_M = 0.6  # the middle of a front
_WANDER_STD_M = 0.05  # how constant the place beside and above the path is


def speed_error(true: tuple[Path, StereoRig], used: tuple[Path, StereoRig]) -> float:
    """
    Give the error of the mean speed of a pass, as a share.

    :param true: path and rig as they are.
    :param used: path and rig that are measured with.
    :return: NaN where too little of the path is seen.
    """
    s = _seen(*true)
    if len(s) < 4:
        return float('nan')
    frame, place = true[0].frame(s), true[0].position(s)
    points = place + _ABOVE_M * frame[..., 2]
    seen = true[1].project(points)[:2]
    start = np.zeros((len(s), 3))
    start[:, 0] = used[0].arc_length(place)
    start[:, 2] = _ABOVE_M
    path, rig = used

    def residuals(x: Array) -> Array:
        along, beside, above = x[:-2].reshape(-1, 3).T
        axes = path.frame(along)
        at = path.position(along) + beside[:, None] * axes[..., 1] + above[:, None] * axes[..., 2]
        off = [a - b for a, b in zip(rig.project(at)[:2], seen)]
        wander = np.concatenate([beside - x[-2], above - x[-1]]) / _WANDER_STD_M
        # a tenth of a pixel, as good as a look
        return np.nan_to_num(np.concatenate([off[0].ravel(), off[1].ravel(), 0.1 * wander]))

    found = least_squares(residuals, np.append(start.ravel(), [0.0, _ABOVE_M]), x_scale='jac',
                          xtol=1e-10, ftol=1e-10)
    weight = points[:, 2]**-4.0
    along, middle = found.x[:-2].reshape(-1, 3)[:, 0], np.average(s, weights=weight)
    slope = np.sum(weight * (s - middle) * along) / np.sum(weight * (s - middle)**2)
    return float(slope - 1)


def heading_effect(path: Path, rig: StereoRig, heading_std_rad: Array) -> float:
    """
    Give the 1-sigma of the mean speed of a pass, as a share, for an uncertain direction.

    :param heading_std_rad: (2,) of the path in its middle, across and up.
    """
    s = np.linspace(0, path.length_m, max(int(path.length_m), 8))
    points, frames = path.position(s), path.frame(s)
    middle, axes = points[len(s) // 2], frames[len(s) // 2]
    out = []
    for axis, std in ((2, heading_std_rad[0]), (1, heading_std_rad[1])):
        turn = Rotation.from_rotvec(float(std) * axes[:, axis]).as_matrix()
        turned = SplinePath((points - middle) @ turn.T + middle, frames[..., 2] @ turn.T)
        out.append(speed_error((path, rig), (turned, rig)))
    return float(np.hypot(*out))


def _seen(path: Path, rig: StereoRig) -> Array:
    """Give places (n,), even in time, of the stretch that both views see."""
    s = np.linspace(0, path.length_m, 101)
    _, _, left, right = rig.project(path.position(s) + _ABOVE_M * path.frame(s)[..., 2])
    both = np.flatnonzero(left & right)
    if len(both) < 2:
        return np.zeros(0)
    return np.linspace(s[both[0]], s[both[-1]], _PLACES)
