# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Measures the width of a front in a pair that shows it near and whole.

A track follows the part of a front that was visible when it began, where a pole or another vehicle
may have hidden the rest.  Later pairs show the whole front.  So it is searched for in them as a
detector does, around the place of the track, and its width is that of its symmetric part.
"""
from __future__ import annotations

from functools import cached_property

import numpy as np

from .config import DetectorConfig, FrontConfig
from .front_refiner import FrontKind, FrontRefiner
from .front_search import FIRST_NOISE
from .lane_geometry import LaneGeometry
from .plane_sweep import Proposal
from .pyramid import PairPyramids, PairRegions, region_of
from .temporal_match import Interval
from ..core.records import StereoPair, TrackUpdate
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_BESIDE_M = 3.1  # reach across, as a track may hold one edge of a lorry
_COLUMNS = 32  # points across that bound the region, as points far outside the image are ignored
_AHEAD_M = 1.0  # reach along the lane of the refinement of a front
# Greatest distance along the lane of a front of the same vehicle.  A track that holds one side of
# a front may be half a metre off, and no two vehicles in one lane are this close.
_SAME_S_M = 1.0


class FrontWidth:
    """
    Measures the width of a tracked front independently of its track.

    It uses the default parameters of the plane-sweep detector, whichever detector found the
    vehicle.

    :param rig: the cameras.
    :param lane: the lane along whose path the places of the front are given.
    """

    def __init__(self, rig: StereoRig, lane: LanePath) -> None:
        self._rig, self._lane = rig, lane

    @cached_property
    def _refiners(self) -> list[FrontRefiner]:
        """Return a refiner for each height at which fronts are searched for."""
        config = DetectorConfig()
        front, geometry = config.front, LaneGeometry(self._rig, self._lane)
        return [FrontRefiner(geometry, FrontKind(low_m, high_m, front.least_width_m), front,
                             config.motion, config.least_symmetry)
                for low_m, high_m in _heights(front)]

    def widths_m(self, pair: StereoPair, update: TrackUpdate) -> list[float]:
        """
        Return the widths of the fronts found at the place of a track, at most one per height, m.

        :param pair: a pair that shows the vehicle.
        :param update: update of the track for that pair.
        """
        ahead_m = pair.right_lag_s * update.speed_mps
        now = PairPyramids.of(pair, self._regions(update, ahead_m), self._rig)
        start = Proposal(update.s_m, update.lateral_m, ahead_m=ahead_m)
        return [2 * front.half_m for refiner in self._refiners
                for front in refiner.refine([start], Interval(now, now), FIRST_NOISE,
                                            speed_known=True)
                if abs(front.s_m - update.s_m) < _SAME_S_M
                and abs(front.x_m - update.lateral_m) < front.half_m
                and front.cross_ncc >= refiner.front.least_cross_ncc
                and front.symmetry >= (refiner.least_symmetry or 0.0)]

    def _regions(self, update: TrackUpdate, ahead_m: float) -> PairRegions:
        """Return the regions of the images that are used."""
        rig, geometry = self._rig, self._refiners[0].sampler.geometry
        points = geometry.points(
            update.s_m + np.array([-_AHEAD_M, 0.0, _AHEAD_M, ahead_m - _AHEAD_M,
                                   ahead_m + _AHEAD_M]),
            update.lateral_m + np.linspace(-_BESIDE_M, _BESIDE_M, _COLUMNS),
            np.array([0.0, max(high_m for _, high_m in _heights(FrontConfig()))]))
        left, right = rig.project(points)[:2]
        return PairRegions(*(region_of([view.astype(np.float32)], (
            camera.width_px, camera.height_px)) for view, camera in (
                (left, rig.left), (right, rig.right))))


def _heights(front: FrontConfig) -> list[tuple[float, float]]:
    """Return the heights of the lower and the upper edge of each kind of window, m."""
    return [(front.low_m, front.high_m), (front.raised_low_m, front.raised_high_m),
            (front.tall_low_m, front.tall_high_m)]
