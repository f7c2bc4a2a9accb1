# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What is uncertain of a stream: its stamps, the time between its views, rig and focus.

The tracks are told what changes of it.  What they cannot be told widens their readings, and their
passes when these are over.
"""
from __future__ import annotations

from typing import Iterable, Mapping, Optional, Sequence

from .pass_end import PassEnd
from .roster import Roster
from .time_doubt import TimeDoubt
from .track import Track, with_unnoticed
from ..core.passes import Reason
from ..core.records import StereoPair, TrackState, TrackUpdate
from ..core.stamp_watch import Gap, StampWatch
from ..core.tracker_config import TrackerConfig
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..steadying.doubt import SpeedDoubt
from ..steadying.steadier import Steadier
from ..steadying.view_focus import ViewFocus
from ..steadying.view_lag import ViewLag

# Ratio to the stamp 1-sigma a track assumes at which it is told a larger one; twenty intervals
# estimate it to within a fifth.
_WORSE = 1.5


class StreamDoubt:
    """
    See the module's docstring.

    ``stamps`` watches the stamps, ``lag`` estimates the time between the views, ``steadier`` how
    the rig has rotated, and ``focus`` which view is more blurred.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters that all trackers share.
    :param roster: the tracks.
    :param steadier: estimates how the rig has rotated in each pair; None for a rigid mount.
    """

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath], config: TrackerConfig,
                 roster: Roster, steadier: Optional[Steadier]) -> None:
        self.lanes, self.config, self.steadier = lanes, config, steadier
        self.stamps, self.lag, self.focus = StampWatch(), ViewLag(rig), ViewFocus()
        self._roster, self._rig_doubt = roster, SpeedDoubt(rig, lanes, config)

    def go_on_from(self, other: StreamDoubt) -> None:
        """Take over what another pipeline knows of the stream."""
        self.steadier, self.stamps, self.focus = other.steadier, other.stamps, other.focus

    def restart(self) -> None:
        """Discard what does not outlast a jump back in time."""
        self.stamps.restart()
        self.focus.restart()
        if self.steadier is not None:
            self.steadier.reset()

    def known(self, pair: StereoPair) -> StereoPair:
        """Return a pair with what is known of the motion of its rig, and of its focus."""
        return self.focus.seen(pair if self.steadier is None else self.steadier.steady(pair))

    def rest_std_rad(self, lane: LanePath) -> Optional[tuple[float, float]]:
        """
        Return the 1-sigmas of a lane's direction, across and up, by how the rig sways, rad.

        :return: None where the rig does not sway, or the lines of the site tell its rest.
        """
        if self.steadier is None:
            return None
        covariance_rad2 = self.steadier.standing_covariance_rad2
        if not covariance_rad2.any():
            return None
        across, up = lane.heading_std_by(covariance_rad2)
        return float(across), float(up)

    # -- what tracks are told -------------------------------------------------------------

    def see_stamps(self) -> Optional[float]:
        """Tell the tracks how uneven the stamps are; return the 1-sigma, s, None if even."""
        uneven_s = self._times.uneven_s()
        for track in self._roster.tracks:
            if uneven_s is not None and uneven_s > _WORSE * (
                    track.stamp_std_s or self.config.stamp_std_s):
                track.see_stamps(uneven_s)
        return uneven_s

    def clock_step(self, gaps: Sequence[Gap]) -> Optional[Gap]:
        """
        Return a gap in which a track shows that the clock was set forward; None if there is none.

        A step forward by whole periods shows only in where vehicles are after it.

        :param gaps: the latest gaps of the stream.
        """
        steps = (track.clock_step for track in self._roster.tracks)
        return next((step for step in steps if step in gaps), None)

    def see_gaps(self, gaps: Sequence[Gap]) -> None:
        """Tell the tracks the latest gaps of the stream, if there are any."""
        if gaps:
            for track in self._roster.tracks:
                track.see_gaps(gaps)

    def see_drift(self) -> None:
        """Tell the tracks the estimated rotation of the right camera."""
        if self.steadier is not None:
            for track in self._roster.tracks:
                track.see_drift(self.steadier.drift.corrected_rad)

    # -- what is added to readings and passes ---------------------------------------------

    def widened(self, updates: Iterable[Optional[TrackUpdate]]) -> list[TrackUpdate]:
        """Return the updates of existing tracks, with the uncertainty of times and rig added."""
        tracks = {track.tracker.track: track for track in self._roster.tracks}
        times, steadier = self._times, self.steadier
        widened = [times.widened(u, tracks[u.track])
                   for u in updates if u is not None and u.track in tracks]
        if steadier is not None:
            widened = [
                u.unconfirmed() if self._is_unsettled(tracks[u.track]) else
                self._rig_doubt.update(u, steadier, tracks[u.track].drift_change_rad)
                for u in widened]
        return [with_unnoticed(u, self.config.visibility) for u in widened]

    def readings(self, updates: Iterable[Optional[TrackUpdate]]) -> list[TrackUpdate]:
        """Return the updates that are readings, of tracks that have not ended."""
        going_on = {t.tracker.track for t in self._roster.tracks if not t.ended}
        return [u for u in self.widened(updates)
                if u.state is TrackState.CONFIRMED and u.track in going_on]

    def pass_end(self, track: Track, reason: Optional[Reason]) -> PassEnd:
        """
        Return what measures the pass of an ended track, which is told the latest gaps.

        :param reason: why the pass is rejected in any case; None to let the measurement decide.
        """
        lag_share = 0.0 if track.last is None else self._times.lag_share(track, track.last)
        rig_shares = {} if self.steadier is None else self._rig_doubt.shares(
            self.steadier, track.drift_change_rad)
        if reason is None and self._is_unsettled(track):
            reason = Reason.RIG_UNCERTAIN
        track.see_gaps(tuple(self.stamps.gaps))  # it may have started in the newest pair
        return PassEnd(
            track, self.lanes, self.config, self._rig_doubt, lag_share, rig_shares, reason)

    def _is_unsettled(self, track: Track) -> bool:
        """Return whether the rest of a swaying rig was not known in one of a track's pairs."""
        until_ns = None if self.steadier is None else self.steadier.unsettled_ns
        return until_ns is not None and track.first_ns <= until_ns

    @property
    def _times(self) -> TimeDoubt:
        """Return the uncertainty of the stream's times as known now."""
        return TimeDoubt(self.config, self.stamps, self.lag)
