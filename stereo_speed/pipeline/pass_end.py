# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Concludes a pass: its result, with the uncertainty of its times and of the rig added."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Mapping, Optional

import numpy as np

from .track import Track
from ..classification.classes import is_no_vehicle
from ..core.passes import Direction, PassResult, Reason, Verdict
from ..core.tracker_config import TrackerConfig
from ..road.lanes import LanePath
from ..second.estimate import with_second
from ..steadying.doubt import SpeedDoubt


@dataclass(frozen=True, eq=False)
class PassEnd:
    """
    Measures a pass that is over; holds all it needs, as it may run in another process.

    :param track: the track that has ended.
    :param lanes: lane name to lane path.
    :param config: parameters that all trackers share.
    :param doubt: uncertainty due to the rig.
    :param lag_share: 1-sigma of the speed due to the view lag, as a share of it.
    :param rig_shares: lane name to 1-sigma of the speed due to a turned camera, as a share of it.
    :param reason: why the pass is rejected in any case; None to let the measurement decide.
    """

    track: Track
    lanes: Mapping[str, LanePath]
    config: TrackerConfig
    doubt: SpeedDoubt
    lag_share: float
    rig_shares: Mapping[str, float]
    reason: Optional[Reason]

    def __call__(self) -> PassResult:
        """Return the result of the pass."""
        track = self.track
        result = replace(
            track.lanes.conclude(track.tracker.result()), vehicle=track.size.measured(),
            trace=track.trace.built(track.stamp_std_s))
        if result.lane in self.lanes:
            result = replace(result, direction=_direction(self.lanes[result.lane]))
        result = self._timed(result)
        if track.second is not None:
            result = with_second(result, track.second, self.config.second)
        no_vehicle = self._no_vehicle(result)
        if no_vehicle is not None and result.verdict is not Verdict.REJECTED:
            result = result.rejected(no_vehicle)
        if self.reason is not None:
            result = result.rejected(self.reason)
        return self.doubt.result(result, self.rig_shares.get(result.lane, 0.0))

    def _no_vehicle(self, result: PassResult) -> Optional[Reason]:
        """Return why a detected front is no vehicle; None if it is one or was annotated."""
        if self.track.lies:
            return Reason.VIEWS_DISAGREE
        if self.track.detection is None or result.vehicle is None:
            return None
        return Reason.IMPLAUSIBLE if is_no_vehicle(
            result.vehicle, self.config.classes) else None

    def _timed(self, result: PassResult) -> PassResult:
        """Return the result with the uncertainty of its stamps; rejected if that is too large."""
        if (self.track.clock_stepped or self.track.unaware) and result.speed_mps is not None:
            return result.rejected(Reason.STAMPS_UNCERTAIN)
        if not self.lag_share:
            return result
        result, limits = result.doubted(self.lag_share, 'stamps_mps'), self.config
        if result.speed_mps is None or result.speed_std_mps is None:
            return result
        most_mps = max(limits.max_speed_std_share * result.speed_mps, limits.max_speed_std_mps)
        return result if result.speed_std_mps < most_mps else result.rejected(
            Reason.STAMPS_UNCERTAIN)


def _direction(lane: LanePath) -> Direction:
    """Return whether a lane leads towards the left camera or away from it."""
    ends = lane.path.position(np.array([0.0, lane.path.length_m]))
    start_m, end_m = np.linalg.norm(ends, axis=-1)
    return Direction.APPROACHING if end_m < start_m else Direction.RECEDING
