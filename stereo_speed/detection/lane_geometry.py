# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Upright planes across a lane's path, and what a wrong depth does on them.

A face stands on the plane across the path at ``s``; a point of the plane is (x, h): metres to the
left of the path and above the road.  If what is seen through a point of the plane at ``s`` is in
truth at ``s + ds``, the right view shows it at another x, by ``shift`` per metre of ds, and it is
in truth at another height, by ``climb`` per metre.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..core.records import Array
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_HEIGHT_M = 0.5  # where rates are taken
_STEP_M = 0.5
MOST_BEYOND_M = 40.0  # the path goes on straight beyond its ends by so much
_NODES = (3, 5)  # up and across: pixels between them are interpolated by polynomials


@dataclass(frozen=True, eq=False)
class Rates:
    """
    Rates of the plane at arc lengths (n,).

    :param shift: change of x in the right view per metre that the truth lies further along.
    :param climb: change of height per metre that the truth lies further along.
    :param px_per_m: pixels of the left view per metre across.
    """

    shift: Array
    climb: Array
    px_per_m: Array


class LaneGeometry:
    """
    The planes of one lane.

    :param rig: the cameras.
    :param lane: the lane.
    """

    def __init__(self, rig: StereoRig, lane: LanePath) -> None:
        self.rig, self.lane = rig, lane
        self._centre = -rig.R.T @ rig.t  # of the right camera
        length = lane.path.length_m
        more = min(MOST_BEYOND_M, max(0.5 * length, 10.0))
        self._s_m = np.arange(-more, length + more, _STEP_M)
        self._rates = self.exact_rates(self._s_m)

    def points(self, s_m: Array, x_m: Array, h_m: Array) -> Array:
        """
        Points of planes.

        :param s_m: (n,).
        :param x_m: (n, w) or (w,).
        :param h_m: (m,).
        :return: (n, m, w, 3) left optical frame, m.
        """
        position, frame = self.lane.path.position(s_m), self.lane.path.frame(s_m)
        across = np.broadcast_to(x_m, (len(s_m), np.shape(x_m)[-1]))
        return (position[:, None, None] + across[:, None, :, None] * frame[:, None, None, :, 1]
                + h_m[None, :, None, None] * frame[:, None, None, :, 2])

    def project(self, s_m: Array, x_m: Array, h_m: Array) -> tuple[Array, Array, Array, Array]:
        """Project points of planes: pixels left and right, and whether they are in the image."""
        return self.rig.project(self.points(s_m, x_m, h_m))

    def pixels(self, s_m: Array, x_m: Array, reach_m: Array, h_m: Array, right: bool,
               lying: bool = False) -> Array:
        """
        Project a small grid on each of many planes into one view, by few exact points.

        :param s_m: (n,).
        :param x_m: (n,) middles of the grids.
        :param reach_m: (w,) columns about the middle, evenly rising.
        :param h_m: (m,) heights, evenly spaced.
        :param lying: project what the left camera sees through the grid where that lies on the
            road, not on the plane.
        :return: (n, m, w, 2) pixels, float32; far outside the image where there are none.
        """
        nodes_h = np.linspace(h_m[0], h_m[-1], _NODES[0])
        nodes_x = np.linspace(reach_m[0], reach_m[-1], _NODES[1])
        points = self.points(s_m, x_m[:, None] + nodes_x, nodes_h)
        if lying:
            up = self.lane.path.frame(s_m)[..., 2]
            below = np.sum(self.lane.path.position(s_m) * up, axis=-1)
            points = points * (below[:, None, None] / np.einsum('nmwi,ni->nmw', points, up)
                               )[..., None]
        if right:
            points = self.rig.to_right(points)
        uv = (self.rig.right if right else self.rig.left).project(points)[0]
        uv = np.nan_to_num(uv, nan=-1e4)
        by_height, across = _lagrange(_NODES[0], len(h_m)), _lagrange(_NODES[1], len(reach_m))
        mixed = np.einsum('mh,nhxc->nmcx', by_height, uv) @ across.T  # (n, m, 2, w)
        return np.ascontiguousarray(np.swapaxes(mixed, 2, 3), dtype=np.float32)

    def rates(self, s_m: Array) -> Rates:
        """
        Look up the rates in the middle of the lane.

        :param s_m: (n,).
        """
        return Rates(*(np.interp(s_m, self._s_m, values) for values in (
            self._rates.shift, self._rates.climb, self._rates.px_per_m)))

    def exact_rates(self, s_m: Array) -> Rates:
        """
        Compute the rates in the middle of the lane.

        :param s_m: (n,).
        """
        path = self.lane.path
        frame = path.frame(s_m)
        tangent, left, up = frame[..., 0], frame[..., 1], frame[..., 2]
        here = path.position(s_m) + _HEIGHT_M * up
        # The same ray of the left camera meets a plane a step further along there:
        depth = np.sum(here * tangent, axis=-1)
        there = here * (1 + _STEP_M / depth)[:, None]
        # and the right camera's ray to that point meets this plane there:
        ray = there - self._centre
        t = np.sum((here - self._centre) * tangent, axis=-1) / np.sum(ray * tangent, axis=-1)
        seen = self._centre + t[:, None] * ray
        a, _ = self.rig.left.project(here + 0.5 * left)
        b, _ = self.rig.left.project(here - 0.5 * left)
        return Rates(shift=np.sum((seen - here) * left, axis=-1) / _STEP_M,
                     climb=np.sum((there - here) * up, axis=-1) / _STEP_M,
                     px_per_m=np.linalg.norm(a - b, axis=-1))

    def seen(self, least_px_per_m: float, width_m: float, heights_m: Array) -> Array:
        """
        Find where along the lane a face is wholly seen in both views, and large enough.

        :return: (n,) arc lengths, 0.5 m apart.
        """
        _, _, left, right = self.project(self._s_m, np.array([-0.5, 0.5]) * width_m, heights_m)
        large = self._rates.px_per_m >= least_px_per_m
        return self._s_m[left.all(axis=(1, 2)) & right.all(axis=(1, 2)) & large]


@lru_cache(maxsize=256)
def _lagrange(nodes: int, count: int) -> Array:
    """Weights (count, nodes) of the polynomial through even nodes, at even places."""
    at, places = np.linspace(0.0, 1.0, nodes), np.linspace(0.0, 1.0, count)
    weights = np.ones((count, nodes))
    for i in range(nodes):
        for j in range(nodes):
            if i != j:
                weights[:, i] *= (places - at[j]) / (at[i] - at[j])
    return weights
