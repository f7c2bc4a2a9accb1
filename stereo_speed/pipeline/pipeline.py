# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The one pipeline: pairs in, track updates and pass results out.

The live nodes, ``replay`` and the tests all run this object, so the same pairs and seed give the
same speeds everywhere.  Live results can differ in two cases: pairs come so fast that vehicles are
solved for in a thread beside them, or a machine that is too slow has pairs hurried or skipped.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
import math
from typing import Callable, Iterable, Mapping, Optional, Sequence

import numpy as np

from .conclusions import AtOnce, Conclusions
from .endings import Endings
from .intake import Intake
from .open_work import OpenWork
from .roster import Begun, Roster
from .search import Search, VehicleSearch
from .solving import SolvingBeside
from .starting import Starter, StartTracker
from .stream_doubt import StreamDoubt
from .track import holds
from .turns import share_of, solve_interval_s, take_turns
from ..core.errors import InputError
from ..core.passes import PassResult, Reason
from ..core.records import InitialFront, StereoPair, TrackState, TrackUpdate
from ..core.tracker_config import TrackerConfig
from ..detection.protocol import Detection, Detector
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..steadying.steadier import Steadier
from ..tracking.initialise import check_annotation
from ..tracking.protocol import SharesParticles

_SOLVED_S = 0.5  # age, by stamps, from which an unfinished solution is waited for
_INTERVALS = 5  # number of latest intervals whose median is the usual one, despite lost pairs

TellReadings = Callable[[Sequence[TrackUpdate]], object]


def _nobody(readings: Sequence[TrackUpdate]) -> None:
    """Ignore readings."""


@dataclass(frozen=True)
class Step:
    """
    The results of one pair.

    :param updates: those of the tracks that were fed it.
    :param passes: those measured since the last pair.
    """

    updates: list[TrackUpdate]
    passes: list[PassResult]


@dataclass(frozen=True)
class _Pace:
    """
    How a pair is processed.

    :param hurried: whether other pairs are waiting.
    :param dense: whether pairs come faster than vehicles are solved for.
    :param beside: whether vehicles are solved for in the thread beside the pairs.
    """

    hurried: bool
    dense: bool
    beside: bool


@dataclass
class _State:
    """State, besides the tracks, that is discarded when time jumps back."""

    last_ns: Optional[int] = None
    started: set[int] = field(default_factory=set)  # numbers of the annotations used
    intervals_s: deque[float] = field(default_factory=lambda: deque(maxlen=_INTERVALS))


