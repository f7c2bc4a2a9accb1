# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What an error of a path does to speeds measured along it, to first order.

A vehicle follows the true path and is seen in both views. Its arc length on the path at hand is
what explains its pixels best, while its place beside and above the path hardly changes. The slope
of these arc lengths against the true ones, each weighted by how well disparity determines it, is
the speed.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np

from ..core.records import Array
from ..geometry.rig import StereoRig

PLACES = 13  # at which the vehicle is seen
_FEWEST = 4  # fewer make no speed
_WANDER_STD_M = 0.05  # how constant the place beside and above the path is
_ANYWHERE_M = 10.0  # 1-sigma of that place, and of the arc lengths
_PIXEL_STD = 0.1  # px, of the place of a front in an image
_STEP_M = 1e-4  # of the differences by the place: 1e-2 px


@dataclass(frozen=True, eq=False)
class PathEffect:
    """
    How speeds depend on where a path lies.

    :param of_place: (n, 3) change of the speed, as a share, for each m that a place of the true
        path lies off.
    :param of_arc: (n,) the same for each m that its arc length is greater.
    """

    of_place: Array
    of_arc: Array

    def speed(self, displacement_m: Array, arc_m: Array) -> Array:
        """
        Return errors (...,) of the speed, as shares.

        :param displacement_m: (..., n, 3) of the places of the true path.
        :param arc_m: (..., n) by which their arc lengths along the true path are greater; what
            they have in common does not count.
        """
        return np.asarray(np.einsum('...ni,ni->...', displacement_m, self.of_place)
                          + arc_m @ self.of_arc)


def seen_stretch(rig: StereoRig, points_m: Array) -> Optional[tuple[float, float]]:
    """
    Return which part of a path both views see, as shares of its points; None where too little.

    :param points_m: (n, 3) evenly along it.
    """
    in_left, in_right = rig.project(points_m)[2:]
    both = np.flatnonzero(in_left & in_right)
    if len(both) < _FEWEST:
        return None
    return float(both[0] / (len(points_m) - 1)), float(both[-1] / (len(points_m) - 1))


def path_effect(rig: StereoRig, points_m: Array, frames: Array, arc_m: Array) -> PathEffect:
    """
    Return how speeds depend on a path.

    :param points_m: (n, 3) places of the path, seen in both views.
    :param frames: (n, 3, 3) columns T, P, B there.
    :param arc_m: (n,) arc lengths.
    """
    n = len(points_m)
    near = points_m[:, None] + _STEP_M * np.concatenate([np.eye(3), -np.eye(3)])
    seen = np.concatenate(rig.project(near)[:2], axis=-1)  # (n, 6, 4)
    slope = np.swapaxes(seen[:, :3] - seen[:, 3:], 1, 2) / (2 * _STEP_M * _PIXEL_STD)  # (n, 4, 3)
    # unknowns: along, beside and above at each place, and the usual beside and above
    normal = np.zeros((3 * n + 2, 3 * n + 2))
    right = np.zeros((3 * n + 2, n, 3))
    for i in range(n):
        here = slope[i] @ frames[i]
        at = slice(3 * i, 3 * i + 3)
        normal[at, at] += here.T @ here + np.diag([_ANYWHERE_M**-2, 0, 0])
        right[at, i] = here.T @ slope[i]
        for k in (1, 2):
            pair = np.array([3 * i + k, 3 * n + k - 1])
            normal[np.ix_(pair, pair)] += np.array([[1, -1], [-1, 1]]) / _WANDER_STD_M**2
    normal[-2:, -2:] += np.eye(2) / _ANYWHERE_M**2
    moved = np.linalg.solve(normal, right.reshape(3 * n + 2, -1))[:3 * n:3].reshape(n, n, 3)
    weight = points_m[:, 2]**-4.0
    lever = weight * (arc_m - np.average(arc_m, weights=weight))
    lever = lever / (lever @ arc_m)
    return PathEffect(np.einsum('i,ijk->jk', lever, moved), -lever)
