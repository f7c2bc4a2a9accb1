# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Handles the updates of trackers: which are doubted, which are readings, in which lane."""
from __future__ import annotations

import math
from typing import Optional

from .hiding import is_hidden
from .roster import Roster
from .track import holds, is_sure, Track
from ..core.records import StereoPair, TrackState, TrackUpdate
from ..core.tracker_config import TrackerConfig
from ..detection.protocol import Detection
from ..geometry.rig import StereoRig


class Intake:
    """
    Feeds tracks, and handles the updates of their trackers.

    Tracks that are being started are fed in the thread beside the pairs.

    :param rig: the cameras.
    :param config: parameters that all trackers share.
    :param roster: the tracks, whose vehicles may hide one another.
    """

    def __init__(self, rig: StereoRig, config: TrackerConfig, roster: Roster) -> None:
        self.rig, self.config, self.roster = rig, config, roster

    def feed(self, track: Track, pair: StereoPair,
             particles: Optional[int] = None) -> Optional[TrackUpdate]:
        """
        Feed a pair to a track, and assign its vehicle to a lane.

        :param particles: number of particles that its tracker was told to use; None if not told.
        """
        return self.take(track, pair, particles, track.feed(pair))

    def take(self, track: Track, pair: StereoPair, particles: Optional[int],
             update: Optional[TrackUpdate]) -> Optional[TrackUpdate]:
        """
        Register a track's update for a pair; return it with the lane.

        :param particles: as for :meth:`feed`.
        :param update: from its tracker; None if it has none for the pair.
        """
        hurried = track.hurried
        if update is None:
            track.trace.add(pair, particles, None, hurried=hurried, stamp_std_s=track.stamp_std_s)
            return None
        track.hidden = not holds(update) or (
            track.hidden and not self._moves(self._as_sure(update)))
        track.doubted = track.lies or track.size.may_be_edge or self._is_doubtful(track, update)
        if track.doubted or self._is_behind_another(update, pair):
            update = update.unconfirmed()
        track.confirmed |= update.state is TrackState.CONFIRMED
        update = track.lanes.place(self._as_sure(update))
        if track.last is None or update.stamp_ns >= track.last.stamp_ns or not holds(update):
            track.last = update
        track.trace.add(pair, particles, update, hurried=hurried, stamp_std_s=track.stamp_std_s)
        return update

    def expect(self, track: Track, pair: StereoPair, update: TrackUpdate) -> TrackUpdate:
        """Register a predicted update until the track is fed the pair; return it with the lane."""
        if track.doubted or not track.confirmed or self._is_behind_another(update, pair):
            update = update.unconfirmed()
        track.last = track.lanes.carried(self._as_sure(update))
        return track.last

    def same_speed(self, update: TrackUpdate, front: Detection, change_mps: float = 0.0) -> bool:
        """
        Return whether the independent speeds of track and detector agree.

        :param change_mps: how much the speed may have changed since the detection.
        """
        if front.speed_mps is None:
            return True
        std = math.hypot(update.speed_std_mps, front.speed_std_mps)
        limit = self.config.association.same_speed_sigmas * std + change_mps
        return abs(update.speed_mps - front.speed_mps) < limit

    def _is_behind_another(self, update: TrackUpdate, pair: StereoPair) -> bool:
        """Return whether another track's vehicle is in the way of a front that could be read."""
        return update.state is TrackState.CONFIRMED and is_hidden(
            update, tuple(self.roster.tracks), self.rig.as_taken(pair.motion),
            self.config.association.same_vehicle_m)

    def _as_sure(self, update: TrackUpdate) -> TrackUpdate:
        """Return an update, tentative where its speed is too uncertain for a reading."""
        return update if is_sure(update, self.config.visibility) else update.unconfirmed()

    def _moves(self, update: TrackUpdate) -> bool:
        """Return whether an update shows that the vehicle moves."""
        least_mps = self.config.association.moving_sigmas * update.speed_std_mps
        return update.state is TrackState.CONFIRMED and update.speed_mps >= least_mps

    def _is_doubtful(self, track: Track, update: TrackUpdate) -> bool:
        """
        Return whether a track does not move, or a young one contradicts its detector's speed.

        As time passes the vehicle may have changed its speed, but by no more than braking allows.
        What seemed to move beside a vehicle may be road that the vehicle has uncovered, and what
        is found where a hidden vehicle was expected may be the road as well.
        """
        if track.detection is None or update.state is not TrackState.CONFIRMED:
            return False
        if track.confirmed:
            return track.hidden
        if not self._moves(update):
            return True
        limits, age_s = self.config.association, (update.stamp_ns - track.found_ns) * 1e-9
        change_mps = 0.0 if age_s < limits.doubt_s else limits.braking_mps2 * age_s
        return not self.same_speed(update, track.detection, change_mps)
