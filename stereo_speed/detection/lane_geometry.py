# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Upright planes across a lane's path, and the effect of a wrong depth on them.

A front stands on the plane across the path at ``s``; a point of the plane is (x, h): metres to the
left of the path and above the road.  If an object seen at a point of the plane at ``s`` is in fact
at ``s + ds``, the right view shows it at another x, by ``shift`` per metre of ds, and it has
another height, by ``climb`` per metre.  If it travels along the lane until the right view is
exposed, the right view shows it at another x as well, by ``slide`` per metre.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .pyramid import Patches
from ..core.records import Array
from ..geometry.camera import Camera
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_HEIGHT_M = 0.5  # height above the road at which rates are computed
_STEP_M = 0.5  # spacing of arc lengths for rates, and step of their numerical derivatives
MOST_BEYOND_M = 40.0  # greatest straight extension of the path beyond its ends
_NODES = (3, 5)  # up and across; pixels between them are interpolated by polynomials
_EDGE_PX = 2.0  # least distance of a quad from the edge of an image, for sampling at corners


@dataclass(frozen=True, eq=False)
class Rates:
    """
    Rates of the planes at arc lengths (n,).

    :param shift: change of x in the right view per metre that an object is further along.
    :param climb: change of height per metre that an object is further along.
    :param px_per_m: pixels of the left view per metre across.
    :param slide: change of x in the right view per metre travelled until its exposure.
    :param ahead_m: distance of the plane from the left camera along the path's direction, m.
    """

    shift: Array
    climb: Array
    px_per_m: Array
    slide: Array
    ahead_m: Array


