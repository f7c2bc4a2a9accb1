# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How wide and how high a vehicle is.

Its width is that of its front in the nearest pairs, or, where that is not seen or was marked by a
person, of the front that is tracked.  Its height is that of the highest strip above the middle
of the front that moves along: of all depths behind the front there is one at which the strip
correlates with the other view and, carried along with the vehicle, with an earlier pair, better
than with what was in the same place of that pair.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from .classes import classified
from ..core.config import ClassConfig
from ..core.passes import VehicleKind
from ..core.records import Array, StereoPair, TrackUpdate
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..vision.ncc import ncc


class MeasuresWidth(Protocol):
    """Measures the width of a tracked front in a pair."""

    def widths_m(self, pair: StereoPair, update: TrackUpdate) -> list[float]:
        """Return the widths that are seen of it, m; none where it does not show whole."""


@dataclass(frozen=True)
class HeightSearch:
    """
    Where the top of a vehicle is looked for, and in which pairs.

    :param least_m: height of the lowest strip above the road, as if on the front: below bumpers
        there is nothing of a vehicle.
    :param most_m: height of the highest, above what may drive on most roads: 4.0 to 4.3 m.
    :param step_m: from strip to strip, a third of a strip, so that they overlap.
    :param behind_m: depths behind the front at which a strip may be: a roof begins as far behind
        it as bonnet and windscreen are long, the box of a lorry behind its cab; where it is near,
        a wrong depth is seen sooner, so the steps grow.
    :param own_m: what agrees best at a greater one of these depths is another vehicle's, behind.
    :param half_height_m: half of the height of a strip, which shows some texture then.
    :param width_share: of a strip, of that of the front: roofs are narrower than bumpers.
    :param across: samples of a strip across.
    :param down: and down.
    :param farther: a view shows enough of a change beside another that is so many times as near.
    :param most_views: that are kept of a pass, the nearest ones; two are used, the others replace
        those that do not show the top.
    """

    least_m: float = 0.2
    most_m: float = 4.5
    step_m: float = 0.1
    behind_m: tuple[float, ...] = (0, 0.25, 0.5, 0.8, 1.2, 1.6, 2, 2.5, 3, 4, 5, 6, 8)
    own_m: float = 4.0
    half_height_m: float = 0.15
    width_share: float = 0.8
    across: int = 20
    down: int = 6
    farther: float = 1.12
    most_views: int = 4

    @property
    def heights_m(self) -> Array:
        """Return the heights of the middles of the strips above the road."""
        count = round((self.most_m - self.least_m) / self.step_m) + 1
        return np.asarray(self.least_m + self.step_m * np.arange(count), np.float64)

    @property
    def strip(self) -> Array:
        """Return the samples of a strip: across in shares of the front's width, and up in m."""
        x, up = np.meshgrid(np.linspace(-0.5, 0.5, self.across) * self.width_share,
                            np.linspace(-self.half_height_m, self.half_height_m, self.down))
        return np.stack([x.ravel(), up.ravel()], axis=1)


