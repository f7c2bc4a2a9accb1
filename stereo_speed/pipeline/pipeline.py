# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The one pipeline: pairs in, track updates and pass results out.

The live nodes, ``replay`` and the tests all run this object, so the same pairs and seed give the
same speeds everywhere, but where live pairs come so fast that solutions are made beside them, or a
machine that does not keep up has pairs hurried or skipped.
"""
from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
import math
from typing import Any, Callable, Container, Iterable, Mapping, Optional, Sequence, Union

import numpy as np

from .conclusions import AtOnce, Conclusions
from .pass_end import PassEnd
from .search import Search, VehicleSearch
from .solving import later_pairs, SolvingBeside, Turn
from .time_doubt import TimeDoubt
from .track import ahead_m, holds, is_sure, start_of, Track, with_stamps
from .turns import take_turns
from ..classification.size import VehicleSize
from ..core.config import TrackerConfig
from ..core.errors import InputError
from ..core.passes import PassResult, Reason
from ..core.records import (
    Array, InitialFront, RigMotion, StereoPair, TrackState, TrackUpdate)
from ..core.stamp_watch import StampWatch
from ..core.trace import PassTrace, TraceBuilder
from ..detection.protocol import Detection, Detector
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..second.estimate import SecondOpinion
from ..steadying.doubt import SpeedDoubt
from ..steadying.steadier import Steadier
from ..steadying.view_lag import ViewLag
from ..tracking.initialise import check_annotation
from ..tracking.lane_assigner import LaneAssigner
from ..tracking.protocol import CarriesOn, Refusal, SharesParticles, Tracker, TrackStart

_APART = 2.0  # times the distance of doubles: what a solution changes of a place is less
_SOLVED_S = 0.5  # of stamps, at most, until solutions are waited for
_INTERVALS = 5  # that tell the usual one, whatever is lost of the pairs
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
class _Beginning:
    """
    A track that is being started beside the pairs.

    :param front: that it is started at.
    :param search: that found it.
    :param begun: the track, and what it says of the pair of the search; None where it is none.
    """

    front: Detection
    search: Search
    begun: Future[Optional[tuple[Track, TrackUpdate]]]


@dataclass
class _State:
    """What a jump of time makes the pipeline forget."""

    tracks: list[Track] = field(default_factory=list)
    last_ns: Optional[int] = None
    started: set[int] = field(default_factory=set)  # numbers of the annotations used
    beginnings: list[_Beginning] = field(default_factory=list)  # to be taken
    doubles: list[Track] = field(default_factory=list)  # that end once they have said all
    intervals_s: deque[float] = field(default_factory=lambda: deque(maxlen=_INTERVALS))


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
    :param solving: solves for vehicles beside the pairs, where these come faster than vehicles are
        solved for; None has each reading wait for its solution.
    :param seed: seed of all randomness; each track draws from its own stream, so that tracks do
        not disturb one another.
    :param where: where the annotations come from, for errors.
    :raises InputError: an annotation outside the images, no lane.
    """

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath], config: TrackerConfig,
                 start: StartTracker, *, annotations: Sequence[InitialFront] = (),
                 detector: Optional[Detector] = None, steadier: Optional[Steadier] = None,
                 conclusions: Optional[Conclusions] = None,
                 solving: Optional[SolvingBeside] = None, seed: int = 0,
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
        self._solving = solving
        self._search = VehicleSearch(rig, detector, config.association)
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
        self._take_solved(pair.stamp_ns - _SOLVED_S * 1e9)
        dense = self._is_dense(pair.stamp_ns)
        state.last_ns = pair.stamp_ns
        self._check_size(pair)
        if self.stamp_watch.add(pair.stamp_ns):
            self._end_by_step()
        self._see_stamps()
        pair = self.view_lag.corrected(pair.triggered(self.config.trigger_tolerance_s))
        solving = self._solving if dense and not self.view_lag.concerned else None
        if solving is None:
            self._take_solved(math.inf)
        if self.steadier is not None:
            pair = self.steadier.steady(pair)
        self._start_annotated(pair)
        answered = solving is None or self._search.is_ready(pair.stamp_ns)
        searches = answered and self._search.is_due(pair.stamp_ns, hurried=hurried)
        take_turns([t for t in state.tracks if t.turn is None], pair.stamp_ns,
                   self._solve_interval_s(), hurried=hurried, dense=dense)
        if searches and not dense:
            self._search.expect(pair, state.tracks)
        share = self._share(max(len(state.tracks), 1))
        for track in state.tracks:
            if isinstance(track.tracker, SharesParticles) and track.turn is None:
                track.tracker.share(share)
        self._see_drift()
        if self.view_lag.concerned:  # what this pair shows of the lag counts, too
            readings = _nobody
        if solving is None:
            updates = self._followed(pair, share, readings)
        else:
            with solving.held_up():
                updates = self._followed_beside(solving, pair, share, readings)
        # Where others wait, so does what was found.
        takes = answered and (searches or not hurried)
        found = self._take_answer(pair, solving) if takes else []
        self._search.see_gone(pair, state.tracks)
        if searches and dense:
            self._search.begin(
                pair, state.tracks, [u for u in [*updates, *found] if u is not None],
                [(one.front, one.search.pair.stamp_ns) for one in state.beginnings])
        elif searches:
            found += self._detect(pair)
        if found:
            self._see_drift()
        updates += found
        seen = [u for u in updates if u is not None]
        self.view_lag.observe(pair, seen)
        # Who is being solved for tells the others what it says of the pair when it does.
        unsaid = {t.tracker.track for t in state.tracks if t.turn is not None}
        for track in state.tracks:
            track.add_others(pair.stamp_ns, [u for u in seen if u.track not in unsaid])
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
        self._drop_doubles(pair.stamp_ns, told)
        readings(self._readings(updates[t] for t in tracks if t.tracker.track not in told))
        return [updates[t] for t in tracks]

    def _followed_beside(self, solving: SolvingBeside, pair: StereoPair, share: int,
                         readings: TellReadings) -> list[Optional[TrackUpdate]]:
        """
        Tell where the vehicles are by what is known of them, and have the tracks fed the pair.

        :param solving: feeds it to those that have to solve for it.
        :param share: number of particles of each.
        :return: what each says, in their order.
        """
        tracks = list(self._state.tracks)
        updates = [self._carried(solving, track, pair, share) for track in tracks]
        self._drop_missing()
        self._drop_doubles(pair.stamp_ns)
        readings(self._readings(updates))
        return updates

    def _carried(self, solving: SolvingBeside, track: Track, pair: StereoPair, share: int
                 ) -> Optional[TrackUpdate]:
        """Return where a vehicle is by what is known of it; arguments as above."""
        tracker = track.tracker
        if track.ended:
            return None
        if not isinstance(tracker, CarriesOn):
            return self._update(track, pair, share)
        if track.turn is None:
            update = tracker.carry(pair)
            if update is not None:
                return self._taken(track, pair, share, track.gather(pair, update))
        expected = tracker.expected(pair)
        if track.turn is None:
            later = later_pairs()
            track.turn = Turn(
                pair, share, later, solving.submit(partial(track.solve, pair, later)))
        else:
            track.turn.later.append(pair)
        if expected is None:
            return None
        track.turn.expected[pair.stamp_ns] = expected
        if track.doubted or not track.confirmed or not is_sure(
                expected, self.config.visibility):
            expected = expected.unconfirmed()
        track.last = track.lanes.carried(expected)
        return track.last

    def _take_solved(self, wait_before_ns: float) -> None:
        """
        Take in what was worked on beside the pairs, as far as it is ready.

        :param wait_before_ns: pairs with earlier stamps are waited for.
        """
        state, solving = self._state, self._solving
        if solving is None:
            return
        for track in [*state.tracks, *state.doubles]:
            if track.turn is not None and (
                    track.turn.pair.stamp_ns < wait_before_ns or track.turn.said.done()):
                self._take_turn(track)
        for track in [t for t in state.doubles if t.turn is None]:
            state.doubles.remove(track)
            self._conclude(track, Reason.DUPLICATE)
        for one in list(state.beginnings):
            if one.search.pair.stamp_ns < wait_before_ns:
                solving.wait(one.begun)
            if one.begun.done():
                state.beginnings.remove(one)
                self._take_beginning(one)

    def _take_turn(self, track: Track) -> None:
        """Take in what a track is fed meanwhile, if it is; wait for it."""
        turn, solving, tracks = track.turn, self._solving, self._state.tracks
        if turn is None or solving is None:
            return
        solving.wait(turn.said)
        track.turn = None
        try:
            said = turn.said.result()
        except Exception as error:
            if track in tracks:
                tracks.remove(track)
            self._fail(error)
            return
        told = dict(turn.expected)
        for pair, update in said:
            self._taken(track, pair, turn.particles if pair is turn.pair else None, update)
            track.trace.add_others(pair.stamp_ns, turn.others.get(pair.stamp_ns, ()))
            if update is not None:
                told[pair.stamp_ns] = update
        for other in tracks:
            for stamp_ns, update in told.items():
                if other is not track:
                    other.add_others(stamp_ns, [update])
        if track in tracks and not (track.confirmed or track.detection is None or track.ended
                                    or all(holds(update) for _, update in said)):
            tracks.remove(track)  # as what misses a pair is

    def _take_beginning(self, one: _Beginning) -> None:
        """Take in a track that was started beside the pairs, if it was."""
        try:
            begun = one.begun.result()
        except Exception as error:
            self._fail(error)
            return
        if begun is not None:
            track, update = begun
            self._state.tracks.append(track)
            self._introduce(one.search, [update])
            one.search.seen.append(update)

    def _fail(self, error: Exception) -> None:
        """Account for what went wrong beside the pairs as for a pass that cannot be measured."""
        self._conclusions.add(partial(_raised, error))

    def _readings(self, updates: Iterable[Optional[TrackUpdate]]) -> list[TrackUpdate]:
        """Return those updates that are readings of tracks that go on."""
        going_on = {t.tracker.track for t in self._state.tracks if not t.ended}
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
                self._take_turn(track)
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
        return self._concluding | {
            t.tracker.track for t in [*self._state.tracks, *self._state.doubles]}

    def is_idle(self) -> bool:
        """
        Return whether another pipeline could go on from this one as this one would itself.

        No vehicle is in view or has just left it, and the views have one stamp.  What a detector
        remembers of the pairs so far does not count: another one begins without it, and may
        detect the next vehicle some pairs later or earlier.  Where only a search under way is
        left to tell, its answer is waited for: it tells the same in whichever process it is.
        """
        left_lately = self._search.has_lately_gone(self._state.last_ns)
        if self.open_tracks or self._state.beginnings or left_lately or self.view_lag.concerned:
            return False
        self._search.settle()
        return self._search.under_way is None or not self._search.under_way.found

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
        self._drop_beginnings()
        self._take_solved(math.inf)
        self._search.take()
        self._collect(everything=True)
        return self.concluded(everything=True)

    def reset(self) -> None:
        """Forget all tracks and the time, as after a jump back; numbers are not reused."""
        self._drop_beginnings()
        self._give_up(t.turn.said for t in [*self._state.tracks, *self._state.doubles]
                      if t.turn is not None)
        self._state = _State()
        self.stamp_watch.restart()
        self._search.reset()
        if self.steadier is not None:
            self.steadier.reset()

    def _drop_beginnings(self) -> None:
        """Give up tracks that are being started: nothing was told of them."""
        beginnings, self._state.beginnings = self._state.beginnings, []
        self._give_up([one.begun for one in beginnings])

    def _give_up(self, futures: Iterable[Future[Any]]) -> None:
        """Have done with what is worked on beside the pairs, whatever comes of it."""
        for future in futures:
            if self._solving is not None and not future.cancel():
                self._solving.wait(future)

    def _end_by_step(self) -> None:
        """
        End the passes of detected vehicles, for the clock has stepped: they are found anew.

        What a person marked is not found again, and is followed on, without a speed.
        """
        self._take_solved(math.inf)
        for track in list(self._state.tracks):
            track.clock_stepped = True
            if track.detection is not None:
                self._state.tracks.remove(track)
                if track.confirmed:
                    self._conclude(track)
        self._search.take()
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
                self._take_solved(math.inf)  # numbers are given in order
                track = self._start(front, pair, self._lane_of(front, pair), None, pair)
                if isinstance(track, Refusal):
                    raise track.error()
                self._state.tracks.append(track)

    def _start(self, front: InitialFront, pair: StereoPair, lane: LanePath,
               detection: Optional[Detection], newest: StereoPair) -> Union[Track, Refusal]:
        """
        Return a track, to be added to those there are; they share the particles there are.

        :param pair: the pair of the front.
        :param detection: what found it; None where a person annotated it.
        :param newest: the pair in hand.
        """
        number = self.next_track
        trace = PassTrace(
            number, self.seed, lane.name, front, self._share(len(self._state.tracks) + 1),
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
        return Track(
            tracker, LaneAssigner(self.lanes, self.config.verdict), detection, newest.stamp_ns,
            TraceBuilder(trace), size, second, lag_changes_s=self.view_lag.changes_s,
            stamp_std_s=trace.stamp_std_s,
            drift_rad=np.array((pair.motion or RigMotion()).drift_rad))

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
        return self._taken(track, pair, particles, track.feed(pair))

    def _taken(self, track: Track, pair: StereoPair, particles: Optional[int],
               update: Optional[TrackUpdate]) -> Optional[TrackUpdate]:
        """
        Take in what a track says of a pair; return it with the lane.

        :param particles: as for ``_update``.
        :param update: what its tracker says.
        """
        hurried = track.hurried
        if update is None:
            track.trace.add(pair, particles, None, hurried=hurried, stamp_std_s=track.stamp_std_s)
            return None
        track.doubted = not track.confirmed and self._is_doubtful(track, update)
        if track.doubted:
            update = update.unconfirmed()
        track.confirmed |= update.state is TrackState.CONFIRMED
        if not is_sure(update, self.config.visibility):
            update = update.unconfirmed()
        update = track.lanes.place(update)
        if track.last is None or update.stamp_ns >= track.last.stamp_ns or not holds(update):
            track.last = update
        track.trace.add(pair, particles, update, hurried=hurried, stamp_std_s=track.stamp_std_s)
        return update

    def _is_dense(self, stamp_ns: int) -> bool:
        """
        Return whether pairs come faster than vehicles are solved for: none waits for its search.

        Where readings wait for no solution, it is the usual interval that decides: else a pair
        that is lost would have all wait.
        """
        last_ns = self._state.last_ns
        if last_ns is None:
            return False
        intervals_s = self._state.intervals_s
        intervals_s.append((stamp_ns - last_ns) * 1e-9)
        usual_s = intervals_s[-1] if self._solving is None else float(np.median(intervals_s))
        return usual_s < self.config.effort.solve_interval_s

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
        search = self._search.of(pair, self._state.tracks)
        return [self._begin(front, search) for front in self._new(search)]

    def _take_answer(self, pair: StereoPair, solving: Optional[SolvingBeside]
                     ) -> list[Optional[TrackUpdate]]:
        """
        Start tracks at fronts that were detected in an earlier pair, and feed them this one.

        The earlier pair has the others' updates of then, and theirs has what was found in it.
        What has gone meanwhile is no vehicle as far as is known: nothing was told of it.

        :param solving: starts them beside the pairs, from the next one on; None starts them now.
        """
        search = self._search.take()
        if search is None:
            return []
        new = self._new(search)
        if solving is not None:
            self._state.beginnings += [_Beginning(front, search, solving.submit(
                partial(self._begun, front, search.pair), urgent=False)) for front in new]
            return []
        found = [u for front in new if (u := self._begin(front, search)) is not None]
        if not found:
            return []
        begun = {u.track for u in found}
        self._introduce(search, found)
        updates = [self._update(track, pair) for track in self._state.tracks
                   if track.tracker.track in begun]
        gone = begun - {u.track for u in updates if u is not None}
        self._state.tracks = [t for t in self._state.tracks if t.tracker.track not in gone]
        self._drop_missing()
        return updates

    def _introduce(self, search: Search, found: Sequence[TrackUpdate]) -> None:
        """Have the traces of the pair of a search tell of what was found in it."""
        begun = {u.track for u in found}
        for track in self._state.tracks:
            new = track.tracker.track in begun
            track.add_others(search.pair.stamp_ns, [*search.seen, *found] if new else found)

    def _new(self, search: Search) -> list[Detection]:
        """
        Return what is found in a pair and starts tracks.

        A doubted track that is there goes on, and is doubted by what its detector sees now.
        """
        new = []
        for front in self._search.answer(search):
            doubted = self._doubted_at(front, search)
            if doubted is None:
                new.append(front)
            elif doubted.last is not None and self._same_speed(doubted.last, front):
                doubted.detection, doubted.found_ns = front, search.pair.stamp_ns
        return new

    def _begin(self, front: Detection, search: Search) -> Optional[TrackUpdate]:
        """Start a track at a front, and return what it says of the pair of the search."""
        begun = self._begun(front, search.pair)
        if begun is None:
            return None
        self._state.tracks.append(begun[0])
        return begun[1]

    def _begun(self, front: Detection, pair: StereoPair
               ) -> Optional[tuple[Track, TrackUpdate]]:
        """
        Return a track begun where a front was first seen; where that fails, where it is now.

        :param pair: that it was found in.
        :return: with what it says of that; None where what looked like a front is none.
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
            updates = [self._update(track, one) for one in pairs]
            newest = updates[-1]
            if newest is not None and all(map(holds, updates)) and (
                    len(pairs) == 1 or self._same_speed(newest, front)):
                return track, newest
        return None

    def _doubted_at(self, front: Detection, search: Search) -> Optional[Track]:
        """Return the doubted track that holds what is detected in a pair; None where none does."""
        near_m, centre = self.config.association.same_vehicle_m, self._centre(front, search.pair)
        return next((track for track, at_m in search.doubted if track in self._state.tracks
                     and np.linalg.norm(at_m - centre) < near_m), None)

    def _centre(self, front: Union[InitialFront, Detection], pair: StereoPair) -> Array:
        """Return the middle (3,) of a front of a pair, left optical frame, m."""
        return self.rig.as_taken(pair.motion).triangulate(
            front.left_px.mean(axis=0), front.right_px.mean(axis=0))

    def _drop_missing(self) -> None:
        """End tracks that miss a pair before they are confirmed; a vehicle is found again."""
        self._state.tracks = [
            t for t in self._state.tracks if t.confirmed or t.detection is None
            or t.ended or holds(t.last) or t.turn is not None]

    def _drop_doubles(self, stamp_ns: int, told: Container[int] = ()) -> None:
        """
        End one of two tracks that hold the same vehicle.

        That which does not see it ends, and the younger if both do.

        :param stamp_ns: of the pair in hand.
        :param told: numbers of tracks whose readings of this pair are told, which stay: the other
            one was expected elsewhere.
        """
        tracks, near_m = self._state.tracks, self.config.association.same_vehicle_m
        held: list[Array] = []
        for track in sorted(tracks, key=lambda t: (t.tracker.track not in told,
                                                   not holds(t.last))):
            if track.last is None or track.ended:
                continue
            at = _place_m(track.last, stamp_ns)
            if track.detection is not None and any(
                    np.linalg.norm(at - other) < near_m for other in held):
                tracks.remove(track)
                if track.confirmed and track.turn is not None:
                    self._state.doubles.append(track)
                elif track.confirmed:
                    self._conclude(track, Reason.DUPLICATE)
            else:
                held.append(at)

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
        for track in [t for t in state.tracks if everything or t.ended]:
            state.tracks.remove(track)
            if track.confirmed or track.detection is None:
                self._conclude(track)
            elif track.ended and track.is_vehicle:
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


def _place_m(update: TrackUpdate, stamp_ns: int) -> Array:
    """Return where (3,) a vehicle is at a later stamp by its speed, left optical frame, m."""
    return update.position_m + ahead_m(update, stamp_ns) * update.axes[:, 0]


def _raised(error: Exception) -> PassResult:
    """Raise an error, where a pass is measured."""
    raise error
