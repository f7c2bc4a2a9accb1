# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How wide and how high a vehicle is.

Its width is that of its tracked front.  Its height is that of the highest strip above the middle
of the front that moves along: of all depths behind the front there is one at which the strip
correlates with the other view and, carried along with the vehicle, with an earlier pair, better
than with what was in the same place of that pair.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional

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

_FARTHER = 1.12  # a view shows enough of a change beside another that is so many times as near
_MOST_VIEWS = 4  # that are kept of a pass
_STEP_M = 0.1  # from strip to strip
_STRIPS_M = np.arange(0.2, 4.6, _STEP_M)  # their heights above the road, as if on the front
_BEHIND_M = np.array([0, 0.25, 0.5, 0.8, 1.2, 1.6, 2, 2.5, 3, 4, 5, 6, 8])  # the front
_HALF_HEIGHT_M = 0.15  # of a strip
_WIDTH_SHARE = 0.8  # of a strip, of that of the front
_ACROSS, _DOWN = 20, 6  # samples of a strip
_STRIP = np.stack([x.ravel() for x in np.meshgrid(
    np.linspace(-0.5, 0.5, _ACROSS) * _WIDTH_SHARE,
    np.linspace(-_HALF_HEIGHT_M, _HALF_HEIGHT_M, _DOWN))], axis=1)  # shares of the width; m


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
    """

    def __init__(self, rig: StereoRig, lane: LanePath, config: ClassConfig,
                 marked_std_px: Optional[float] = None) -> None:
        self.rig, self.lane, self.config = rig, lane, config
        self._marked_std_px = marked_std_px
        self._views: list[_View] = []
        self._first_px = 0.0  # width of the front where the track began

    def take(self, pair: StereoPair, update: TrackUpdate) -> None:
        """Take in a pair that shows the vehicle, and where it is in it."""
        self._first_px = self._first_px or float(np.ptp(update.quad_left_px[:, 0]))
        road = self.lane.path.position(np.array(update.s_m)) - update.position_m
        view = _View(pair, update, float(road @ update.axes[:, 2]))
        if len(self._views) > 1 and not _apart(self._views[-1], self._views[-2]):
            self._views[-1] = view
        else:
            self._views.append(view)
        if len(self._views) > _MOST_VIEWS:
            self._views.remove(max(self._views, key=lambda v: v.range_m))

    def measured(self) -> Optional[VehicleKind]:
        """Return the size and class of the vehicle; None where no pair showed it."""
        if not self._views:
            return None
        width_m, std_m = self._width_m()
        return classified(width_m, std_m, self._height_m(width_m), self.config)

    def _width_m(self) -> tuple[float, float]:
        """Return the width of the front and its 1-sigma, m."""
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
            others = [other for other in views[k + 1:] if _apart(other, view)]
            if not others:
                continue
            seen, height_m = self._strips(view, others[0], width_m)
            # The highest strip that shows its upper edge reaches above it by half itself.
            found = float(height_m.max()) - _HALF_HEIGHT_M + _STEP_M / 2 \
                if len(height_m) else None
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
        up = view.road_m + _STRIPS_M
        on_front = np.zeros((len(up), len(_STRIP), 3))
        on_front[..., 1] = _STRIP[:, 0] * width_m
        on_front[..., 2] = up[:, None] + _STRIP[:, 1]
        facing = here.position_m + on_front @ here.axes.T
        depth = 1 + _BEHIND_M / abs(float(here.position_m @ here.axes[:, 0]))
        points = facing[:, None] * depth[:, None, None]  # (strips, depths, samples, 3)
        on_vehicle = (points - here.position_m) @ here.axes
        later = points + here.axes[:, 0] * here.speed_mps * view.pair.right_lag_s
        px = (rig.left.project(points), rig.right.project(rig.to_right(later)),
              before.left.project(there.position_m + on_vehicle @ there.axes.T))
        left, right, along, still = (_samples(image, uv) for image, uv in (
            (view.pair.left, px[0][0]), (view.pair.right, px[1][0]), (other.pair.left, px[2][0]),
            (other.pair.left, px[0][0])))
        seen = np.all([valid.all(axis=-1) for _, valid in px], axis=0)
        goes = np.where(seen, np.minimum(ncc(left, right), ncc(left, along)), -1.0)
        best = np.argmax(goes, axis=1)[:, None]
        goes, stays = (np.take_along_axis(v, best, axis=1)[:, 0] for v in (goes, ncc(left, still)))
        height_m = np.take_along_axis(on_vehicle[..., 2].mean(axis=-1), best, axis=1)[:, 0]
        moves = (goes > self.config.least_ncc) & (goes > stays + self.config.still_margin)
        return seen, height_m[moves] - view.road_m


def _apart(one: _View, other: _View) -> bool:
    """Return whether two views are of ranges that differ enough."""
    near, far = sorted((one.range_m, other.range_m))
    return far >= _FARTHER * near


def _samples(image: NDArray[Any], uv_px: Array) -> Array:
    """Return the grey values (..., G) at pixels (..., G, 2); what is nowhere is 0."""
    flat = np.nan_to_num(uv_px.reshape(-1, uv_px.shape[-2], 2), nan=-1e4).astype(np.float32)
    grey = cv2.remap(image.astype(np.float32), flat[..., 0], flat[..., 1], cv2.INTER_LINEAR)
    return np.asarray(grey.reshape(uv_px.shape[:-1]), dtype=np.float64)
