# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How wide a front is, in a pair that shows it near and whole.

A track keeps to what was seen of its front where it began: where a pole or another vehicle hid the
rest of it, that is a part.  Later pairs show all of it.  So the front is looked for in them as a
detector does it, about the place that the track tells, and its width is that of what is mirrored.
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

_BESIDE_M = 3.1  # half a lorry beyond the axis of one of which the track holds an edge
_COLUMNS = 32  # of it, for what is far outside of an image bounds no region of it
_AHEAD_M = 1.0  # by which the place of a front may change as it is looked for
_SAME_S_M = 0.5  # what stands further off along the lane is not the front of that vehicle


class FrontWidth:
    """
    Measures the width of a tracked front anew.

    It looks for what a front usually is, whatever found the vehicle and with whatever parameters.

    :param rig: the cameras.
    :param lane: the lane whose path the places of the front are told by.
    """

    def __init__(self, rig: StereoRig, lane: LanePath) -> None:
        self._rig, self._lane = rig, lane

    @cached_property
    def _refiners(self) -> list[FrontRefiner]:
        """Return what finds fronts, for each height at which they show most."""
        config = DetectorConfig()
        front, geometry = config.front, LaneGeometry(self._rig, self._lane)
        return [FrontRefiner(geometry, FrontKind(low_m, high_m, front.least_width_m), front,
                             config.motion, config.least_symmetry)
                for low_m, high_m in _heights(front)]

    def widths_m(self, pair: StereoPair, update: TrackUpdate) -> list[float]:
        """
        Return the widths of the fronts that are seen where a track is, one for each height.

        :param pair: that shows the vehicle.
        :param update: where it is in it.
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
        """Return what of the images is looked at."""
        rig, geometry = self._rig, self._refiners[0].sampler.geometry
        points = geometry.points(
            update.s_m + np.array([-_AHEAD_M, 0.0, _AHEAD_M, ahead_m + _AHEAD_M]),
            update.lateral_m + np.linspace(-_BESIDE_M, _BESIDE_M, _COLUMNS),
            np.array([0.0, max(high_m for _, high_m in _heights(FrontConfig()))]))
        left, right = rig.project(points)[:2]
        return PairRegions(*(region_of([view.astype(np.float32)], (
            camera.width_px, camera.height_px)) for view, camera in (
                (left, rig.left), (right, rig.right))))


def _heights(front: FrontConfig) -> list[tuple[float, float]]:
    """Return the lower and upper edges of what is looked at of fronts."""
    return [(front.low_m, front.high_m), (front.raised_low_m, front.raised_high_m),
            (front.tall_low_m, front.tall_high_m)]
