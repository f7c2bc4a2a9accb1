# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The one pipeline: pairs in, track updates and pass results out.

The live nodes, ``replay`` and the tests all run this object, so the same pairs and seed give the
same speeds everywhere.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
import math
from typing import Callable, Mapping, Optional, Sequence, Union

import numpy as np

from ..core.config import TrackerConfig
from ..core.errors import InputError
from ..core.records import (
    Array, InitialFront, PassResult, Reason, StereoPair, TrackState, TrackUpdate)
from ..detection.protocol import Detection, Detector, TrackedRegion
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..steadying.doubt import SpeedDoubt
from ..steadying.steadier import Steadier
from ..tracking.initialise import check_annotation
from ..tracking.lane_assigner import LaneAssigner
from ..tracking.protocol import Refusal, SharesParticles, Tracker, TrackStart

StartTracker = Callable[[TrackStart], Union[Tracker, Refusal]]


@dataclass(frozen=True)
class Step:
    """
    What came of one pair.

    :param updates: of the tracks that followed their vehicles in it.
    :param passes: that are over since the last pair.
    """

    updates: list[TrackUpdate]
    passes: list[PassResult]


@dataclass
class _Track:
    """
    A track and what the pipeline keeps of it.

    :param tracker: follows the vehicle.
    :param lanes: assigns it to lanes.
    :param detection: what it was started by; None where a person annotated it.
    :param found_ns: stamp of the pair that it was detected in.
    :param last: its newest update.
    :param confirmed: whether it ever was.
    """

    tracker: Tracker
    lanes: LaneAssigner
    detection: Optional[Detection]
    found_ns: int
    last: Optional[TrackUpdate] = None
    confirmed: bool = False


@dataclass
class _State:
    """What a jump of time makes the pipeline forget."""

    tracks: list[_Track] = field(default_factory=list)
    ended: list[PassResult] = field(default_factory=list)
    gone: list[TrackUpdate] = field(default_factory=list)  # last updates of what left lately
    last_ns: Optional[int] = None
    started: set[int] = field(default_factory=set)  # numbers of the annotations used