class SpeedPipeline:
    """
    Starts a track at each annotated or detected front, feeds it the pairs, collects its result.

    ``assembly.make_pipeline`` makes one from names and parameters.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters that all trackers share.
    :param start: starts a tracker.
    :param annotations: fronts that a person annotated.
    :param detector: finds further vehicles; None to measure annotated ones only.
    :param steadier: estimates how the rig has rotated in each pair; None for a rigid mount.
    :param conclusions: measures passes that are over; None to measure them at once.
    :param solving: thread that solves for vehicles where pairs come faster than
        ``effort.solve_interval_s``; None to make each reading wait for its solution.
    :param seed: seed of all randomness; each track draws from its own stream, so that tracks do
        not affect one another.
    :param where: source of the annotations, for error messages.
    :raises InputError: an annotation outside the images, or no lane.
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
        self.rig, self.lanes, self.config, self.detector = rig, dict(lanes), config, detector
        self._annotations = tuple(annotations)
        self._search = VehicleSearch(rig, detector, config.association, self.lanes)
        self._roster = Roster(config.association.same_vehicle_m)
        self.doubt = StreamDoubt(rig, self.lanes, config, self._roster, steadier)
        self._intake = Intake(rig, config, self._roster)
        self._starter = Starter(
            rig, self.lanes, config, start, seed, self._intake, self._roster, self.doubt.lag,
            self.doubt.rest_std_rad)
        self._open = OpenWork(solving, self._roster, self._intake, self._starter)
        self._endings = Endings(self._roster, self._open, self.doubt,
                                AtOnce() if conclusions is None else conclusions)
        self._state = _State()

    @property
    def next_track(self) -> int:
        """Return the number of the next track; set it to continue another pipeline's numbers."""
        return self._starter.next_track

    @next_track.setter
    def next_track(self, number: int) -> None:
        self._starter.next_track = number

    @property
    def uneven_stamps_s(self) -> Optional[float]:
        """Return the 1-sigma assumed for uneven stamps, s; None where they are even."""
        return self._starter.stamp_std_s

    def process(self, pair: StereoPair, hurried: bool = False,
                readings: TellReadings = _nobody) -> Step:
        """
        Process the next pair.

        :param hurried: whether to do less because other pairs are waiting: vehicles are followed,
            but at most one is solved for, if its last solution is old, and new ones are searched
            for only after a while without a search.
        :param readings: called once or twice with the readings that are known before the search
            for new vehicles; the returned step contains them too.
        :raises InputError: the stamp is not later than that of the last pair.
        """
        self._check_order(pair)
        self._take_open(pair.stamp_ns - _SOLVED_S * 1e9)
        dense = self._is_dense(pair.stamp_ns)
        pair = self._in_time(pair)
        beside = self._open.is_possible and dense and not self.doubt.lag.concerned
        if not beside:
            self._take_open()
        pair = self.doubt.known(pair)
        self._start_annotated(pair)
        updates = self._updates(pair, _Pace(hurried, dense, beside), readings)
        updates = self._with_lag(pair, updates)
        self._tell_others(pair, updates)
        self._endings.collect(everything=False)
        published = self.doubt.widened(updates)
        self._rule_out_restarts(published)
        return Step(published, self.concluded())

    def _updates(self, pair: StereoPair, pace: _Pace, readings: TellReadings
                 ) -> list[TrackUpdate]:
        """
        Follow the vehicles into a pair and search for new ones; return the tracks' updates for it.

        :param readings: as for :meth:`process`.
        """
        search = self._search
        answered = not pace.beside or search.is_ready(pair.stamp_ns)
        searches = answered and search.is_due(pair.stamp_ns, hurried=pace.hurried)
        if searches and not pace.dense:
            search.expect(pair, self._roster.tracks)
        particles = self._share_out(pair, pace)
        self.doubt.see_drift()
        if self.doubt.lag.concerned:  # readings need the lag estimate that includes this pair
            readings = _nobody
        follow = self._followed_beside if pace.beside else self._followed
        updates = follow(pair, particles, readings)
        # In a hurried pair, detections are left for a later one.
        takes = answered and (searches or not pace.hurried)
        new = self._take_answer(pair, beside=pace.beside) if takes else []
        search.see_gone(pair, self._roster.tracks)
        if searches and pace.dense:
            search.begin(pair, self._roster.tracks, _known([*updates, *new]),
                         self._open.beginnings)
        elif searches:
            new += self._detect(pair)
        if new:
            self.doubt.see_drift()
        return _known([*updates, *new])

    def _with_lag(self, pair: StereoPair, updates: list[TrackUpdate]) -> list[TrackUpdate]:
        """
        Estimate the time between the views from the tracks' updates for a pair.

        :return: the updates, those of restarted tracks replaced where the correction of right
            stamps has changed.
        """
        lag = self.doubt.lag
        changes_s = lag.changes_s
        lag.observe(pair, updates)
        return self._restart(updates) if lag.changes_s > changes_s else updates

    def _check_order(self, pair: StereoPair) -> None:
        last_ns = self.doubt.stamps.last_ns
        if last_ns is not None and pair.stamp_ns <= last_ns:
            raise InputError('pairs', f'stamp of pair {pair.index}', pair.stamp_ns,
                             f'later than {last_ns}')

    def _in_time(self, pair: StereoPair) -> StereoPair:
        """
        Register the stamps of a pair; return it with the best known stamp of the right view.

        :raises InputError: the images do not have the calibrated size.
        """
        self._state.last_ns = pair.stamp_ns
        doubt = self.doubt
        if doubt.stamps.add(pair.stamp_ns):
            self._end_by_step()
        self.rig.check_sizes(pair)
        self._starter.stamp_std_s = doubt.see_stamps()
        gaps = tuple(doubt.stamps.gaps)
        step = doubt.clock_step(gaps)
        if step is not None:
            doubt.stamps.take_for_step(step)
            self._end_by_step()
        doubt.see_gaps(gaps)
        return doubt.lag.corrected(pair.triggered(self.config.trigger_tolerance_s))

    def _restart(self, seen: Sequence[TrackUpdate]) -> list[TrackUpdate]:
        """
        Restart the tracks without a published reading, as the correction of right stamps changed.

        :param seen: the tracks' updates for the pair.
        :return: the same, with those of the restarted tracks replaced.
        """
        tracks, restarted = self._roster.tracks, {}
        for k, track in enumerate(tracks):
            begun = self._starter.restarted(track)
            if begun is not None:
                tracks[k], update = begun
                restarted[update.track] = update
        return [restarted.get(update.track, update) for update in seen]

    def _rule_out_restarts(self, published: Iterable[TrackUpdate]) -> None:
        """Rule out that tracks with a published reading are restarted by a later correction."""
        readings = {u.track for u in published if u.state is TrackState.CONFIRMED}
        for track in self._roster.tracks:
            if track.tracker.track in readings:
                track.restart_pairs = None

    def _share_out(self, pair: StereoPair, pace: _Pace) -> int:
        """
        Tell tracks whether they may solve for a pair, and how many particles they have.

        A track that is still being solved for keeps what it was told before.  Where no reading
        waits for a solution, each track is treated as if it were alone: solutions queue in their
        thread anyway, and delaying them would only make the predictions older.

        :param pair: the pair that they are to be fed next.
        :return: number of particles of each track.
        """
        tracks = self._roster.tracks
        free = [track for track in tracks if track.turn is None]
        take_turns(free, pair.stamp_ns, self._solve_interval_s(), hurried=pace.hurried,
                   dense=pace.dense and not pace.beside)
        particles = share_of(
            self.config, 1 if pace.beside and not pace.hurried else max(len(tracks), 1))
        for track in free:
            if isinstance(track.tracker, SharesParticles):
                track.tracker.share(particles)
        return particles

    def _tell_others(self, pair: StereoPair, seen: Sequence[TrackUpdate]) -> None:
        """
        Add to each track's trace what the other tracks report for a pair.

        Updates of a track that is still being solved for are added when its turn is over.
        """
        solving = {t.tracker.track for t in self._roster.tracks if t.turn is not None}
        for track in self._roster.tracks:
            track.add_others(pair.stamp_ns, [u for u in seen if u.track not in solving])

    def _followed(self, pair: StereoPair, particles: int, readings: TellReadings
                  ) -> list[Optional[TrackUpdate]]:
        """
        Feed a pair to all tracks, and publish their readings.

        Tracks that need no solution come first, so that their readings do not wait for one.  A
        published reading is not withdrawn: of two tracks on one vehicle, the other one ends.

        :param particles: number of particles of each track.
        :return: the update of each track, in the order of the roster.
        """
        feed, tracks = self._intake.feed, list(self._roster.tracks)
        interval_s = self._solve_interval_s()
        quick = [t for t in tracks if holds(t.last) and (
            t.hurried or t.waited_s(pair.stamp_ns) < interval_s)]
        updates = {t: feed(t, pair, particles) for t in quick}
        early: list[TrackUpdate] = []
        if 0 < len(quick) < len(tracks):
            early = [u for u in self.doubt.readings(updates.values()) if self._roster.is_apart(u)]
            readings(early)
        updates.update((t, feed(t, pair, particles)) for t in tracks if t not in updates)
        published = {u.track for u in early}
        self._roster.drop_missing()
        self._endings.drop_doubles(pair.stamp_ns, published)
        readings(self.doubt.readings(
            updates[t] for t in tracks if t.tracker.track not in published))
        return [updates[t] for t in tracks]

    def _followed_beside(self, pair: StereoPair, particles: int, readings: TellReadings
                         ) -> list[Optional[TrackUpdate]]:
        """
        Publish predicted readings, and have the tracks fed the pair beside.

        Arguments and result are those of ``_followed``.
        """
        with self._open.held_up():
            updates = self._open.follow(pair, particles)
            self._roster.drop_missing()
            self._endings.drop_doubles(pair.stamp_ns)
            readings(self.doubt.readings(updates))
        return updates

    def _take_open(self, wait_before_ns: float = math.inf) -> None:
        """
        Collect the finished results of the thread beside the pairs.

        :param wait_before_ns: work for pairs with earlier stamps is waited for.
        """
        ended = self._open.take(wait_before_ns)
        for track in ended.doubles:
            self._endings.conclude(track, Reason.DUPLICATE)
        self._endings.fail(ended.errors)

    def concluded(self, *, everything: bool = False) -> list[PassResult]:
        """
        Return the passes that have been measured since the last call.

        :param everything: whether to wait for all passes that are over.
        """
        return self._endings.done(everything=everything)

    @property
    def open_tracks(self) -> set[int]:
        """Return the numbers of the tracks whose passes may still come."""
        return self._endings.concluding | self._open.double_numbers | {
            t.tracker.track for t in self._roster.tracks}

    def is_idle(self) -> bool:
        """
        Return whether another pipeline could continue from here with the same results.

        This requires that no vehicle is in view or has just left it, and that the views have one
        stamp.  The detector's memory of earlier pairs is ignored: a new detector starts without
        it, and may detect the next vehicle some pairs later or earlier.  If only a search under
        way is left, its answer is waited for, so that the result does not depend on its timing.
        """
        left_lately = self._search.has_lately_gone(self._state.last_ns)
        if self.open_tracks or self._open.beginnings or left_lately or self.doubt.lag.concerned:
            return False
        self._search.settle()
        return self._search.under_way is None or not self._search.under_way.found

    def go_on_from(self, other: SpeedPipeline) -> None:
        """Take over track numbers, the state of the rig and stamps from an idle pipeline."""
        self.next_track, self._state.last_ns = other.next_track, other._state.last_ns
        self.doubt.go_on_from(other.doubt)

    def look(self, pair: StereoPair) -> None:
        """Update stamps and the state of the rig from a pair that is already measured."""
        self.doubt.stamps.add(pair.stamp_ns)
        self._state.last_ns = pair.stamp_ns
        self.doubt.known(pair.triggered(self.config.trigger_tolerance_s))

    def pass_over(self, stamp_ns: int) -> None:
        """
        Register the stamp of a pair that is not measured.

        So the pace of the stamps stays known, and no clock could have been set in a gap between
        measured pairs without being noticed.

        :param stamp_ns: its stamp, ns; ignored if it is not later than the last one.
        """
        stamps = self.doubt.stamps
        if (stamps.last_ns is None or stamp_ns > stamps.last_ns) and stamps.add(stamp_ns):
            self._end_by_step()

    def finish(self) -> list[PassResult]:
        """
        End all tracks at the end of the stream, and return their results.

        A front found in the last pair was not followed into another one, so it is discarded.
        """
        self._open.drop_beginnings()
        self._take_open()
        self._search.take()
        self._endings.collect(everything=True)
        return self.concluded(everything=True)

    def reset(self) -> None:
        """Discard all tracks and times, as after a jump back in time; numbers are not reused."""
        self._open.drop()
        self._roster.tracks, self._state = [], _State()
        self.doubt.restart()
        self._search.reset()

    def _end_by_step(self) -> None:
        """
        End the passes of detected vehicles after a step of the clock: they are detected again.

        An annotated vehicle would not be, so it is followed on, without a speed.
        """
        self._take_open()
        for track in list(self._roster.tracks):
            track.clock_stepped = True
            if track.detection is not None:
                self._roster.tracks.remove(track)
                if track.confirmed:
                    self._endings.conclude(track)
        self._search.take()
        if self.detector is not None:
            self.detector.reset()  # its earlier pairs have stamps from before the step

    def _start_annotated(self, pair: StereoPair) -> None:
        """
        Start a track at each front that is annotated in a pair.

        :raises InputError: the views do not agree on a front there.
        """
        for number, front in enumerate(self._annotations):
            if front.frame == pair.index and number not in self._state.started:
                self._state.started.add(number)
                self._take_open()  # so that tracks are numbered in order
                self._roster.tracks.append(self._starter.at_mark(front, pair))

    def _is_dense(self, stamp_ns: int) -> bool:
        """
        Return whether pairs come faster than vehicles are solved for.

        If so, no pair waits for its search.  Where readings do not wait for solutions, the median
        interval decides; otherwise one lost pair would make everything wait.
        """
        last_ns = self._state.last_ns
        if last_ns is None:
            return False
        intervals_s = self._state.intervals_s
        intervals_s.append((stamp_ns - last_ns) * 1e-9)
        usual_s = float(np.median(intervals_s)) if self._open.is_possible else intervals_s[-1]
        return usual_s < self.config.effort.solve_interval_s

    def _solve_interval_s(self) -> float:
        """Return the time between two solutions of a track, as all tracks share the effort."""
        return solve_interval_s(self.config, max(len(self._roster.tracks), 1))

    def _detect(self, pair: StereoPair) -> list[Optional[TrackUpdate]]:
        """Detect fronts and start tracks at them; return their updates for the pair."""
        search = self._search.of(pair, self._roster.tracks)
        fronts = self._starter.new(search, self._search.answer(search))
        return [update for _, update in self._start_tracks(fronts, search)]

    def _take_answer(self, pair: StereoPair, *, beside: bool) -> list[Optional[TrackUpdate]]:
        """
        Start tracks at fronts that were detected in an earlier pair, and feed them this one.

        Traces of new and existing tracks get each other's updates for the earlier pair.  A new
        track that misses this pair is discarded, as nothing has been published of it.

        :param beside: whether they are started in the thread beside the pairs, and fed from the
            next pair on.
        """
        search = self._search.take()
        if search is None:
            return []
        fronts = self._starter.new(search, self._search.answer(search))
        if beside:
            self._open.begin(fronts, search)
            return []
        begun = self._start_tracks(fronts, search)
        if not begun:
            return []
        self._roster.introduce(search, begun)
        updates = {track: self._intake.feed(track, pair) for track, _ in begun}
        self._roster.tracks = [t for t in self._roster.tracks
                               if t not in updates or updates[t] is not None]
        self._roster.drop_missing()
        return list(updates.values())

    def _start_tracks(self, fronts: Iterable[Detection], search: Search) -> list[Begun]:
        """Start tracks at fronts that a search has found; return those that started."""
        begun = []
        for front in fronts:
            one = self._starter.at(front, search.pair)
            if one is not None:
                self._roster.tracks.append(one[0])
                begun.append(one)
        return begun


def _known(updates: Iterable[Optional[TrackUpdate]]) -> list[TrackUpdate]:
    """Return the updates of the tracks that have one."""
    return [update for update in updates if update is not None]
