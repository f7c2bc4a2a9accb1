# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The effect of an error of a path on speeds measured along it, to first order.

A vehicle follows the true path and is seen in both views. Its measured arc length is the one on
the assumed path that explains its pixels best, while its offsets across and above the path hardly
change. The measured speed is the slope of these arc lengths over the true ones, each weighted by
how well disparity determines it.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np

from ..core.records import Array
from ..geometry.rig import StereoRig

PLACES = 13  # number of places at which the vehicle is seen
_FEWEST = 4  # fewest visible points of a path for a speed
OFFSET_CHANGE_STD_M = 0.05  # 1-sigma of a vehicle's offsets from their means during its pass
_ANYWHERE_M = 10.0  # prior 1-sigma of these offsets and of the arc lengths
FRONT_STD_PX = 0.1  # 1-sigma of the position of a front in an image
_STEP_M = 1e-4  # step for finite differences by the position, about 1e-2 px


@dataclass(frozen=True, eq=False)
class PathEffect:
    """
    The derivatives of the speed by the places of the true path.

    :param of_place: (n, 3) relative change of the speed per m of displacement of each place.
    :param of_arc: (n,) relative change of the speed per m of greater arc length of each place.
    """

    of_place: Array
    of_arc: Array

    def speed(self, displacement_m: Array, arc_m: Array) -> Array:
        """
        Return the relative errors (...,) of the speed.

        :param displacement_m: (..., n, 3) displacements of the places of the true path, m.
        :param arc_m: (..., n) increases of their arc lengths along the true path, m; a common
            increase has no effect.
        """
        return np.asarray(np.einsum('...ni,ni->...', displacement_m, self.of_place)
                          + arc_m @ self.of_arc)


def seen_stretch(rig: StereoRig, points_m: Array) -> Optional[tuple[float, float]]:
    """
    Return begin and end of the part of a path that both views see, as shares of its length.

    :param points_m: (n, 3) evenly spaced points of the path, m.
    :return: None if too few of the points are visible.
    """
    in_left, in_right = rig.project(points_m)[2:]
    both = np.flatnonzero(in_left & in_right)
    if len(both) < _FEWEST:
        return None
    return float(both[0] / (len(points_m) - 1)), float(both[-1] / (len(points_m) - 1))


def path_effect(rig: StereoRig, points_m: Array, frames: Array, arc_m: Array) -> PathEffect:
    """
    Return how speeds depend on the places of a path.

    :param points_m: (n, 3) places of the path that both views see, m.
    :param frames: (n, 3, 3) columns T, P, B there.
    :param arc_m: (n,) arc lengths of the places, m.
    """
    n = len(points_m)
    near = points_m[:, None] + _STEP_M * np.concatenate([np.eye(3), -np.eye(3)])
    seen = np.concatenate(rig.project(near)[:2], axis=-1)  # (n, 6, 4)
    slope = np.swapaxes(seen[:, :3] - seen[:, 3:], 1, 2)  # (n, 4, 3)
    slope = slope / (2 * _STEP_M * FRONT_STD_PX)
    # Unknowns: shift along, across and above at each place, then the common ones across and above.
    normal = np.zeros((3 * n + 2, 3 * n + 2))
    right = np.zeros((3 * n + 2, n, 3))
    for i in range(n):
        here = slope[i] @ frames[i]
        at = slice(3 * i, 3 * i + 3)
        normal[at, at] += here.T @ here + np.diag([_ANYWHERE_M**-2, 0, 0])
        right[at, i] = here.T @ slope[i]
        for k in (1, 2):
            pair = np.array([3 * i + k, 3 * n + k - 1])
            normal[np.ix_(pair, pair)] += np.array([[1, -1], [-1, 1]]) / OFFSET_CHANGE_STD_M**2
    normal[-2:, -2:] += np.eye(2) / _ANYWHERE_M**2
    moved = np.linalg.solve(normal, right.reshape(3 * n + 2, -1))[:3 * n:3].reshape(n, n, 3)
    weight = points_m[:, 2]**-4.0
    lever = weight * (arc_m - np.average(arc_m, weights=weight))
    lever = lever / (lever @ arc_m)
    return PathEffect(np.einsum('i,ijk->jk', lever, moved), -lever)
