# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The one pipeline: pairs in, track updates and pass results out.

The live nodes, ``replay`` and the tests all run this object, so the same pairs and seed give the
same speeds everywhere, but where a machine that does not keep up has pairs hurried or skipped.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
import math
from typing import Callable, Container, Iterable, Mapping, Optional, Sequence, Union

import numpy as np

from .conclusions import AtOnce, Conclusions
from .pass_end import PassEnd
from .time_doubt import TimeDoubt
from .track import holds, is_sure, start_of, Track, with_stamps
from .turns import take_turns
from ..classification.size import VehicleSize
from ..core.config import TrackerConfig
from ..core.errors import InputError
from ..core.passes import PassResult, Reason
from ..core.records import (
    Array, InitialFront, RigMotion, StereoPair, TrackState, TrackUpdate)
from ..core.stamp_watch import StampWatch
from ..core.trace import PassTrace, TraceBuilder
from ..detection.protocol import Detection, Detector, LooksAhead, TrackedRegion
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..second.estimate import SecondOpinion
from ..steadying.doubt import SpeedDoubt
from ..steadying.steadier import Steadier
from ..steadying.view_lag import ViewLag
from ..tracking.initialise import check_annotation
from ..tracking.lane_assigner import LaneAssigner
from ..tracking.protocol import Refusal, SharesParticles, Tracker, TrackStart

_UNSEARCHED_S = 0.3  # of stamps, at most: vehicles are in view for seconds
_APART = 2.0  # times the distance of doubles: what a solution changes of a place is less
_WORSE = 1.5  # times what a track takes its stamps for: twenty intervals tell it to a fifth

StartTracker = Callable[[TrackStart], Union[Tracker, Refusal]]
TellReadings = Callable[[Sequence[TrackUpdate]], object]


def _nobody(readings: Sequence[TrackUpdate]) -> None:
    """Tell readings to nobody."""


@dataclass(frozen=True)
class Step:
    """
    What came of one pair.

    :param updates: of the tracks that followed their vehicles in it.
    :param passes: that are over and measured since the last pair.
    """

    updates: list[TrackUpdate]
    passes: list[PassResult]


@dataclass(frozen=True, eq=False)
class _Search:
    """
    A search whose answer is taken with the next pair.

    :param pair: that is searched.
    :param tracked: what the tracks held in it.
    :param doubted: tracks that were doubted, and the middle (3,) of the front that each held.
    :param found: in it; None while that is not known.
    :param seen: updates of the tracks in it.
    """

    pair: StereoPair
    tracked: Sequence[TrackedRegion]
    doubted: Sequence[tuple[Track, Array]]
    found: Optional[Sequence[Detection]] = None
    seen: Sequence[TrackUpdate] = ()


