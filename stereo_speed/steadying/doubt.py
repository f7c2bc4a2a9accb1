# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Adds the remaining uncertainty of the rig to speeds, or withholds them."""
from __future__ import annotations

from functools import cached_property
import math
from typing import Mapping

import numpy as np

from .steadier import Steadier
from ..core.passes import PassResult, Reason
from ..core.records import Array, TrackUpdate
from ..core.tracker_config import TrackerConfig
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..road.scale import pass_scale_by_drift

_NONE = np.zeros(3)


class SpeedDoubt:
    """
    Adds the uncertainty of a turned right camera to speeds, or withholds them.

    :param rig: the rig.
    :param lanes: maps lane names to lane paths.
    :param config: gives the largest relative 1-sigma of the scale.
    """

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath], config: TrackerConfig
                 ) -> None:
        self.most_share = config.max_scale_std_share
        self.rig, self.lanes = rig, lanes

    @cached_property
    def _slopes(self) -> Mapping[str, Array]:
        """Return the change of speeds with the angles, by lane; computed only when needed."""
        return {name: pass_scale_by_drift(lane.path, self.rig)
                for name, lane in self.lanes.items()}

    def share(self, lane: str, steadier: Steadier, changed_rad: Array = _NONE) -> float:
        """
        Return the relative 1-sigma of a vehicle's speed on a lane by the turned camera.

        It is 0 if the camera has not turned, as the lane includes the tolerance of that state, and
        infinite if it has turned too far or if the cameras do not see the lane.  A turn is found
        only after some pairs, and it is not known which earlier pairs came before it.  The whole
        change therefore counts as uncertain.

        :param changed_rad: (3,) largest change of each angle of the correction, in either
            direction, while the vehicle was in view, rad.
        """
        drift = steadier.drift
        if drift.too_far:
            return math.inf
        if not (drift.turned or changed_rad.any()):
            return 0.0
        slope = self._slopes[lane]
        if not np.isfinite(slope).all():
            return math.inf
        variance = float(slope @ drift.covariance_rad2 @ slope) if drift.turned else 0.0
        # The changes are magnitudes, each from any pair, so their signs are unknown and the
        # largest possible sum counts.
        return math.hypot(math.sqrt(variance), float(np.abs(slope) @ np.abs(changed_rad)))

    def update(self, update: TrackUpdate, steadier: Steadier, changed_rad: Array = _NONE
               ) -> TrackUpdate:
        """Return an update with this uncertainty added; tentative if it is too large."""
        share = self.share(update.lane, steadier, changed_rad)
        if steadier.lost or share >= self.most_share:
            return update.unconfirmed()
        return update.doubted(share) if share else update

    def shares(self, steadier: Steadier, changed_rad: Array = _NONE) -> dict[str, float]:
        """Return :meth:`share` of every lane, for the current state."""
        return {lane: self.share(lane, steadier, changed_rad) for lane in self.lanes}

    def result(self, result: PassResult, share: float) -> PassResult:
        """
        Return the result of a pass with this uncertainty added; rejected if it is too large.

        The views of a camera that has turned during the pass may disagree; the turn is the cause
        then.

        :param share: :meth:`share` of its lane when the pass ended.
        """
        speed, budget = result.speed_mps, result.budget
        if result.reason == Reason.VIEWS_DISAGREE and share >= self.most_share:
            return result.rejected(Reason.RIG_UNCERTAIN)
        if speed is None or not share:
            return result
        whole = share if budget is None else math.hypot(share, budget.calibration_mps / speed)
        if whole >= self.most_share:
            return result.rejected(Reason.RIG_UNCERTAIN)
        return result.doubted(share, 'calibration_mps')
