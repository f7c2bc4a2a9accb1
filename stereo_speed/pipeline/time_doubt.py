# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of a track's readings from stamps that are uneven, odd or apart in both views."""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Optional

from .track import is_sure, Track
from ..core.records import TrackUpdate
from ..core.stamp_watch import StampWatch
from ..core.tracker_config import TrackerConfig
from ..steadying.view_lag import ViewLag

_ARRIVAL_S = 0.01  # stamps set on arrival are off by a few ms; more means irregular exposures
_ODD_SIGMAS = 3.0  # an interval further off its pace is odd for the assumed stamp 1-sigma


@dataclass(frozen=True, eq=False)
class TimeDoubt:
    """
    The uncertainty of the times of a stream.

    :param config: parameters that all trackers share.
    :param stamps: watches how even its stamps are.
    :param lag: estimates the time between its views.
    """

    config: TrackerConfig
    stamps: StampWatch
    lag: ViewLag

    def uneven_s(self) -> Optional[float]:
        """Return the 1-sigma to assume for uneven stamps, s; None where they are even."""
        config = self.config
        uneven_s = self.stamps.unevenness_s(config.uneven_stamp_sigmas * config.stamp_std_s)
        return None if uneven_s is None else min(uneven_s, max(_ARRIVAL_S, config.stamp_std_s))

    def widened(self, update: TrackUpdate, track: Track) -> TrackUpdate:
        """
        Return a track's update with the uncertainty of its times in its 1-sigma.

        It is no reading after a step of the clock, nor where the tracker cannot be told that its
        stamps are uneven.
        """
        if track.clock_stepped or track.unaware:
            return update.unconfirmed()
        share = self._odd_share(track)
        if self.lag.concerned:
            share = math.hypot(share, self.lag_share(track, update))
        if not share:
            return update
        update = update.doubted(share)
        return update if is_sure(update, self.config.visibility) else update.unconfirmed()

    def lag_share(self, track: Track, update: TrackUpdate) -> float:
        """Return the 1-sigma of a track's speed due to the view lag, as a share of the speed."""
        return self.lag.share(update, self.lag.changes_s - track.lag_changes_s)

    def _odd_share(self, track: Track) -> float:
        """Return the 1-sigma, as a share of the speed, due to odd stamps not yet told to it."""
        config = self.config
        known_s = track.stamp_std_s or config.stamp_std_s
        if known_s >= _ARRIVAL_S:  # the track already allows for the largest error assumed
            return 0.0
        odd_s = math.sqrt(2.0) * max(_ODD_SIGMAS, config.uneven_stamp_sigmas) * known_s
        return self.stamps.odd_share(odd_s, _ARRIVAL_S, config.effort.solve_interval_s)
