# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What is left uncertain of the rig goes into every speed, or keeps it from being told."""
from __future__ import annotations

from dataclasses import replace
from functools import cached_property
import math
from typing import Mapping

import numpy as np

from .steadier import Steadier
from ..core.config import TrackerConfig
from ..core.passes import PassResult, Reason
from ..core.records import Array, TrackUpdate
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..road.scale import with_scale

_NONE = np.zeros(3)


class SpeedDoubt:
    """
    Adds to speeds what a right camera that has turned leaves uncertain, or withholds them.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: gives the share of speed that may be uncertain.
    """

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath], config: TrackerConfig
                 ) -> None:
        self.most_share = config.max_scale_std_share
        self.rig, self.lanes = rig, lanes

    @cached_property
    def _slopes(self) -> Mapping[str, Array]:
        """Return how speeds change with the angles, by lane; nobody asks unless one has turned."""
        return {name: _slopes(lane, self.rig) for name, lane in self.lanes.items()}

    def share(self, lane: str, steadier: Steadier, changed_rad: Array = _NONE) -> float:
        """
        Return the 1-sigma of a vehicle's speed on a lane by the turned camera, as a share.

        It is 0 where the camera stands as it stood, whose tolerance the lane holds already, and
        infinite where it has turned too far.  What a turn is found by takes some pairs: those
        before it was found may be of either side of it, so that it counts wholly.

        :param changed_rad: (3,) how far the correction has changed while the vehicle was seen.
        """
        drift = steadier.drift
        if drift.too_far:
            return math.inf
        if not (drift.turned or changed_rad.any()):
            return 0.0
        slopes = self._slopes[lane]
        known = slopes**2 @ np.diag(drift.covariance_rad2) if drift.turned else 0.0
        return math.hypot(math.sqrt(known), float(slopes @ changed_rad))

    def update(self, update: TrackUpdate, steadier: Steadier, changed_rad: Array = _NONE
               ) -> TrackUpdate:
        """Return what a track says, with this doubt; tentative where it is too great."""
        share = self.share(update.lane, steadier, changed_rad)
        if steadier.lost or share >= self.most_share:
            return update.unconfirmed()
        return update.doubted(share) if share else update

    def shares(self, steadier: Steadier, changed_rad: Array = _NONE) -> dict[str, float]:
        """Return :meth:`share` of every lane, as it is now."""
        return {lane: self.share(lane, steadier, changed_rad) for lane in self.lanes}

    def result(self, result: PassResult, share: float) -> PassResult:
        """
        Return the result of a pass, with this doubt; rejected where it is too great.

        :param share: of its lane, when it was over.
        """
        speed, budget = result.speed_mps, result.budget
        if speed is None or not share:
            return result
        whole = share if budget is None else math.hypot(share, budget.calibration_mps / speed)
        if whole >= self.most_share:
            return result.rejected(Reason.RIG_UNCERTAIN)
        return result.doubted(share, 'calibration_mps')


def _slopes(lane: LanePath, rig: StereoRig) -> Array:
    """Return the sizes (3,) of the change of a lane's speeds, as a share, per rad of an angle."""
    unknown = replace(lane, scale_std=math.inf)  # where no camera sees the path
    return np.array([with_scale(unknown, rig, np.diag(axis)).scale_std for axis in np.eye(3)])
