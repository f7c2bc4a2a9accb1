# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What stamps that are uneven, odd or apart leave in doubt of the readings of a track."""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Optional

from .track import is_sure, Track
from ..core.config import TrackerConfig
from ..core.records import TrackUpdate
from ..core.stamp_watch import StampWatch
from ..steadying.view_lag import ViewLag

_ARRIVAL_S = 0.01  # stamps made at arrival are off by some ms; more is exposures at any time
_ODD_SIGMAS = 3.0  # of an interval that says more of stamps than is known of them


@dataclass(frozen=True, eq=False)
class TimeDoubt:
    """
    The doubt of the times of a stream.

    :param config: parameters that all trackers share.
    :param stamps: how even its stamps are.
    :param lag: the time between its views.
    """

    config: TrackerConfig
    stamps: StampWatch
    lag: ViewLag

    def uneven_s(self) -> Optional[float]:
        """Return the 1-sigma that uneven stamps are taken to have, s; None where they are even."""
        config = self.config
        uneven_s = self.stamps.unevenness_s(config.uneven_stamp_sigmas * config.stamp_std_s)
        return None if uneven_s is None else min(uneven_s, max(_ARRIVAL_S, config.stamp_std_s))

    def told(self, update: TrackUpdate, track: Track) -> TrackUpdate:
        """
        Return what a track says with the doubt of its times in its 1-sigma.

        After a step of the clock there is no telling, nor where a tracker takes no notice that
        its stamps are uneven.
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
        """Return the 1-sigma of a track's speed by the time between the views, as a share."""
        return self.lag.share(update, self.lag.changes_s - track.lag_changes_s)

    def _odd_share(self, track: Track) -> float:
        """Return the 1-sigma of a track's speed, as a share, by stamps it does not doubt yet."""
        config = self.config
        known_s = track.stamp_std_s or config.stamp_std_s
        if known_s >= _ARRIVAL_S:  # whatever there is, or exposures at any time
            return 0.0
        odd_s = math.sqrt(2.0) * max(_ODD_SIGMAS, config.uneven_stamp_sigmas) * known_s
        return self.stamps.odd_share(odd_s, _ARRIVAL_S, config.effort.solve_interval_s)