class SpeedPipeline:
    """
    Start a track at each annotated or detected front, feed it the pairs, collect its result.

    ``assembly.make_pipeline`` makes one from names and parameters.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters that all trackers share.
    :param start: starts a tracker.
    :param annotations: fronts as a person annotated them.
    :param detector: finds further vehicles; None leaves it at the annotated ones.
    :param steadier: finds how the rig stands in each pair; None takes it to stand still.
    :param seed: seed of all randomness; each track draws from its own stream, so that tracks do
        not disturb one another.
    :param where: where the annotations come from, for errors.
    :raises InputError: an annotation outside the images, no lane.
    """

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath], config: TrackerConfig,
                 start: StartTracker, *, annotations: Sequence[InitialFront] = (),
                 detector: Optional[Detector] = None, steadier: Optional[Steadier] = None,
                 seed: int = 0, where: str = 'init file') -> None:
        if not lanes:
            raise InputError('site', 'lanes', 'none', 'at least one lane')
        for front in annotations:
            check_annotation(rig, front, where)
        self.rig, self.lanes, self.config = rig, dict(lanes), config
        self.detector, self.steadier, self.seed = detector, steadier, seed
        self._start_tracker, self._annotations = start, tuple(annotations)
        self._doubt = SpeedDoubt(rig, lanes, config)
        self._next_track = 0
        self._state = _State()

    def process(self, pair: StereoPair) -> Step:
        """
        Take in the next pair.

        :raises InputError: its stamp is not after the one before.
        """
        state = self._state
        if state.last_ns is not None and pair.stamp_ns <= state.last_ns:
            raise InputError('pairs', f'stamp of pair {pair.index}', pair.stamp_ns,
                             f'later than {state.last_ns}')
        state.last_ns = pair.stamp_ns
        self._check_size(pair)
        pair = pair.triggered(self.config.trigger_tolerance_s)
        if self.steadier is not None:
            pair = self.steadier.steady(pair)
        self._start_annotated(pair)
        for track in state.tracks:
            if isinstance(track.tracker, SharesParticles):
                track.tracker.share(self._share(len(state.tracks)))
        updates = [self._update(track, pair) for track in state.tracks]
        self._drop_missing()
        self._drop_doubles()
        updates += self._detect(pair)
        self._collect(everything=False)
        active = {track.tracker.track for track in state.tracks}
        ended, state.ended = state.ended, []
        told = [u for u in updates if u is not None and u.track in active]
        if self.steadier is not None:
            told = [self._doubt.update(update, self.steadier) for update in told]
        return Step(told, ended)

    def finish(self) -> list[PassResult]:
        """End all tracks, the stream being over, and return their results."""
        self._collect(everything=True)
        ended, self._state.ended = self._state.ended, []
        return ended

    def reset(self) -> None:
        """Forget all tracks and the time, as after a jump back; numbers are not reused."""
        self._state = _State()
        if self.detector is not None:
            self.detector.reset()
        if self.steadier is not None:
            self.steadier.reset()

    def _start_annotated(self, pair: StereoPair) -> None:
        """
        Start a track at each front that is annotated in a pair.

        :raises InputError: the views do not agree on a front there.
        """
        for number, front in enumerate(self._annotations):
            if front.frame == pair.index and number not in self._state.started:
                self._state.started.add(number)
                track = self._start(front, pair, self._lane_of(front, pair), None, pair)
                if isinstance(track, Refusal):
                    raise track.error()

    def _start(self, front: InitialFront, pair: StereoPair, lane: LanePath,
               detection: Optional[Detection], newest: StereoPair) -> Union[_Track, Refusal]:
        """
        Start a track; tracks share the particles there are.

        :param pair: the pair of the front.
        :param detection: what found it; None where a person annotated it.
        :param newest: the pair in hand.
        """
        number, tracks = self._next_track, self._state.tracks
        tracker = self._start_tracker(TrackStart(
            rig=self.rig, lane=lane, front=front, pair=pair, track=number,
            config=replace(self.config, particles=self._share(len(tracks) + 1)),
            rng=np.random.default_rng([self.seed, number]),
            seen_mps=detection.speed_mps if detection is not None else None))
        if isinstance(tracker, Refusal):
            return tracker
        self._next_track += 1
        tracks.append(_Track(tracker, LaneAssigner(self.lanes, self.config.verdict), detection,
                             newest.stamp_ns))
        return tracks[-1]

    def _share(self, tracks: int) -> int:
        """Return the particles of each of so many tracks."""
        wanted = self.config.particles
        if tracks == 1:
            return wanted
        fewest = self.config.effort.fewest_particles
        return min(wanted, max(self.config.particle_budget // tracks, fewest))

    def _update(self, track: _Track, pair: StereoPair) -> Optional[TrackUpdate]:
        """Feed a track, and place its vehicle in a lane."""
        update = track.tracker.update(pair)
        if update is None:
            return None
        if not track.confirmed and self._is_doubtful(track, update):
            update = replace(update, state=TrackState.TENTATIVE)
        track.confirmed |= update.state is TrackState.CONFIRMED
        if update.state is TrackState.CONFIRMED and not self._is_sure(update):
            update = replace(update, state=TrackState.TENTATIVE)
        track.last = track.lanes.place(update)
        return track.last

    def _is_sure(self, update: TrackUpdate) -> bool:
        """Return whether the speed of a vehicle is known well enough to be a reading."""
        limits = self.config.visibility
        return update.speed_std_mps <= max(
            limits.reading_std_mps, limits.reading_std_share * abs(update.speed_mps))

    def _is_doubtful(self, track: _Track, update: TrackUpdate) -> bool:
        """
        Return whether a young track sees another speed than its detector saw.

        After a while the vehicle may have changed its speed, but by no more than it can brake.
        """
        if track.detection is None or update.state is not TrackState.CONFIRMED:
            return False
        limits, age_s = self.config.association, (update.stamp_ns - track.found_ns) * 1e-9
        change_mps = 0.0 if age_s < limits.doubt_s else limits.braking_mps2 * age_s
        return not self._same_speed(update, track.detection, change_mps)

    def _detect(self, pair: StereoPair) -> list[Optional[TrackUpdate]]:
        """Start tracks at fronts that are detected, and feed them their first pairs."""
        if self.detector is None:
            return []
        state, gone_s = self._state, self.config.association.gone_s
        # What was lost, and so coasted before it ended, may be found again; what left may not.
        state.gone = [u for u in state.gone if (pair.stamp_ns - u.stamp_ns) * 1e-9 < gone_s] + [
            t.last for t in state.tracks if t.last is not None and t.tracker.ended
            and t.confirmed and _holds(t.last)]
        regions = [self._region(t.last) for t in state.tracks
                   if t.last is not None and not t.tracker.ended]
        regions += [self._region(_moved_on(u, pair.stamp_ns)) for u in state.gone]
        return [self._begin(front, pair) for front in self.detector.update(pair, regions)]

    def _begin(self, front: Detection, pair: StereoPair) -> Optional[TrackUpdate]:
        """Start a track where a front was first seen; where that fails, where it is now."""
        starts: list[tuple[tuple[StereoPair, ...], Array, Array]] = [
            ((pair,), front.left_px, front.right_px)]
        if front.earlier is not None:
            seen = front.earlier.pairs
            some = seen[::math.ceil(len(seen) / self.config.association.catch_up_pairs)]
            starts.insert(0, ((*some, pair), front.earlier.left_px, front.earlier.right_px))
        for pairs, left_px, right_px in starts:
            first = InitialFront(pairs[0].index, left_px, right_px, front.std_px)
            track = self._start(first, pairs[0], self.lanes[front.lane], front, pair)
            if isinstance(track, Refusal):  # what looked like a front is none
                continue
            updates = [self._update(track, one) for one in pairs]
            newest = updates[-1]
            if newest is not None and all(map(_holds, updates)) and (
                    len(pairs) == 1 or self._same_speed(newest, front)):
                return newest
            self._state.tracks.remove(track)
        return None

    def _region(self, update: TrackUpdate) -> TrackedRegion:
        """Return what a track holds in this pair."""
        across, up = np.ptp(update.quad_left_px, axis=0)
        scale = float(update.position_m[2]) / self.rig.left.K[[0, 1], [0, 1]]
        return TrackedRegion(
            lane=update.lane, s_m=update.s_m, lateral_m=update.lateral_m,
            width_m=float(across * scale[0]), height_m=float(up * scale[1]),
            left_px=update.quad_left_px, right_px=update.quad_right_px)

    def _drop_missing(self) -> None:
        """End tracks that miss a pair before they are confirmed; a vehicle is found again."""
        self._state.tracks = [
            t for t in self._state.tracks if t.confirmed or t.detection is None
            or t.tracker.ended or _holds(t.last)]

    def _drop_doubles(self) -> None:
        """
        End one of two tracks that hold the same vehicle.

        That which does not see it ends, and the younger if both do.
        """
        tracks, near_m = self._state.tracks, self.config.association.same_vehicle_m
        held: list[TrackUpdate] = []
        for track in sorted(tracks, key=lambda t: not _holds(t.last)):
            if track.last is None or track.tracker.ended:
                continue
            at = track.last.position_m
            if track.detection is not None and any(
                    np.linalg.norm(at - other.position_m) < near_m for other in held):
                tracks.remove(track)
                if track.confirmed:
                    self._state.ended.append(self._result(track).rejected(Reason.DUPLICATE))
            else:
                held.append(track.last)

    def _lane_of(self, front: InitialFront, pair: StereoPair) -> LanePath:
        """Return the lane whose path a front of a pair is nearest to, across the road."""
        rig = self.rig.as_taken(pair.motion)
        centre = rig.triangulate(front.left_px.mean(axis=0), front.right_px.mean(axis=0))

        def across(lane: LanePath) -> float:
            s_m = lane.path.arc_length(centre)
            return abs(float((centre - lane.path.position(s_m)) @ lane.path.frame(s_m)[:, 1]))
        return min(self.lanes.values(), key=across)

    def _check_size(self, pair: StereoPair) -> None:
        for side, image, camera in (('left', pair.left, self.rig.left),
                                    ('right', pair.right, self.rig.right)):
            if image.shape != (camera.height_px, camera.width_px):
                raise InputError(
                    f'pair {pair.index}', f'{side} image size',
                    f'{image.shape[1]}x{image.shape[0]}',
                    f'{camera.width_px}x{camera.height_px} as calibrated')

    def _collect(self, *, everything: bool) -> None:
        """Measure the passes that are over; what was never confirmed was no vehicle."""
        state = self._state
        for track in [t for t in state.tracks if everything or t.tracker.ended]:
            state.tracks.remove(track)
            if track.confirmed or track.detection is None:
                state.ended.append(self._result(track))

    def _same_speed(self, update: TrackUpdate, front: Detection, change_mps: float = 0.0) -> bool:
        """
        Return whether track and detector, each by itself, saw one speed.

        :param change_mps: by which the speed may have changed since.
        """
        if front.speed_mps is None:
            return True
        std = math.hypot(update.speed_std_mps, front.speed_std_mps)
        limit = self.config.association.same_speed_sigmas * std + change_mps
        return abs(update.speed_mps - front.speed_mps) < limit

    def _result(self, track: _Track) -> PassResult:
        result = track.lanes.conclude(track.tracker.result())
        return result if self.steadier is None else self._doubt.result(result, self.steadier)


def _moved_on(update: TrackUpdate, stamp_ns: int) -> TrackUpdate:
    """Return where a vehicle is along its lane some time after it left."""
    ahead_m = update.speed_mps * (stamp_ns - update.stamp_ns) * 1e-9
    return replace(update, s_m=update.s_m + ahead_m)


def _holds(update: Optional[TrackUpdate]) -> bool:
    """Return whether a track saw its vehicle in a pair."""
    return update is not None and update.state is not TrackState.COASTING
