# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The width and height of a vehicle.

The width is that of the front measured in the nearest pairs, or that of the tracked front if this
fails or a person marked the front.  The height is that of the highest strip above the middle of
the front that moves with the vehicle.  Such a strip has a depth behind the front at which it
correlates with the other view and with an earlier pair, where it is moved with the vehicle, and
does so better than with the same place of the earlier pair.
"""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, Optional, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from .classes import classified, is_no_vehicle
from ..core.passes import VehicleKind
from ..core.records import Array, StereoPair, TrackUpdate
from ..core.tracker_config import ClassConfig
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..vision.ncc import ncc

_LOOKS = 3  # after as many a narrow front counts without a height: in the dark none shows


class MeasuresWidth(Protocol):
    """Measures the width of a tracked front in a pair."""

    def widths_m(self, pair: StereoPair, update: TrackUpdate) -> list[float]:
        """Return the measured widths of the front, m; empty if it is not fully visible."""


@dataclass(frozen=True)
class HeightSearch:
    """
    Where the top of a vehicle is searched, and in which pairs.

    :param least_m: height of the lowest strip above the road, projected onto the front, m; a
        vehicle has nothing below its bumper.
    :param most_m: height of the highest strip, m, above the 4.0 to 4.3 m allowed on most roads.
    :param step_m: step between strips, m, a third of a strip so that they overlap.
    :param depths_m: depths of a strip behind the front that are tried, m.  A roof begins behind
        bonnet and windscreen, the box of a lorry behind its cab.  The steps grow because a wrong
        depth close to the front matters more.
    :param most_depth_m: a strip that agrees best at a greater depth belongs to another vehicle
        behind, m.
    :param half_height_m: half of the height of a strip, m, which is enough for some texture.
    :param width_share: width of a strip relative to that of the front, as roofs are narrower.
    :param across: samples across a strip.
    :param down: samples down a strip.
    :param least_range_ratio: least ratio of the ranges of two views that are compared.
    :param most_views: number of nearest views kept for a pass; two are used, the others replace
        those that do not show the top.
    """

    least_m: float = 0.2
    most_m: float = 4.5
    step_m: float = 0.1
    depths_m: tuple[float, ...] = (0, 0.25, 0.5, 0.8, 1.2, 1.6, 2, 2.5, 3, 4, 5, 6, 8)
    most_depth_m: float = 4.0
    half_height_m: float = 0.15
    width_share: float = 0.8
    across: int = 20
    down: int = 6
    least_range_ratio: float = 1.12
    most_views: int = 4

    @property
    def heights_m(self) -> Array:
        """Return the heights of the middles of the strips above the road, m."""
        count = round((self.most_m - self.least_m) / self.step_m) + 1
        return np.asarray(self.least_m + self.step_m * np.arange(count), np.float64)

    @property
    def strip(self) -> Array:
        """Return the samples of a strip: across in widths of the front, and up in m."""
        x, up = np.meshgrid(np.linspace(-0.5, 0.5, self.across) * self.width_share,
                            np.linspace(-self.half_height_m, self.half_height_m, self.down))
        return np.stack([x.ravel(), up.ravel()], axis=1)


@dataclass(frozen=True, eq=False)
class _View:
    """
    A pair that shows the vehicle.

    :param pair: the pair.
    :param update: update of the vehicle's track for the pair.
    :param road_m: height of the road relative to the middle of the front, m; negative.
    """

    pair: StereoPair
    update: TrackUpdate
    road_m: float

    @property
    def range_m(self) -> float:
        """Return the distance of the vehicle from the left camera, m."""
        return float(np.linalg.norm(self.update.position_m))


class VehicleSize:
    """
    Keeps some pairs that show one vehicle, and measures its size in them.

    ``may_be_edge`` is whether a detected front may be only an edge, of a vehicle or its shadow, by
    the pairs so far: it is narrow, and as high or low as no two-wheeler, or its height is not
    known yet.

    :param rig: the rig.
    :param lane: lane whose path the vehicle's positions refer to.
    :param config: sizes of the classes, and limits of the measurement.
    :param marked_std_px: 1-sigma of the corners of a front marked by a person, px; None for a
        detected front.
    :param fronts: measures the width of a detected front; None uses the tracked width.
    :param search: where the top is searched.
    """

    def __init__(self, rig: StereoRig, lane: LanePath, config: ClassConfig,
                 marked_std_px: Optional[float] = None, fronts: Optional[MeasuresWidth] = None,
                 search: HeightSearch = HeightSearch()) -> None:
        self.rig, self.lane, self.config = rig, lane, config
        self._marked_std_px, self._fronts, self._search = marked_std_px, fronts, search
        self._views: list[_View] = []
        self._first_px = 0.0  # width of the front in the first pair of the track
        self.may_be_edge, self._looked_m, self._looks = False, math.inf, 0

    def take(self, pair: StereoPair, update: TrackUpdate) -> None:
        """Add a pair that shows the vehicle, with its update."""
        self._first_px = self._first_px or float(np.ptp(update.quad_left_px[:, 0]))
        road = self.lane.path.position(np.array(update.s_m)) - update.position_m
        view = _View(pair, update, float(road @ update.axes[:, 2]))
        if len(self._views) > 1 and not self._apart(self._views[-1], self._views[-2]):
            self._views[-1] = view
        else:
            self._views.append(view)
        if len(self._views) > self._search.most_views:
            self._views.remove(max(self._views, key=lambda v: v.range_m))
        if self._marked_std_px is None:
            self._look_for_edge(view.range_m)

    def _look_for_edge(self, range_m: float) -> None:
        """
        See whether a narrow front is an edge, each time that its range has changed to show more.

        :param range_m: range of the newest view, m.
        """
        ratio = self._search.least_range_ratio
        if self._tracked_width_m()[0] >= self.config.edge_width_m:
            self.may_be_edge = False
        elif not self._looked_m / ratio < range_m < self._looked_m * ratio:
            self._looked_m, self._looks, found = range_m, self._looks + 1, self.measured()
            self.may_be_edge = found is not None and (
                is_no_vehicle(found, self.config) if found.height_m is not None else
                found.width_m < self.config.edge_width_m and self._looks < _LOOKS)

    def measured(self) -> Optional[VehicleKind]:
        """Return the size and class of the vehicle; None if no pair was added."""
        if not self._views:
            return None
        width_m, std_m = self._width_m()
        height_m = self._height_m(self._tracked_width_m()[0])
        return classified(width_m, std_m, height_m, self.config)

    def _width_m(self) -> tuple[float, float]:
        """Return the width of the front and its 1-sigma, m."""
        if self._marked_std_px is None and self._fronts is not None:
            measured = [self._fronts.widths_m(view.pair, view.update) for view in self._views]
            if len(widths := np.concatenate(measured)) > 1:
                return float(np.median(widths)), self.config.width_std_m
        return self._tracked_width_m()

    def _tracked_width_m(self) -> tuple[float, float]:
        """Return the width of the tracked front and its 1-sigma, m."""
        view = min(self._views, key=lambda v: v.range_m)
        update, rays = view.update, self.rig.as_taken(view.pair.motion).left.rays(
            view.update.quad_left_px)
        forward = update.axes[:, 0]
        corners = rays * ((update.position_m @ forward) / (rays @ forward))[:, None]
        width_m = float(np.ptp((corners - update.position_m) @ update.axes[:, 1]))
        if self._marked_std_px is None:
            return width_m, self.config.width_std_m
        # Each end is the mean of two corners, marked in the first pair.
        return width_m, self._marked_std_px * width_m / self._first_px

    def _height_m(self, width_m: float) -> Optional[float]:
        """Return the height above the road up to which strips move with the vehicle, m."""
        views = sorted(self._views, key=lambda v: v.range_m)
        best_m: Optional[float] = None
        for k, view in enumerate(views[:-1]):
            others = [other for other in views[k + 1:] if self._apart(other, view)]
            if not others:
                continue
            visible, height_m = self._strips(view, others[0], width_m)
            # The highest matching strip has the upper edge of the vehicle near its lower end.
            below_m = self._search.half_height_m - self._search.step_m / 2
            best_m = float(height_m.max()) - below_m if len(height_m) else None
            if visible[-1].any():
                break
        return best_m

    def _strips(self, view: _View, other: _View, width_m: float
                ) -> tuple[NDArray[np.bool_], Array]:
        """
        Find the strips that move with the vehicle from one view to another.

        :return: mask (strips, depths) of those inside all images, and heights (n,) above the road
            of those that move with the vehicle, m.
        """
        update, earlier = view.update, other.update
        rig, earlier_rig = (self.rig.as_taken(v.pair.motion) for v in (view, other))
        up, strip = view.road_m + self._search.heights_m, self._search.strip
        on_front = np.zeros((len(up), len(strip), 3))
        on_front[..., 1] = strip[:, 0] * width_m
        on_front[..., 2] = up[:, None] + strip[:, 1]
        on_plane = update.position_m + on_front @ update.axes.T
        ahead_m = abs(float(update.position_m @ update.axes[:, 0]))
        depth = 1 + np.array(self._search.depths_m) / ahead_m
        points = on_plane[:, None] * depth[:, None, None]  # (strips, depths, samples, 3)
        on_vehicle = (points - update.position_m) @ update.axes
        at_right_exposure = points + update.axes[:, 0] * update.speed_mps * view.pair.right_lag_s
        px = (rig.left.project(points), rig.right.project(rig.to_right(at_right_exposure)),
              earlier_rig.left.project(earlier.position_m + on_vehicle @ earlier.axes.T))
        (left,), (right,) = _samples(view.pair.left, px[0][0]), _samples(view.pair.right, px[1][0])
        moved, unmoved = _samples(other.pair.left, px[2][0], px[0][0])
        visible = np.all([valid.all(axis=-1) for _, valid in px], axis=0)
        moving_ncc = np.where(visible, np.minimum(ncc(left, right), ncc(left, moved)), -1.0)
        best = np.argmax(moving_ncc, axis=1)[:, None]
        moving_ncc, static_ncc = (np.take_along_axis(scores, best, axis=1)[:, 0]
                                  for scores in (moving_ncc, ncc(left, unmoved)))
        height_m = np.take_along_axis(on_vehicle[..., 2].mean(axis=-1), best, axis=1)[:, 0]
        moving = moving_ncc > self.config.least_ncc
        moving &= moving_ncc > static_ncc + self.config.still_margin
        moving &= np.array(self._search.depths_m)[best[:, 0]] <= self._search.most_depth_m
        # Strips overlap by two thirds, so a single moving strip is a chance match.
        moving &= np.convolve(moving, np.ones(3), 'same') > 1
        return visible, height_m[moving] - view.road_m

    def _apart(self, one: _View, other: _View) -> bool:
        """Return whether the ranges of two views differ enough."""
        near, far = sorted((one.range_m, other.range_m))
        return far >= self._search.least_range_ratio * near


def _samples(image: NDArray[Any], *uv_px: Array) -> list[Array]:
    """Return the grey values (..., G) at pixels (..., G, 2); 0 outside the image or for NaN."""
    grey, out = image.astype(np.float32), []
    for uv in uv_px:
        flat = np.nan_to_num(uv.reshape(-1, uv.shape[-2], 2), nan=-1e4).astype(np.float32)
        found = cv2.remap(grey, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR)
        out.append(np.asarray(found.reshape(uv.shape[:-1]), dtype=np.float64))
    return out
