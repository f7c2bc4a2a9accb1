# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Starts one track for each vehicle that is detected or annotated."""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Callable, Mapping, Optional, Sequence, Union

import numpy as np

from .intake import Intake
from .roster import Begun, Roster
from .search import Search
from .track import holds, may_be_at, start_of, Track, with_stamps
from .turns import share_of
from ..classification.size import VehicleSize
from ..core.records import Array, InitialFront, RigMotion, StereoPair
from ..core.trace import PassTrace, TraceBuilder
from ..core.tracker_config import TrackerConfig
from ..detection.front_width import FrontWidth
from ..detection.protocol import Detection
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..second.estimate import SecondOpinion
from ..steadying.view_lag import ViewLag
from ..tracking.lane_assigner import LaneAssigner
from ..tracking.marked_front import measured_part
from ..tracking.protocol import Refusal, Tracker, TrackStart
from ..tracking.upright import Upright

StartTracker = Callable[[TrackStart], Union[Tracker, Refusal]]


@dataclass(eq=False)
class Starter:
    """
    Starts tracks, which share the budget of particles with those of the roster.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters that all trackers share.
    :param start_tracker: starts a tracker.
    :param seed: seed of all randomness.
    :param intake: feeds tracks their first pairs.
    :param roster: the tracks; the caller adds new ones to it.
    :param view_lag: the time between the views.
    :param rest_std_rad: returns the 1-sigmas of a lane's direction, across and up, by how
        the rig sways, rad; None where it does not.
    :param next_track: number of the next track.
    :param stamp_std_s: 1-sigma assumed for uneven stamps, s; None where they are even.
    """

    rig: StereoRig
    lanes: Mapping[str, LanePath]
    config: TrackerConfig
    start_tracker: StartTracker
    seed: int
    intake: Intake
    roster: Roster
    view_lag: ViewLag
    rest_std_rad: Callable[[LanePath], Optional[tuple[float, float]]]
    next_track: int = 0
    stamp_std_s: Optional[float] = None

    def at_mark(self, front: InitialFront, pair: StereoPair) -> Track:
        """
        Return a track at a front that a person annotated in a pair.

        Of a lorry or bus only the part below its windscreen is measured, or all of it where the
        views do not agree on that part.

        :raises InputError: the views do not agree on a front there.
        """
        lane = self._lane_of(front, pair)
        part = measured_part(TrackStart(
            rig=self.rig, lane=lane, config=self.config, front=front, pair=pair,
            track=self.next_track, rng=np.random.default_rng(self.seed)))
        track = self._start(part, pair, lane, None, pair)
        if isinstance(track, Refusal) and part is not front:
            track = self._start(front, pair, lane, None, pair)
        if isinstance(track, Refusal):
            raise track.error()
        return track

    def new(self, search: Search, fronts: Sequence[Detection]) -> list[Detection]:
        """
        Return the fronts found in a pair at which new tracks are to start.

        Where a doubted track is, none starts; that track goes on, and if its speed agrees with the
        new detection, it is compared with that from now on.
        """
        new = []
        for front in fronts:
            doubted = self._doubted_at(front, search)
            if doubted is None:
                new.append(front)
            elif doubted.last is not None and self.intake.same_speed(doubted.last, front):
                doubted.detection, doubted.found_ns = front, search.pair.stamp_ns
        return new

    def at(self, front: Detection, pair: StereoPair) -> Optional[Begun]:
        """
        Start a track in the earliest pair that shows a front or, if that fails, in the newest.

        :param pair: the pair that the front was found in.
        :return: the track and its update for that pair; None where no front can be followed.
        """
        starts: list[tuple[tuple[StereoPair, ...], Array, Array]] = [
            ((pair,), front.left_px, front.right_px)]
        if front.earlier is not None:
            seen = front.earlier.pairs
            some = seen[::math.ceil(len(seen) / self.config.association.catch_up_pairs)]
            starts.insert(0, ((*some, pair), front.earlier.left_px, front.earlier.right_px))
        for pairs, left_px, right_px in starts:
            first = InitialFront(pairs[0].index, left_px, right_px, front.std_px)
            track = self._start(first, pairs[0], self.lanes[front.lane], front, pair)
            if isinstance(track, Refusal):
                continue
            updates = [self.intake.feed(track, one) for one in pairs]
            newest = updates[-1]
            if newest is not None and all(map(holds, updates)) and (
                    len(pairs) == 1 or self.intake.same_speed(newest, front)):
                return track, newest
        return None

    def restarted(self, track: Track) -> Optional[Begun]:
        """
        Return a replacement of a track, fed the same pairs with their right stamps corrected.

        The state of a track after its first pairs depends on their stamps.  A wrong right stamp
        usually shows before the track has been fed many more pairs.

        :return: the new track, which has the number of the old one, and its update for the newest
            pair; None if the old track has published a reading or was fed too many pairs, or if
            the new one misses its vehicle in a pair.
        """
        if not track.restart_pairs:
            return None
        start = track.trace.start
        pairs = [self.view_lag.recorrected(pair) for pair in track.restart_pairs]
        next_track, self.next_track = self.next_track, start.track
        new = self._start(start.front, pairs[0], self.lanes[start.lane], track.detection,
                          pairs[-1], start.particles)
        self.next_track = next_track
        if isinstance(new, Refusal):
            return None
        new.found_ns = track.found_ns
        updates = [self.intake.feed(new, pair) for pair in pairs]
        newest = updates[-1]
        if newest is None or not all(map(holds, updates)):
            return None
        new.trace.copy_others(track.trace)
        return new, newest

    def _start(self, front: InitialFront, pair: StereoPair, lane: LanePath,
               detection: Optional[Detection], newest: StereoPair,
               particles: Optional[int] = None) -> Union[Track, Refusal]:
        """
        Return a new track, or why none can start.

        :param pair: the pair of the front.
        :param detection: the detection of the front; None where a person annotated it.
        :param newest: the current pair.
        :param particles: number of particles; None for the share of one more track.
        """
        if particles is None:
            particles = share_of(self.config, len(self.roster.tracks) + 1)
        trace = PassTrace(
            self.next_track, self.seed, lane.name, front, particles,
            seen_mps=detection.speed_mps if detection is not None else None, pairs=(),
            stamp_std_s=self.stamp_std_s, rest_std_rad=self.rest_std_rad(lane))
        tracker = self.start_tracker(start_of(trace, self.rig, lane, self.config, pair))
        if isinstance(tracker, Refusal):
            return tracker
        self.next_track += 1
        config = with_stamps(self.config, trace)
        second = SecondOpinion(self.rig, lane, config) if config.second.enabled else None
        size = VehicleSize(self.rig, lane, self.config.classes,
                           front.std_px if detection is None else None,
                           FrontWidth(self.rig, lane))
        return Track(
            tracker, LaneAssigner(self.lanes, self.config.verdict), detection, newest.stamp_ns,
            TraceBuilder(trace), size, Upright(self.rig, lane), second,
            lag_changes_s=self.view_lag.changes_s, stamp_std_s=trace.stamp_std_s,
            restart_pairs=[] if self.view_lag.concerned else None,
            drift_rad=np.array((pair.motion or RigMotion()).drift_rad))

    def _doubted_at(self, front: Detection, search: Search) -> Optional[Track]:
        """
        Return the doubted track that may hold a detected front; None where none does.

        The front's own range is about as uncertain as that of the track.
        """
        near_m, centre_m = self.config.association.same_vehicle_m, self._centre_m(
            front, search.pair)
        there = [(track, last) for track, last in search.doubted if track in self.roster.tracks
                 and may_be_at(last, centre_m, near_m)]
        return min(there, key=lambda one: float(np.linalg.norm(one[1].position_m - centre_m)),
                   default=(None, None))[0]

    def _lane_of(self, front: InitialFront, pair: StereoPair) -> LanePath:
        """Return the lane whose path is nearest to a front, measured across the road."""
        centre_m = self._centre_m(front, pair)

        def across_m(lane: LanePath) -> float:
            s_m = lane.path.arc_length(centre_m)
            away_m = centre_m - lane.path.position(s_m)
            return abs(float(away_m @ lane.path.frame(s_m)[:, 1]))
        return min(self.lanes.values(), key=across_m)

    def _centre_m(self, front: Union[InitialFront, Detection], pair: StereoPair) -> Array:
        """Return the centre (3,) of a front in a pair, left optical frame, m."""
        return self.rig.as_taken(pair.motion).triangulate(
            front.left_px.mean(axis=0), front.right_px.mean(axis=0))