class LaneGeometry:
    """
    The planes of one lane.

    :param rig: the cameras.
    :param lane: the lane.
    """

    def __init__(self, rig: StereoRig, lane: LanePath) -> None:
        self.rig, self.lane = rig, lane
        self._centre = -rig.R.T @ rig.t  # centre of the right camera
        length = lane.path.length_m
        more = min(MOST_BEYOND_M, max(0.5 * length, 10.0))
        self._s_m = np.arange(-more, length + more, _STEP_M)
        with np.errstate(divide='ignore', invalid='ignore'):  # undefined beside the cameras
            self._rates = self.exact_rates(self._s_m)

    def points(self, s_m: Array, x_m: Array, h_m: Array) -> Array:
        """
        Return points of planes.

        :param s_m: (n,) arc lengths, m.
        :param x_m: (n, w) or (w,) offsets to the left of the path, m.
        :param h_m: (m,) heights above the road, m.
        :return: (n, m, w, 3) left optical frame, m.
        """
        position, frame = self.lane.path.position(s_m), self.lane.path.frame(s_m)
        across = np.broadcast_to(x_m, (len(s_m), np.shape(x_m)[-1]))
        return (position[:, None, None] + across[:, None, :, None] * frame[:, None, None, :, 1]
                + h_m[None, :, None, None] * frame[:, None, None, :, 2])

    def project(self, s_m: Array, x_m: Array, h_m: Array) -> tuple[
            Array, Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Return the pixels of points of planes, left and right, and which are in the images."""
        return self.rig.project(self.points(s_m, x_m, h_m))

    def left_pixels(self, s_m: Array, x_m: Array, reach_m: Array, h_m: Array) -> Patches:
        """
        Project a small grid on each of many planes into the left view, by a few exact points.

        :param s_m: (n,) arc lengths, m.
        :param x_m: (n,) middles of the grids, m to the left of the path.
        :param reach_m: (w,) columns relative to the middle, evenly spaced and increasing, m.
        :param h_m: (m,) heights above the road, evenly spaced, m.
        :return: (n, m, w, 2) pixels, float32; far outside the image where there are none.
        """
        points = self._nodes(s_m, x_m, reach_m, h_m)
        return _interpolated(self.rig.left.project(points)[0], len(h_m), len(reach_m))

    def right_pixels(self, s_m: Array, x_m: Array, reach_m: Array, h_m: Array, ahead_m: Array,
                     lying: bool = False) -> Patches:
        """
        Project a small grid on each of many planes into the right view.

        Further arguments are those of :meth:`left_pixels`.

        :param ahead_m: (n,) distances travelled along the path until the right view is exposed, m.
        :param lying: whether to project the points of the road that the left camera sees through
            the grid, instead of the grid.
        """
        if lying:
            points = self._carried(self._on_road(
                s_m, self._nodes(s_m, x_m, reach_m, h_m)), s_m, ahead_m)
        else:
            points = self._nodes(s_m + ahead_m, x_m, reach_m, h_m)
        uv = self.rig.right.project(self.rig.to_right(points))[0]
        return _interpolated(uv, len(h_m), len(reach_m))

    def both_pixels(self, s_m: Array, x_m: Array, reach_m: Array, h_m: Array, ahead_m: Array
                    ) -> tuple[Patches, Patches]:
        """
        Project a small grid on each of many planes into both views.

        :return: the results of :meth:`left_pixels` and :meth:`right_pixels` for these arguments.
        """
        points, later = self._nodes(s_m, x_m, reach_m, h_m), None
        if ahead_m.any():
            later = self._nodes(s_m + ahead_m, x_m, reach_m, h_m)
        both = _interpolated(np.concatenate(self.rig.project(points, later)[:2]), len(h_m),
                             len(reach_m))
        return both[:len(s_m)], both[len(s_m):]

    def across(self, s_m: float, uv_px: Array) -> Array:
        """
        Return the offsets x (n,) at which rays of the left camera meet one plane; NaN behind it.

        :param s_m: arc length of the plane, m.
        :param uv_px: (n, 2) pixels of the left view.
        """
        x, _ = self._met(np.full(len(uv_px), s_m), self.rig.left.rays(uv_px))
        return x

    def aslant(self, s_m: float, x_m: float) -> float:
        """
        Return how far to the left of a place the left camera sees a point a metre farther away, m.

        :param s_m: arc length of the place, m.
        :param x_m: offset of the place to the left of the path, m.
        """
        frame = self.lane.path.frame(np.array(s_m))
        along, left, _ = (self.lane.path.position(np.array(s_m)) + x_m * frame[:, 1]) @ frame
        return float(-left / abs(along)) if along else 0.0

    def on_road(self, uv_px: Array) -> float:
        """
        Return the arc length at which a ray of the left camera meets the road; NaN if nowhere.

        :param uv_px: (2,) pixel of the left view.
        """
        ray = self.rig.left.rays(uv_px)
        _, h = self._met(self._s_m, np.broadcast_to(ray, (len(self._s_m), 3)))
        with np.errstate(invalid='ignore'):
            crossed = np.flatnonzero(h[:-1] * h[1:] <= 0)
        if not len(crossed):
            return float('nan')
        k = int(crossed[0])
        share = h[k] / (h[k] - h[k + 1]) if h[k] != h[k + 1] else 0.0
        return float(self._s_m[k] + share * (self._s_m[k + 1] - self._s_m[k]))

    def _met(self, s_m: Array, rays: Array) -> tuple[Array, Array]:
        """Return x and height (n,) at which rays (n, 3) meet planes (n,); NaN behind them."""
        position, frame = self.lane.path.position(s_m), self.lane.path.frame(s_m)
        with np.errstate(divide='ignore', invalid='ignore'):
            far = np.sum(position * frame[..., 0], axis=-1) / np.sum(rays * frame[..., 0], axis=-1)
        far = np.where(far > 0, far, np.nan)
        off = far[:, None] * rays - position
        return np.sum(off * frame[..., 1], axis=-1), np.sum(off * frame[..., 2], axis=-1)

    def _nodes(self, s_m: Array, x_m: Array, reach_m: Array, h_m: Array) -> Array:
        """Return the points (n, up, across, 3) of grids that are projected exactly."""
        nodes_h = np.linspace(h_m[0], h_m[-1], _NODES[0])
        nodes_x = np.linspace(reach_m[0], reach_m[-1], _NODES[1])
        return self.points(s_m, x_m[:, None] + nodes_x, nodes_h)

    def _on_road(self, s_m: Array, points: Array) -> Array:
        """Return where the left camera's rays through points (n, m, w, 3) meet the road."""
        up = self.lane.path.frame(s_m)[..., 2]
        below = np.sum(self.lane.path.position(s_m) * up, axis=-1)
        return np.asarray(points * (below[:, None, None] / np.einsum('nmwi,ni->nmw', points, up)
                                    )[..., None])

    def _carried(self, points: Array, s_m: Array, ahead_m: Array) -> Array:
        """Return points (n, m, w, 3) after they have travelled along the path."""
        if not ahead_m.any():
            return points
        path, there = self.lane.path, s_m + ahead_m
        turned = path.frame(there) @ np.swapaxes(path.frame(s_m), 1, 2)
        return np.asarray(path.position(there)[:, None, None] + np.einsum(
            'nij,nmwj->nmwi', turned, points - path.position(s_m)[:, None, None]))

    def px_per_m(self, s_m: Array) -> Array:
        """Return ``px_per_m`` of :meth:`rates` alone."""
        return np.interp(s_m, self._s_m, self._rates.px_per_m)

    def rates(self, s_m: Array) -> Rates:
        """
        Return the rates in the middle of the lane, interpolated.

        :param s_m: (n,) arc lengths, m.
        """
        return Rates(*(np.interp(s_m, self._s_m, values) for values in (
            self._rates.shift, self._rates.climb, self._rates.px_per_m, self._rates.slide,
            self._rates.ahead_m)))

    def exact_rates(self, s_m: Array) -> Rates:
        """
        Return the rates in the middle of the lane, computed exactly.

        :param s_m: (n,) arc lengths, m.
        """
        path = self.lane.path
        frame = path.frame(s_m)
        tangent, left, up = frame[..., 0], frame[..., 1], frame[..., 2]
        here = path.position(s_m) + _HEIGHT_M * up
        # Where the same left ray meets a plane one step further along:
        depth = np.sum(here * tangent, axis=-1)
        there = here * (1 + _STEP_M / depth)[:, None]
        # Where the right camera's ray to that point meets this plane:
        seen = self._seen_on(here, tangent, there)
        on = path.position(s_m + _STEP_M) + _HEIGHT_M * path.frame(s_m + _STEP_M)[..., 2]
        gone = self._seen_on(here, tangent, on)
        a, _ = self.rig.left.project(here + 0.5 * left)
        b, _ = self.rig.left.project(here - 0.5 * left)
        return Rates(shift=np.sum((seen - here) * left, axis=-1) / _STEP_M,
                     climb=np.sum((there - here) * up, axis=-1) / _STEP_M,
                     px_per_m=np.linalg.norm(a - b, axis=-1),
                     slide=np.sum((gone - here) * left, axis=-1) / _STEP_M,
                     ahead_m=depth)

    def _seen_on(self, plane: Array, normal: Array, points: Array) -> Array:
        """Return where the right camera's rays to points (n, 3) meet the planes (n, 3)."""
        ray = points - self._centre
        t = np.sum((plane - self._centre) * normal, axis=-1) / np.sum(ray * normal, axis=-1)
        return np.asarray(self._centre + t[:, None] * ray)

    def seen(self, least_px_per_m: float, width_m: float, heights_m: Array) -> Array:
        """
        Return where along the lane a front is wholly in both images, and large enough.

        :param least_px_per_m: least scale of the left view.
        :param width_m: width of the front, m.
        :param heights_m: heights of its points above the road, m.
        :return: (n,) arc lengths, 0.5 m apart.
        """
        _, _, left, right = self.project(self._s_m, np.array([-0.5, 0.5]) * width_m, heights_m)
        large = self._rates.px_per_m >= least_px_per_m
        return self._s_m[left.all(axis=(1, 2)) & right.all(axis=(1, 2)) & large]


def well_inside(camera: Camera, uv_px: Array) -> NDArray[np.bool_]:
    """
    Return which pixels lie in an image and far enough from its edge to be sampled around.

    :param camera: the camera of the image.
    :param uv_px: (..., 2) raw pixels.
    """
    last = np.array([camera.width_px, camera.height_px]) - 1 - _EDGE_PX
    return np.asarray(((uv_px >= _EDGE_PX) & (uv_px <= last)).all(axis=-1))


def _interpolated(uv: Array, rows: int, columns: int) -> Patches:
    """Return pixels (n, rows, columns, 2) interpolated between nodes (n, up, across, 2)."""
    if not np.isfinite(uv).all():  # checking first is much cheaper than replacing
        uv = np.nan_to_num(uv, nan=-1e4)
    by_height, across = _lagrange(_NODES[0], rows), _lagrange(_NODES[1], columns)
    mixed = np.einsum('mh,nhxc->nmcx', by_height, uv) @ across.T  # (n, m, 2, w)
    return np.ascontiguousarray(np.swapaxes(mixed, 2, 3), dtype=np.float32)


@lru_cache(maxsize=256)
def _lagrange(nodes: int, count: int) -> Array:
    """Return Lagrange weights (count, nodes) for evenly spaced nodes and places."""
    at, places = np.linspace(0.0, 1.0, nodes), np.linspace(0.0, 1.0, count)
    weights = np.ones((count, nodes))
    for i in range(nodes):
        for j in range(nodes):
            if i != j:
                weights[:, i] *= (places - at[j]) / (at[i] - at[j])
    return weights
