# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The simulated road in its world frame.

World: x along the right lane's path at station 0, y to its left, z up. A point of the road has a
station (plan arc length along the right lane's path, m) and an offset from that path (positive to
the left of travel, m). Its height is that of the line about which the road is turned, which
follows a grade, a parabola and another grade, plus the offset from that line times the local
crossfall.
"""
from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import cKDTree

from .config import RoadConfig
from ...core.records import Array

FROM_M, TO_M, STEP_M = -260.0, 420.0, 0.1
BANKED_M = 15.0  # distance beside the path up to which the ground follows the crossfall
CELL_M = 0.5  # cell size of the raster that starts the search for a point's station


class Road:
    """
    The road's surface.

    :param config: its shape.
    """

    def __init__(self, config: RoadConfig) -> None:
        self.config = config
        self._middle_m = middle = config.clothoid_at_m + config.clothoid_m / 2
        curvature = max(abs(config.curvature_start), abs(config.curvature_end))
        # A full circle would overlap itself, so a gap is left on the far side.
        half = min(200.0, 2.2 / curvature) if curvature else 250.0
        self.from_m, self.to_m = middle - half, middle + half

    @property
    def curved(self) -> bool:
        """Return whether the road is curved anywhere."""
        return bool(self.config.curvature_start or self.config.curvature_end)

    @property
    def folded(self) -> bool:
        """Return whether grade or crossfall changes, so that the road may occlude itself."""
        c = self.config
        return bool(c.crossfall_start or c.crossfall_end
                    or c.grade_end not in (None, c.grade))

    def curvature(self, station_m: ArrayLike) -> Array:
        """Return the curvature of the right lane's path, 1/m."""
        c = self.config
        return np.asarray(c.curvature_start
                          + (c.curvature_end - c.curvature_start) * self._share(station_m))

    def crossfall(self, station_m: ArrayLike) -> Array:
        """Return the rise to the left over plan distance."""
        c = self.config
        return np.asarray(c.crossfall_start
                          + (c.crossfall_end - c.crossfall_start) * self._share(station_m))

    def _share(self, station_m: ArrayLike) -> Array:
        """Return which share of the clothoid lies before a station."""
        c = self.config
        return np.clip((np.asarray(station_m) - c.clothoid_at_m) / c.clothoid_m, 0.0, 1.0)

    def _vertical(self, station_m: Array) -> tuple[Array, Array]:
        """Return height and grade of the line that is not turned; the height at station 0 is 0."""
        c = self.config
        change = (c.grade if c.grade_end is None else c.grade_end) - c.grade

        def added(s: Array) -> tuple[Array, Array]:
            into = np.clip(s - c.vertical_curve_at_m + c.vertical_curve_m / 2, 0.0, None)
            on = np.minimum(into, c.vertical_curve_m)
            rise = change / c.vertical_curve_m
            return rise * (on ** 2 / 2 + c.vertical_curve_m * (into - on)), rise * on
        height, grade = added(station_m)
        return c.grade * station_m + height - added(np.zeros(1))[0][0], c.grade + grade

    def height(self, station_m: ArrayLike, offset_m: ArrayLike = 0.0) -> Array:
        """Return the height of points of the surface, m."""
        s = np.asarray(station_m, dtype=float)
        banked = np.clip(np.asarray(offset_m, dtype=float), -BANKED_M, BANKED_M)
        beside = banked - self.config.turned_about_m
        return np.asarray(self._vertical(s)[0] + beside * self.crossfall(s))

    def slope(self, station_m: ArrayLike, offset_m: ArrayLike = 0.0) -> Array:
        """Return the rise per station of the line at this offset."""
        c, s = self.config, np.asarray(station_m, dtype=float)
        into = s - c.clothoid_at_m
        twist = np.where((into > 0) & (into < c.clothoid_m),
                         (c.crossfall_end - c.crossfall_start) / c.clothoid_m, 0.0)
        return np.asarray(self._vertical(s)[1] + (np.asarray(offset_m) - c.turned_about_m) * twist)

    def heading(self, station_m: ArrayLike) -> Array:
        """Return the heading of the right lane's path, rad, anticlockwise from x."""
        return self._turned(station_m) - self._turned(0.0)

    def _turned(self, station_m: ArrayLike) -> Array:
        """Return the heading relative to that where the clothoid begins, rad."""
        c = self.config
        s = np.asarray(station_m, dtype=float) - c.clothoid_at_m
        inside = np.clip(s, 0.0, c.clothoid_m)
        beyond = s - inside
        change = c.curvature_end - c.curvature_start
        ramp = c.curvature_start * inside + change * inside ** 2 / (2 * c.clothoid_m)
        beyond *= np.where(beyond < 0, c.curvature_start, c.curvature_end)
        return np.asarray(ramp + beyond)

    @cached_property
    def _table(self) -> CubicHermiteSpline:
        nodes = np.arange(round(FROM_M / STEP_M), round(TO_M / STEP_M) + 1) * STEP_M
        gauss, weight = np.polynomial.legendre.leggauss(4)
        h = self.heading(nodes[:-1, None] + (gauss + 1) * STEP_M / 2)
        steps = np.stack([np.cos(h) @ weight, np.sin(h) @ weight], axis=1) * STEP_M / 2
        xy = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        xy -= xy[round(-FROM_M / STEP_M)]
        h = self.heading(nodes)
        return CubicHermiteSpline(nodes, xy, np.stack([np.cos(h), np.sin(h)], axis=1))

    def position(self, station_m: ArrayLike, offset_m: ArrayLike = 0.0) -> Array:
        """Return points of the surface, (..., 3) in the world, m."""
        s = np.asarray(station_m, dtype=float)
        h, n = self.heading(s), np.asarray(offset_m, dtype=float)
        xy = self._table(s) + n[..., None] * np.stack([-np.sin(h), np.cos(h)], axis=-1)
        return np.concatenate([xy, self.height(s, n)[..., None]], axis=-1)

    def frame(self, station_m: float, offset_m: float) -> Array:
        """Return the columns [along, left, up] (3, 3) at a point of the surface, world."""
        h = float(self.heading(station_m))
        plan = 1.0 - float(self.curvature(station_m)) * offset_m
        along = np.array([plan * np.cos(h), plan * np.sin(h),
                          float(self.slope(station_m, offset_m))])
        along /= np.linalg.norm(along)
        left = np.array([-np.sin(h), np.cos(h), float(self.crossfall(station_m))])
        left -= (left @ along) * along
        left /= np.linalg.norm(left)
        return np.stack([along, left, np.cross(along, left)], axis=1)

    def length_per_station(self, station_m: ArrayLike, offset_m: float) -> Array:
        """Return d(arc length of the line at this offset)/d(station)."""
        plan = 1.0 - self.curvature(station_m) * offset_m
        return np.hypot(plan, self.slope(station_m, offset_m))

    def station(self, xy_m: Array) -> tuple[Array, Array]:
        """
        Find the station and offset of plan points.

        :param xy_m: (..., 2) world, m.
        :return: station (...,) and offset (...,), m; only approximate far from the road.
        """
        curvature = self.config.curvature_start
        x, y = xy_m[..., 0], xy_m[..., 1]
        if curvature != self.config.curvature_end:
            return self._search(xy_m)
        if curvature == 0:
            return x, y
        radius = 1 / curvature
        middle = self._middle_m * curvature
        # The angle is relative to the road's middle, so that its discontinuity is in the gap.
        c, s = np.cos(middle), np.sin(middle)
        across, along = radius - y, x
        angle = np.arctan2((along * c - across * s) * np.sign(radius),
                           (along * s + across * c) * np.sign(radius))
        return (angle + middle) * radius, radius - np.hypot(x, y - radius) * np.sign(radius)

    @cached_property
    def _raster(self) -> tuple[Array, Array]:
        nodes = np.arange(self.from_m, self.to_m, CELL_M)
        points = self._table(nodes)
        low, high = points.min(axis=0) - 20.0, points.max(axis=0) + 20.0
        cells = np.ceil((high - low) / CELL_M).astype(int)
        grid = np.stack(np.meshgrid(*(low[i] + (np.arange(cells[i]) + 0.5) * CELL_M
                                      for i in (0, 1)), indexing='ij'), axis=-1)
        return nodes[cKDTree(points).query(grid)[1]], low

    def _search(self, xy_m: Array) -> tuple[Array, Array]:
        """Find the stations where no closed form exists, by a raster and Newton steps."""
        raster, low = self._raster
        cell = ((xy_m - low) / CELL_M).astype(int)
        last = np.array(raster.shape) - 1
        cell = np.clip(cell, 0, last)
        s = raster[cell[..., 0], cell[..., 1]]
        offset = np.zeros_like(s)
        for _ in range(3):
            h = self.heading(s)
            gap = xy_m - self._table(s)
            ahead = gap[..., 0] * np.cos(h) + gap[..., 1] * np.sin(h)
            offset = gap[..., 1] * np.cos(h) - gap[..., 0] * np.sin(h)
            slope = np.maximum(1.0 - self.curvature(s) * offset, 0.2)
            s = np.clip(s + ahead / slope, FROM_M, TO_M)
        return s, offset

    def line_offsets(self) -> dict[str, float]:
        """Return the offset of each marked line from the right lane's path, m, by name."""
        c = self.config
        names = ['edge_right', *(f'line_{i}' for i in range(c.lanes - 1)), 'edge_left']
        return {name: (i - 0.5) * c.lane_width_m for i, name in enumerate(names)}

    def lane_offset(self, lane: int) -> float:
        """Return the offset of a lane's path from the right lane's path, m."""
        return lane * self.config.lane_width_m
