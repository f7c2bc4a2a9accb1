# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Assigns vehicles to lanes: each reading to one, each pass to its first and last."""
from __future__ import annotations

from dataclasses import replace
from typing import Mapping

import numpy as np

from ..core.passes import PassResult, Reason, Verdict
from ..core.records import TrackUpdate
from ..core.tracker_config import VerdictConfig
from ..road.lanes import LanePath


class LaneAssigner:
    """
    Follows one track through the lanes of a site.

    :param lanes: lane name to lane path.
    :param limits: parameters; here, when a track changes lanes or is off the road.
    """

    def __init__(self, lanes: Mapping[str, LanePath], limits: VerdictConfig) -> None:
        self.lanes, self.limits = lanes, limits
        self.first = self.current = ''
        self.pairs = self.off_road = 0

    def place(self, update: TrackUpdate) -> TrackUpdate:
        """Return an update with the lane of the vehicle, and its place along that lane's path."""
        places = {name: _place(lane, update) for name, lane in self.lanes.items()}
        nearest = min(places, key=lambda name: abs(places[name][1]))
        self.current = self.current or update.lane
        gain = abs(places[self.current][1]) - abs(places[nearest][1])
        if gain > self.limits.lane_hysteresis_m:
            self.current = nearest
        self.first = self.first or self.current
        self.pairs += 1
        self.off_road += abs(places[nearest][1]) > self.limits.off_road_m
        if self.current == update.lane:
            return update
        s_m, lateral_m = places[self.current]
        return replace(update, lane=self.current, s_m=s_m, lateral_m=lateral_m)

    def carried(self, update: TrackUpdate) -> TrackUpdate:
        """Return a predicted update with the vehicle's present lane, and its place along it."""
        if self.current in ('', update.lane):
            return update
        s_m, lateral_m = _place(self.lanes[self.current], update)
        return replace(update, lane=self.current, s_m=s_m, lateral_m=lateral_m)

    def conclude(self, result: PassResult) -> PassResult:
        """Return a pass with its first and last lane; rejected if it was off the road."""
        result = replace(result, lane=self.first or result.lane,
                         lane_to=self.current or result.lane)
        most_off = self.limits.off_road_share * self.pairs
        if result.verdict is Verdict.MEASURED and self.off_road > most_off:
            return result.rejected(Reason.OFF_PATH)
        return result


def _place(lane: LanePath, update: TrackUpdate) -> tuple[float, float]:
    """Return the arc length along a lane's path and the offset to its left, m."""
    s_m = float(lane.path.arc_length(update.position_m))
    at = np.array(s_m)
    left = lane.path.frame(at)[:, 1]
    return s_m, float((update.position_m - lane.path.position(at)) @ left)