@dataclass
class _State:
    """What a jump of time makes the pipeline forget."""

    tracks: list[Track] = field(default_factory=list)
    gone: list[TrackUpdate] = field(default_factory=list)  # last updates of what left lately
    last_ns: Optional[int] = None
    searched_ns: Optional[int] = None  # stamp of the last pair that was
    search: Optional[_Search] = None  # whose answer is still to be taken
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
    :param conclusions: measures what is over; None measures it at once.
    :param seed: seed of all randomness; each track draws from its own stream, so that tracks do
        not disturb one another.
    :param where: where the annotations come from, for errors.
    :raises InputError: an annotation outside the images, no lane.
    """

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath], config: TrackerConfig,
                 start: StartTracker, *, annotations: Sequence[InitialFront] = (),
                 detector: Optional[Detector] = None, steadier: Optional[Steadier] = None,
                 conclusions: Optional[Conclusions] = None, seed: int = 0,
                 where: str = 'init file') -> None:
        if not lanes:
            raise InputError('site', 'lanes', 'none', 'at least one lane')
        for front in annotations:
            check_annotation(rig, front, where)
        self.rig, self.lanes, self.config = rig, dict(lanes), config
        self.detector, self.steadier, self.seed = detector, steadier, seed
        self._start_tracker, self._annotations = start, tuple(annotations)
        self._doubt = SpeedDoubt(rig, lanes, config)
        self._conclusions = AtOnce() if conclusions is None else conclusions
        self._concluding: set[int] = set()  # numbers of the tracks that it has
        self.view_lag, self.stamp_watch = ViewLag(rig), StampWatch()
        #: 1-sigma that stamps are taken to have where they are less even than they should be, s
        self.uneven_stamps_s: Optional[float] = None
        self.next_track = 0  # its number; who goes on from another pipeline sets its
        self._state = _State()

    def process(self, pair: StereoPair, hurried: bool = False,
                readings: TellReadings = _nobody) -> Step:
        """
        Take in the next pair.

        :param hurried: whether to do little with it, for others wait: vehicles are followed, but
            one is solved for where its last solution is old, and new ones are searched for where
            none were for long.
        :param readings: told those readings that are known before new vehicles are searched for,
            in one or two turns; the step has them too.
        :raises InputError: its stamp is not after the one before.
        """
        state = self._state
        if state.last_ns is not None and pair.stamp_ns <= state.last_ns:
            raise InputError('pairs', f'stamp of pair {pair.index}', pair.stamp_ns,
                             f'later than {state.last_ns}')
        # Pairs come faster than vehicles are solved for: none waits for its search.
        dense = state.last_ns is not None and (
            pair.stamp_ns - state.last_ns) * 1e-9 < self.config.effort.solve_interval_s
        state.last_ns = pair.stamp_ns
        self._check_size(pair)
        if self.stamp_watch.add(pair.stamp_ns):
            self._end_by_step()
        self._see_stamps()
        pair = self.view_lag.corrected(pair.triggered(self.config.trigger_tolerance_s))
        if self.steadier is not None:
            pair = self.steadier.steady(pair)
        self._start_annotated(pair)
        searches = self._searches(pair.stamp_ns, hurried=hurried)
        take_turns(state.tracks, pair.stamp_ns, self._solve_interval_s(), hurried=hurried,
                   dense=dense)
        if searches and not dense and isinstance(self.detector, LooksAhead):
            self._settle()
            self.detector.expect(pair, self._regions(pair, [
                _moved_on(held, pair.stamp_ns) for held in self._held()],
                self._lately_gone(pair)))
        share = self._share(max(len(state.tracks), 1))
        for track in state.tracks:
            if isinstance(track.tracker, SharesParticles):
                track.tracker.share(share)
        self._see_drift()
        if self.view_lag.concerned:  # what this pair shows of the lag counts, too
            readings = _nobody
        updates = self._followed(pair, share, readings)
        # Where others wait, so does what was found.
        found = [] if hurried and not searches else self._take_answer(pair)
        self._see_gone(pair)
        if searches and dense:
            self._search_beside(pair, [u for u in [*updates, *found] if u is not None])
        elif searches:
            found += self._detect(pair)
        if found:
            self._see_drift()
        updates += found
        seen = [u for u in updates if u is not None]
        self.view_lag.observe(pair, seen)
        for track in state.tracks:
            track.trace.add_others(pair.stamp_ns, seen)
        self._collect(everything=False)
        return Step(self._told(seen), self.concluded())

    def _followed(self, pair: StereoPair, share: int, readings: TellReadings
                  ) -> list[Optional[TrackUpdate]]:
        """
        Feed a pair to the tracks there are, and tell their readings.

        Those that are not solved for come first: their readings wait for no solution.  What is
        told is not taken back: of doubles the other one ends.

        :param share: number of particles of each.
        :return: what each says, in their order.
        """
        tracks, interval_s = list(self._state.tracks), self._solve_interval_s()
        quick = [t for t in tracks if holds(t.last) and (
            t.hurried or t.waited_s(pair.stamp_ns) < interval_s)]
        updates = {t: self._update(t, pair, share) for t in quick}
        early: list[TrackUpdate] = []
        if 0 < len(quick) < len(tracks):
            early = [u for u in self._readings(updates.values()) if self._is_apart(u)]
            readings(early)
        updates.update((t, self._update(t, pair, share)) for t in tracks if t not in updates)
        told = {u.track for u in early}
        self._drop_missing()
        self._drop_doubles(told)
        readings(self._readings(updates[t] for t in tracks if t.tracker.track not in told))
        return [updates[t] for t in tracks]

    def _readings(self, updates: Iterable[Optional[TrackUpdate]]) -> list[TrackUpdate]:
        """Return those updates that are readings of tracks that go on."""
        going_on = {t.tracker.track for t in self._state.tracks if not t.tracker.ended}
        return [u for u in self._told(updates)
                if u.state is TrackState.CONFIRMED and u.track in going_on]

    def _is_apart(self, update: TrackUpdate) -> bool:
        """Return whether no other track can hold the same vehicle, wherever it is by now."""
        near_m = _APART * self.config.association.same_vehicle_m
        return not any(
            t.last is not None and t.tracker.track != update.track
            and np.linalg.norm(_place_m(t.last, update.stamp_ns) - update.position_m) < near_m
            for t in self._state.tracks)

    def _see_stamps(self) -> None:
        """Have the tracks take in how uneven the stamps are."""
        self.uneven_stamps_s = uneven_s = self._times.uneven_s()
        for track in self._state.tracks:
            if uneven_s is not None and uneven_s > _WORSE * (
                    track.stamp_std_s or self.config.stamp_std_s):
                track.see_stamps(uneven_s)

    @property
    def _times(self) -> TimeDoubt:
        """Return the doubt of its times as they are known now."""
        return TimeDoubt(self.config, self.stamp_watch, self.view_lag)

    def _see_drift(self) -> None:
        """Have the tracks take in how far the right camera is taken to have turned."""
        if self.steadier is not None:
            for track in self._state.tracks:
                track.see_drift(self.steadier.drift.corrected_rad)

    def _told(self, updates: Iterable[Optional[TrackUpdate]]) -> list[TrackUpdate]:
        """Return the updates of tracks that there are, with the doubt of their times and rig."""
        tracks = {track.tracker.track: track for track in self._state.tracks}
        times = self._times
        told = [times.told(u, tracks[u.track]) for u in updates
                if u is not None and u.track in tracks]
        if self.steadier is None:
            return told
        return [self._doubt.update(u, self.steadier, tracks[u.track].drift_change_rad)
                for u in told]

    def concluded(self, *, everything: bool = False) -> list[PassResult]:
        """
        Return passes that were measured since the last pair, where this is done beside the pairs.

        :param everything: wait for all that are over.
        """
        passes = self._conclusions.done(everything=everything)
        self._concluding.difference_update(result.track for result in passes)
        return passes

    @property
    def open_tracks(self) -> set[int]:
        """Return the numbers of the tracks whose passes may still come."""
        return {t.tracker.track for t in self._state.tracks} | self._concluding

    def is_idle(self) -> bool:
        """
        Return whether another pipeline could go on from this one as this one would itself.

        No vehicle is in view or has just left it, and the views have one stamp.  What a detector
        remembers of the pairs so far does not count: another one begins without it, and may
        detect the next vehicle some pairs later or earlier.  Where only a search under way is
        left to tell, its answer is waited for: it tells the same in whichever process it is.
        """
        state, gone_s = self._state, self.config.association.gone_s
        left_lately = any(((state.last_ns or 0) - u.stamp_ns) * 1e-9 < gone_s for u in state.gone)
        if self.open_tracks or left_lately or self.view_lag.concerned:
            return False
        self._settle()
        return state.search is None or not state.search.found

    def go_on_from(self, other: SpeedPipeline) -> None:
        """Take over from an idle pipeline: its numbers, how the rig stands, stamps so far."""
        self.next_track, self.steadier = other.next_track, other.steadier
        self.stamp_watch, self._state.last_ns = other.stamp_watch, other._state.last_ns

    def look(self, pair: StereoPair) -> None:
        """Take in stamps, and how the rig stood, of a pair that is measured already."""
        self.stamp_watch.add(pair.stamp_ns)
        self._state.last_ns = pair.stamp_ns
        if self.steadier is not None:
            self.steadier.steady(pair.triggered(self.config.trigger_tolerance_s))

    def finish(self) -> list[PassResult]:
        """
        End all tracks, the stream being over, and return their results.

        What was found in the last pair, and not followed in another, is no vehicle as far as is
        known: nothing was told of it.
        """
        self._state.search = None
        self._collect(everything=True)
        return self.concluded(everything=True)

    def reset(self) -> None:
        """Forget all tracks and the time, as after a jump back; numbers are not reused."""
        self._state = _State()
        self.stamp_watch.restart()
        if self.detector is not None:
            self.detector.reset()
        if self.steadier is not None:
            self.steadier.reset()

    def _end_by_step(self) -> None:
        """
        End the passes of detected vehicles, for the clock has stepped: they are found anew.

        What a person marked is not found again, and is followed on, without a speed.
        """
        for track in list(self._state.tracks):
            track.clock_stepped = True
            if track.detection is not None:
                self._state.tracks.remove(track)
                if track.confirmed:
                    self._conclude(track)
        self._state.search = None
        if self.detector is not None:
            self.detector.reset()  # its earlier pairs have the clock of before

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
               detection: Optional[Detection], newest: StereoPair) -> Union[Track, Refusal]:
        """
        Start a track; tracks share the particles there are.

        :param pair: the pair of the front.
        :param detection: what found it; None where a person annotated it.
        :param newest: the pair in hand.
        """
        number, tracks = self.next_track, self._state.tracks
        trace = PassTrace(
            number, self.seed, lane.name, front, self._share(len(tracks) + 1),
            seen_mps=detection.speed_mps if detection is not None else None, pairs=(),
            stamp_std_s=self.uneven_stamps_s)
        tracker = self._start_tracker(start_of(trace, self.rig, lane, self.config, pair))
        if isinstance(tracker, Refusal):
            return tracker
        self.next_track += 1
        config = with_stamps(self.config, trace)
        second = SecondOpinion(self.rig, lane, config) if config.second.enabled else None
        size = VehicleSize(self.rig, lane, self.config.classes,
                           front.std_px if detection is None else None)
        tracks.append(Track(
            tracker, LaneAssigner(self.lanes, self.config.verdict), detection, newest.stamp_ns,
            TraceBuilder(trace), size, second, lag_changes_s=self.view_lag.changes_s,
            stamp_std_s=trace.stamp_std_s,
            drift_rad=np.array((pair.motion or RigMotion()).drift_rad)))
        return tracks[-1]

    def _share(self, tracks: int) -> int:
        """Return the particles of each of so many tracks."""
        wanted = self.config.particles
        if tracks == 1:
            return wanted
        fewest = self.config.effort.fewest_particles
        return min(wanted, max(self.config.particle_budget // tracks, fewest))

    def _update(self, track: Track, pair: StereoPair,
                particles: Optional[int] = None) -> Optional[TrackUpdate]:
        """
        Feed a track, and place its vehicle in a lane.

        :param particles: number of particles that its tracker was told; None where it was not.
        """
        update, hurried = track.tracker.update(pair), track.hurried
        if update is None:
            track.trace.add(pair, particles, None, hurried=hurried, stamp_std_s=track.stamp_std_s)
            return None
        if holds(update):
            track.size.take(pair, update)
            if track.second is not None:
                track.second.take(pair, update.quad_left_px, update.quad_right_px)
        track.doubted = not track.confirmed and self._is_doubtful(track, update)
        if track.doubted:
            update = update.unconfirmed()
        track.confirmed |= update.state is TrackState.CONFIRMED
        if not is_sure(update, self.config.visibility):
            update = update.unconfirmed()
        track.last = track.lanes.place(update)
        track.trace.add(pair, particles, track.last, hurried=hurried,
                        stamp_std_s=track.stamp_std_s)
        return track.last

    def _searches(self, stamp_ns: int, *, hurried: bool) -> bool:
        """Return whether new vehicles are searched for in the next pair."""
        last_ns = self._state.searched_ns
        searches = not hurried or last_ns is None or (stamp_ns - last_ns) * 1e-9 >= _UNSEARCHED_S
        if searches:
            self._state.searched_ns = stamp_ns
        return searches

    def _solve_interval_s(self) -> float:
        """Return the time between two solutions of a track, which share the effort there is."""
        return self.config.effort.solve_interval_s * (
            self.config.particles / self._share(max(len(self._state.tracks), 1)))

    def _is_doubtful(self, track: Track, update: TrackUpdate) -> bool:
        """
        Return whether a young track sees another speed than its detector saw, or none.

        After a while the vehicle may have changed its speed, but by no more than it can brake.
        What a detector saw move beside a vehicle may be road that this has uncovered.
        """
        if track.detection is None or update.state is not TrackState.CONFIRMED:
            return False
        if update.speed_mps < self.config.association.moving_sigmas * update.speed_std_mps:
            return True
        limits, age_s = self.config.association, (update.stamp_ns - track.found_ns) * 1e-9
        change_mps = 0.0 if age_s < limits.doubt_s else limits.braking_mps2 * age_s
        return not self._same_speed(update, track.detection, change_mps)

    def _detect(self, pair: StereoPair) -> list[Optional[TrackUpdate]]:
        """Start tracks at fronts that are detected, and feed them their first pairs."""
        search = self._search(pair)
        return [self._begin(front, search) for front in self._answer(search)]

    def _search(self, pair: StereoPair) -> _Search:
        """Return what a pair is searched with."""
        return _Search(pair, self._regions(pair, self._held(), self._state.gone), [
            (t, t.last.position_m) for t in self._state.tracks
            if t.doubted and t.last is not None])

    def _answer(self, search: _Search) -> Sequence[Detection]:
        """Return what is found in a pair."""
        if search.found is not None:
            return search.found
        return [] if self.detector is None else self.detector.update(search.pair, search.tracked)

    def _settle(self) -> None:
        """Have the answer of the search under way, to be taken with the next pair."""
        search = self._state.search
        if search is not None:
            self._state.search = replace(search, found=self._answer(search))

    def _search_beside(self, pair: StereoPair, seen: Sequence[TrackUpdate]) -> None:
        """
        Begin to search a pair; the answer is taken with the next one.

        :param seen: updates of the tracks in it.
        """
        search = replace(self._search(pair), seen=seen)
        if isinstance(self.detector, LooksAhead):
            self.detector.expect(pair, search.tracked)
        else:
            search = replace(search, found=self._answer(search))
        self._state.search = search

    def _take_answer(self, pair: StereoPair) -> list[Optional[TrackUpdate]]:
        """
        Start tracks at fronts that were detected in an earlier pair, and feed them this one.

        The earlier pair has the others' updates of then, and theirs has what was found in it.
        What has gone meanwhile is no vehicle as far as is known: nothing was told of it.
        """
        search, self._state.search = self._state.search, None
        if search is None:
            return []
        found = [u for front in self._answer(search)
                 if (u := self._begin(front, search)) is not None]
        if not found:
            return []
        begun = {u.track for u in found}
        for track in self._state.tracks:
            new = track.tracker.track in begun
            track.trace.add_others(search.pair.stamp_ns, [*search.seen, *found] if new else found)
        updates = [self._update(track, pair) for track in self._state.tracks
                   if track.tracker.track in begun]
        gone = begun - {u.track for u in updates if u is not None}
        self._state.tracks = [t for t in self._state.tracks if t.tracker.track not in gone]
        self._drop_missing()
        return updates

    def _see_gone(self, pair: StereoPair) -> None:
        """
        Take in what has left.

        What was lost, and so coasted before it ended, may be found again; what left may not.
        """
        state = self._state
        state.gone = self._lately_gone(pair) + [
            t.last for t in state.tracks if t.last is not None and t.tracker.ended
            and holds(t.last) and t.is_vehicle]

    def _held(self) -> list[TrackUpdate]:
        """
        Return where the tracks last were that go on.

        Where one is doubted the detector looks again: one of the two was mistaken.
        """
        return [t.last for t in self._state.tracks
                if t.last is not None and not t.tracker.ended and not t.doubted]

    def _lately_gone(self, pair: StereoPair) -> list[TrackUpdate]:
        """Return where vehicles were when they left, of which some may still show in a pair."""
        gone_s = self.config.association.gone_s
        return [u for u in self._state.gone if (pair.stamp_ns - u.stamp_ns) * 1e-9 < gone_s]

    def _regions(self, pair: StereoPair, held: Sequence[TrackUpdate],
                 gone: Sequence[TrackUpdate]) -> list[TrackedRegion]:
        """Return what tracks hold in a pair, and where vehicles are by now that have left."""
        return [self._region(one) for one in held] + [
            self._region(_moved_on(one, pair.stamp_ns)) for one in gone]

    def _begin(self, front: Detection, search: _Search) -> Optional[TrackUpdate]:
        """
        Start a track where a front was first seen; where that fails, where it is now.

        A doubted track that is there goes on, and is doubted by what its detector sees now.
        """
        pair = search.pair
        doubted = self._doubted_at(front, search)
        if doubted is not None:
            if doubted.last is not None and self._same_speed(doubted.last, front):
                doubted.detection, doubted.found_ns = front, pair.stamp_ns
            return None
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
            if newest is not None and all(map(holds, updates)) and (
                    len(pairs) == 1 or self._same_speed(newest, front)):
                return newest
            self._state.tracks.remove(track)
        return None

    def _doubted_at(self, front: Detection, search: _Search) -> Optional[Track]:
        """Return the doubted track that holds what is detected in a pair; None where none does."""
        near_m, centre = self.config.association.same_vehicle_m, self._centre(front, search.pair)
        return next((track for track, at_m in search.doubted if track in self._state.tracks
                     and np.linalg.norm(at_m - centre) < near_m), None)

    def _centre(self, front: Union[InitialFront, Detection], pair: StereoPair) -> Array:
        """Return the middle (3,) of a front of a pair, left optical frame, m."""
        return self.rig.as_taken(pair.motion).triangulate(
            front.left_px.mean(axis=0), front.right_px.mean(axis=0))

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
            or t.tracker.ended or holds(t.last)]

    def _drop_doubles(self, told: Container[int] = ()) -> None:
        """
        End one of two tracks that hold the same vehicle.

        That which does not see it ends, and the younger if both do.

        :param told: numbers of tracks whose readings of this pair are told, which stay: the other
            one was expected elsewhere.
        """
        tracks, near_m = self._state.tracks, self.config.association.same_vehicle_m
        held: list[TrackUpdate] = []
        for track in sorted(tracks, key=lambda t: (t.tracker.track not in told,
                                                   not holds(t.last))):
            if track.last is None or track.tracker.ended:
                continue
            at = track.last.position_m
            if track.detection is not None and any(
                    np.linalg.norm(at - other.position_m) < near_m for other in held):
                tracks.remove(track)
                if track.confirmed:
                    self._conclude(track, Reason.DUPLICATE)
            else:
                held.append(track.last)

    def _lane_of(self, front: InitialFront, pair: StereoPair) -> LanePath:
        """Return the lane whose path a front of a pair is nearest to, across the road."""
        centre = self._centre(front, pair)

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
        """
        Measure the passes that are over.

        A vehicle that left the view before it was confirmed is rejected; what was lost, or had
        just come when the stream ended, was no vehicle as far as is known.
        """
        state = self._state
        for track in [t for t in state.tracks if everything or t.tracker.ended]:
            state.tracks.remove(track)
            if track.confirmed or track.detection is None:
                self._conclude(track)
            elif track.tracker.ended and track.is_vehicle:
                self._conclude(track, Reason.TOO_FEW_PAIRS)

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

    def _conclude(self, track: Track, reason: Optional[Reason] = None) -> None:
        """
        Have the whole pass of a track measured, which is over.

        :param reason: why it is rejected whatever comes out; None where it is not.
        """
        lag_share = 0.0 if track.last is None else self._times.lag_share(track, track.last)
        rig_shares = {} if self.steadier is None else self._doubt.shares(
            self.steadier, track.drift_change_rad)
        self._concluding.add(track.tracker.track)
        self._conclusions.add(
            PassEnd(
                track, self.lanes, self.config, self._doubt, lag_share, rig_shares, reason),
            partial(self._concluding.discard, track.tracker.track))


def _moved_on(update: TrackUpdate, stamp_ns: int) -> TrackUpdate:
    """Return where a vehicle is along its lane some time after it left."""
    return replace(update, s_m=update.s_m + _ahead_m(update, stamp_ns))


def _place_m(update: TrackUpdate, stamp_ns: int) -> Array:
    """Return where (3,) a vehicle is at a later stamp by its speed, left optical frame, m."""
    return update.position_m + _ahead_m(update, stamp_ns) * update.axes[:, 0]


def _ahead_m(update: TrackUpdate, stamp_ns: int) -> float:
    """Return how far a vehicle goes until a later stamp by its speed, m."""
    return update.speed_mps * (stamp_ns - update.stamp_ns) * 1e-9