@dataclass(frozen=True, eq=False)
class _View:
    """
    A pair that shows the vehicle.

    :param pair: the pair.
    :param update: where the vehicle is in it.
    :param road_m: height of the road above the middle of its front, m: negative.
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
    Keeps some pairs that show one vehicle, and measures it in them.

    :param rig: the cameras.
    :param lane: the lane whose path its places are told by.
    :param config: sizes of the classes, and what counts.
    :param marked_std_px: 1-sigma of the corners of the front that a person marked, px; None for
        one that was detected.
    :param fronts: measures the width of a front that was detected; None leaves the tracked one.
    :param search: where its top is looked for.
    """

    def __init__(self, rig: StereoRig, lane: LanePath, config: ClassConfig,
                 marked_std_px: Optional[float] = None, fronts: Optional[MeasuresWidth] = None,
                 search: HeightSearch = HeightSearch()) -> None:
        self.rig, self.lane, self.config = rig, lane, config
        self._marked_std_px, self._fronts, self._search = marked_std_px, fronts, search
        self._views: list[_View] = []
        self._first_px = 0.0  # width of the front where the track began

    def take(self, pair: StereoPair, update: TrackUpdate) -> None:
        """Take in a pair that shows the vehicle, and where it is in it."""
        self._first_px = self._first_px or float(np.ptp(update.quad_left_px[:, 0]))
        road = self.lane.path.position(np.array(update.s_m)) - update.position_m
        view = _View(pair, update, float(road @ update.axes[:, 2]))
        if len(self._views) > 1 and not self._apart(self._views[-1], self._views[-2]):
            self._views[-1] = view
        else:
            self._views.append(view)
        if len(self._views) > self._search.most_views:
            self._views.remove(max(self._views, key=lambda v: v.range_m))

    def measured(self) -> Optional[VehicleKind]:
        """Return the size and class of the vehicle; None where no pair showed it."""
        if not self._views:
            return None
        width_m, std_m = self._width_m()
        height_m = self._height_m(self._tracked_width_m()[0])
        return classified(width_m, std_m, height_m, self.config)

    def _width_m(self) -> tuple[float, float]:
        """Return the width of the front and its 1-sigma, m."""
        if self._marked_std_px is None and self._fronts is not None:
            seen = [self._fronts.widths_m(view.pair, view.update) for view in self._views]
            if len(widths := np.concatenate(seen)) > 1:
                return float(np.median(widths)), self.config.width_std_m
        return self._tracked_width_m()

    def _tracked_width_m(self) -> tuple[float, float]:
        """Return the width of what is tracked of the front and its 1-sigma, m."""
        view = min(self._views, key=lambda v: v.range_m)
        update, rays = view.update, self.rig.as_taken(view.pair.motion).left.rays(
            view.update.quad_left_px)
        forward = update.axes[:, 0]
        corners = rays * ((update.position_m @ forward) / (rays @ forward))[:, None]
        width_m = float(np.ptp((corners - update.position_m) @ update.axes[:, 1]))
        if self._marked_std_px is None:
            return width_m, self.config.width_std_m
        # Two corners at either end, marked in the first pair.
        return width_m, self._marked_std_px * width_m / self._first_px

    def _height_m(self, width_m: float) -> Optional[float]:
        """Return the height above the road up to which something moves along, m."""
        views = sorted(self._views, key=lambda v: v.range_m)
        found: Optional[float] = None
        for k, view in enumerate(views[:-1]):
            others = [other for other in views[k + 1:] if self._apart(other, view)]
            if not others:
                continue
            seen, height_m = self._strips(view, others[0], width_m)
            # The highest strip that shows its upper edge reaches above it by half itself.
            below_m = self._search.half_height_m - self._search.step_m / 2
            found = float(height_m.max()) - below_m if len(height_m) else None
            if seen[-1].any():
                break
        return found

    def _strips(self, view: _View, other: _View, width_m: float
                ) -> tuple[NDArray[np.bool_], Array]:
        """
        Look for the strips that move along from one view to another.

        :return: (strips, depths) which of them are in all images; (n,) heights above the road of
            those that move along.
        """
        here, there = view.update, other.update
        rig, before = (self.rig.as_taken(v.pair.motion) for v in (view, other))
        up, strip = view.road_m + self._search.heights_m, self._search.strip
        on_front = np.zeros((len(up), len(strip), 3))
        on_front[..., 1] = strip[:, 0] * width_m
        on_front[..., 2] = up[:, None] + strip[:, 1]
        facing = here.position_m + on_front @ here.axes.T
        depth = 1 + np.array(self._search.behind_m) / abs(float(here.position_m @ here.axes[:, 0]))
        points = facing[:, None] * depth[:, None, None]  # (strips, depths, samples, 3)
        on_vehicle = (points - here.position_m) @ here.axes
        later = points + here.axes[:, 0] * here.speed_mps * view.pair.right_lag_s
        px = (rig.left.project(points), rig.right.project(rig.to_right(later)),
              before.left.project(there.position_m + on_vehicle @ there.axes.T))
        (left,), (right,) = _samples(view.pair.left, px[0][0]), _samples(view.pair.right, px[1][0])
        along, still = _samples(other.pair.left, px[2][0], px[0][0])
        seen = np.all([valid.all(axis=-1) for _, valid in px], axis=0)
        goes = np.where(seen, np.minimum(ncc(left, right), ncc(left, along)), -1.0)
        best = np.argmax(goes, axis=1)[:, None]
        goes, stays = (np.take_along_axis(v, best, axis=1)[:, 0] for v in (goes, ncc(left, still)))
        height_m = np.take_along_axis(on_vehicle[..., 2].mean(axis=-1), best, axis=1)[:, 0]
        moves = (goes > self.config.least_ncc) & (goes > stays + self.config.still_margin)
        moves &= np.array(self._search.behind_m)[best[:, 0]] <= self._search.own_m
        # Strips overlap by two thirds: what one alone shows, at the best of depths, is chance.
        moves &= np.convolve(moves, np.ones(3), 'same') > 1
        return seen, height_m[moves] - view.road_m

    def _apart(self, one: _View, other: _View) -> bool:
        """Return whether two views are of ranges that differ enough."""
        near, far = sorted((one.range_m, other.range_m))
        return far >= self._search.farther * near


def _samples(image: NDArray[Any], *uv_px: Array) -> list[Array]:
    """Return the grey values (..., G) at each of some pixels (..., G, 2); what is nowhere is 0."""
    grey, out = image.astype(np.float32), []
    for uv in uv_px:
        flat = np.nan_to_num(uv.reshape(-1, uv.shape[-2], 2), nan=-1e4).astype(np.float32)
        found = cv2.remap(grey, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR)
        out.append(np.asarray(found.reshape(uv.shape[:-1]), dtype=np.float64))
    return out
