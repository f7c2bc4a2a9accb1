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
from dataclasses import dataclass, field
from functools import partial
import math
from typing import Callable, Container, Iterable, Mapping, Optional, Sequence

import numpy as np

from .conclusions import AtOnce, Conclusions
from .intake import Intake
from .open_work import OpenWork
from .pass_end import PassEnd
from .roster import Begun, Roster
from .search import Search, VehicleSearch
from .solving import SolvingBeside
from .starting import Starter, StartTracker
from .time_doubt import TimeDoubt
from .track import holds, Track, with_unnoticed
from .turns import share_of, solve_interval_s, take_turns
from ..core.config import TrackerConfig
from ..core.errors import InputError
from ..core.passes import PassResult, Reason
from ..core.records import InitialFront, StereoPair, TrackState, TrackUpdate
from ..core.stamp_watch import StampWatch
from ..detection.protocol import Detection, Detector
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..steadying.doubt import SpeedDoubt
from ..steadying.steadier import Steadier
from ..steadying.view_lag import ViewLag
from ..tracking.initialise import check_annotation
from ..tracking.protocol import SharesParticles

_SOLVED_S = 0.5  # of stamps, at most, until solutions are waited for
_INTERVALS = 5  # that tell the usual one, whatever is lost of the pairs
_WORSE = 1.5  # times what a track takes its stamps for: twenty intervals tell it to a fifth

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


@dataclass
class _State:
    """What a jump of time makes the pipeline forget, beside its tracks."""

    last_ns: Optional[int] = None
    started: set[int] = field(default_factory=set)  # numbers of the annotations used
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
        self.detector, self.steadier = detector, steadier
        self._annotations = tuple(annotations)
        self._doubt = SpeedDoubt(rig, lanes, config)
        self._conclusions = AtOnce() if conclusions is None else conclusions
        self._search = VehicleSearch(rig, detector, config.association)
        self._concluding: set[int] = set()  # numbers of the tracks that it has
        self.view_lag, self.stamp_watch = ViewLag(rig), StampWatch()
        self._roster, self._intake = Roster(config.association.same_vehicle_m), Intake(config)
        self._starter = Starter(
            rig, self.lanes, config, start, seed, self._intake, self._roster, self.view_lag)
        self._open = OpenWork(solving, self._roster, self._intake, self._starter)
        self._state = _State()

    @property
    def next_track(self) -> int:
        """Return the number of the next track; who goes on from another pipeline sets its."""
        return self._starter.next_track

    @next_track.setter
    def next_track(self, number: int) -> None:
        self._starter.next_track = number

    @property
    def uneven_stamps_s(self) -> Optional[float]:
        """Return the 1-sigma that uneven stamps are taken to have, s; None where they are even."""
        return self._starter.stamp_std_s

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
        last_ns, roster = self._state.last_ns, self._roster
        if last_ns is not None and pair.stamp_ns <= last_ns:
            raise InputError('pairs', f'stamp of pair {pair.index}', pair.stamp_ns,
                             f'later than {last_ns}')
        self._take_open(pair.stamp_ns - _SOLVED_S * 1e9)
        dense = self._is_dense(pair.stamp_ns)
        pair = self._in_time(pair)
        beside = self._open.is_possible and dense and not self.view_lag.concerned
        if not beside:
            self._take_open()
        if self.steadier is not None:
            pair = self.steadier.steady(pair)
        self._start_annotated(pair)
        answered = not beside or self._search.is_ready(pair.stamp_ns)
        searches = answered and self._search.is_due(pair.stamp_ns, hurried=hurried)
        if searches and not dense:
            self._search.expect(pair, roster.tracks)
        particles = self._share_out(pair, hurried=hurried, dense=dense, beside=beside)
        self._see_drift()
        if self.view_lag.concerned:  # what this pair shows of the lag counts, too
            readings = _nobody
        follow = self._followed_beside if beside else self._followed
        updates = follow(pair, particles, readings)
        # Where others wait, so does what was found.
        takes = answered and (searches or not hurried)
        found = self._take_answer(pair, beside=beside) if takes else []
        self._search.see_gone(pair, roster.tracks)
        if searches and dense:
            self._search.begin(
                pair, roster.tracks, [u for u in [*updates, *found] if u is not None],
                self._open.beginnings)
        elif searches:
            found += self._detect(pair)
        if found:
            self._see_drift()
        seen = [u for u in [*updates, *found] if u is not None]
        changes_s = self.view_lag.changes_s
        self.view_lag.observe(pair, seen)
        if self.view_lag.changes_s > changes_s:
            seen = self._timed_anew(seen)
        self._tell_others(pair, seen)
        self._collect(everything=False)
        told = self._told(seen)
        self._keep_told(told)
        return Step(told, self.concluded())

    def _in_time(self, pair: StereoPair) -> StereoPair:
        """
        Take in the stamps of a pair; return it with that of the right view as it is known to be.

        :raises InputError: images of another size.
        """
        self._state.last_ns = pair.stamp_ns
        self._check_size(pair)
        if self.stamp_watch.add(pair.stamp_ns):
            self._end_by_step()
        self._see_stamps()
        return self.view_lag.corrected(pair.triggered(self.config.trigger_tolerance_s))

    def _timed_anew(self, seen: Sequence[TrackUpdate]) -> list[TrackUpdate]:
        """
        Have tracks of which no reading was told begin anew, for the right views are timed anew.

        :param seen: what the tracks say of the pair.
        :return: what they say of it now.
        """
        tracks, anew = self._roster.tracks, {}
        for k, track in enumerate(tracks):
            begun = self._starter.again(track)
            if begun is not None:
                tracks[k], update = begun
                anew[update.track] = update
        return [anew.get(update.track, update) for update in seen]

    def _keep_told(self, told: Iterable[TrackUpdate]) -> None:
        """Have tracks of which a reading is told go on as they are, whatever the views show."""
        readings = {u.track for u in told if u.state is TrackState.CONFIRMED}
        for track in self._roster.tracks:
            if track.tracker.track in readings:
                track.fed = None

    def _share_out(self, pair: StereoPair, *, hurried: bool, dense: bool, beside: bool) -> int:
        """
        Tell tracks whether it is their turn, and how many particles they have.

        What a track was told before it began what it is still at holds until that is over.  Where
        nobody waits for solutions, each has them as if it was alone: they queue by themselves, and
        the older one is, the less is known of the pairs since.

        :param pair: that they are to be fed.
        :param hurried: whether others wait.
        :param dense: whether pairs come faster than vehicles are solved for.
        :param beside: whether vehicles are solved for beside the pairs.
        :return: the particles of each.
        """
        tracks = self._roster.tracks
        free = [track for track in tracks if track.turn is None]
        take_turns(free, pair.stamp_ns, self._solve_interval_s(), hurried=hurried,
                   dense=dense and not beside)
        particles = share_of(
            self.config, 1 if beside and not hurried else max(len(tracks), 1))
        for track in free:
            if isinstance(track.tracker, SharesParticles):
                track.tracker.share(particles)
        return particles

    def _tell_others(self, pair: StereoPair, seen: Sequence[TrackUpdate]) -> None:
        """
        Have the traces of the tracks tell what the others say of a pair.

        Who is being solved for tells them when it is over.
        """
        unsaid = {t.tracker.track for t in self._roster.tracks if t.turn is not None}
        for track in self._roster.tracks:
            track.add_others(pair.stamp_ns, [u for u in seen if u.track not in unsaid])

    def _followed(self, pair: StereoPair, particles: int, readings: TellReadings
                  ) -> list[Optional[TrackUpdate]]:
        """
        Feed a pair to the tracks there are, and tell their readings.

        Those that are not solved for come first: their readings wait for no solution.  What is
        told is not taken back: of doubles the other one ends.

        :param particles: number of particles of each.
        :return: what each says, in their order.
        """
        feed, tracks = self._intake.feed, list(self._roster.tracks)
        interval_s = self._solve_interval_s()
        quick = [t for t in tracks if holds(t.last) and (
            t.hurried or t.waited_s(pair.stamp_ns) < interval_s)]
        updates = {t: feed(t, pair, particles) for t in quick}
        early: list[TrackUpdate] = []
        if 0 < len(quick) < len(tracks):
            early = [u for u in self._readings(updates.values()) if self._roster.is_apart(u)]
            readings(early)
        updates.update((t, feed(t, pair, particles)) for t in tracks if t not in updates)
        told = {u.track for u in early}
        self._roster.drop_missing()
        self._drop_doubles(pair.stamp_ns, told)
        readings(self._readings(updates[t] for t in tracks if t.tracker.track not in told))
        return [updates[t] for t in tracks]

    def _followed_beside(self, pair: StereoPair, particles: int, readings: TellReadings
                         ) -> list[Optional[TrackUpdate]]:
        """
        Tell where the vehicles are by what is known of them, and have the tracks fed the pair.

        Arguments and result are those of ``_followed``.
        """
        with self._open.held_up():
            updates = self._open.follow(pair, particles)
            self._roster.drop_missing()
            self._drop_doubles(pair.stamp_ns)
            readings(self._readings(updates))
        return updates

    def _take_open(self, wait_before_ns: float = math.inf) -> None:
        """
        Take in what was worked on beside the pairs, as far as it is ready.

        :param wait_before_ns: work for pairs with earlier stamps is waited for.
        """
        ended = self._open.take(wait_before_ns)
        for track in ended.doubles:
            self._conclude(track, Reason.DUPLICATE)
        for error in ended.errors:  # as for a pass that cannot be measured
            self._conclusions.add(partial(_raised, error))

    def _readings(self, updates: Iterable[Optional[TrackUpdate]]) -> list[TrackUpdate]:
        """Return those updates that are readings of tracks that go on."""
        going_on = {t.tracker.track for t in self._roster.tracks if not t.ended}
        return [u for u in self._told(updates)
                if u.state is TrackState.CONFIRMED and u.track in going_on]

    def _see_stamps(self) -> None:
        """Have the tracks take in how uneven the stamps are."""
        self._starter.stamp_std_s = uneven_s = self._times.uneven_s()
        for track in self._roster.tracks:
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
            for track in self._roster.tracks:
                track.see_drift(self.steadier.drift.corrected_rad)

    def _told(self, updates: Iterable[Optional[TrackUpdate]]) -> list[TrackUpdate]:
        """Return the updates of tracks that there are, with the doubt of their times and rig."""
        tracks = {track.tracker.track: track for track in self._roster.tracks}
        times = self._times
        told = [times.told(u, tracks[u.track])
                for u in updates if u is not None and u.track in tracks]
        if self.steadier is not None:
            told = [self._doubt.update(u, self.steadier, tracks[u.track].drift_change_rad)
                    for u in told]
        return [with_unnoticed(u, self.config.visibility) for u in told]

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
        return self._concluding | self._open.double_numbers | {
            t.tracker.track for t in self._roster.tracks}

    def is_idle(self) -> bool:
        """
        Return whether another pipeline could go on from this one as this one would itself.

        No vehicle is in view or has just left it, and the views have one stamp.  What a detector
        remembers of the pairs so far does not count: another one begins without it, and may
        detect the next vehicle some pairs later or earlier.  Where only a search under way is
        left to tell, its answer is waited for: it tells the same in whichever process it is.
        """
        left_lately = self._search.has_lately_gone(self._state.last_ns)
        if self.open_tracks or self._open.beginnings or left_lately or self.view_lag.concerned:
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
        self._open.drop_beginnings()
        self._take_open()
        self._search.take()
        self._collect(everything=True)
        return self.concluded(everything=True)

    def reset(self) -> None:
        """Forget all tracks and the time, as after a jump back; numbers are not reused."""
        self._open.drop()
        self._roster.tracks, self._state = [], _State()
        self.stamp_watch.restart()
        self._search.reset()
        if self.steadier is not None:
            self.steadier.reset()

    def _end_by_step(self) -> None:
        """
        End the passes of detected vehicles, for the clock has stepped: they are found anew.

        What a person marked is not found again, and is followed on, without a speed.
        """
        self._take_open()
        for track in list(self._roster.tracks):
            track.clock_stepped = True
            if track.detection is not None:
                self._roster.tracks.remove(track)
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
                self._take_open()  # numbers are given in order
                self._roster.tracks.append(self._starter.at_mark(front, pair))

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
        usual_s = float(np.median(intervals_s)) if self._open.is_possible else intervals_s[-1]
        return usual_s < self.config.effort.solve_interval_s

    def _solve_interval_s(self) -> float:
        """Return the time between two solutions of a track, which share the effort there is."""
        return solve_interval_s(self.config, max(len(self._roster.tracks), 1))

    def _detect(self, pair: StereoPair) -> list[Optional[TrackUpdate]]:
        """Start tracks at fronts that are detected; return what they say of the pair."""
        search = self._search.of(pair, self._roster.tracks)
        fronts = self._starter.new(search, self._search.answer(search))
        return [update for _, update in self._begun(fronts, search)]

    def _take_answer(self, pair: StereoPair, *, beside: bool) -> list[Optional[TrackUpdate]]:
        """
        Start tracks at fronts that were detected in an earlier pair, and feed them this one.

        The earlier pair has the others' updates of then, and theirs has what was found in it.
        What has gone meanwhile is no vehicle as far as is known: nothing was told of it.

        :param beside: whether they are begun beside the pairs, and fed from the next one on.
        """
        search = self._search.take()
        if search is None:
            return []
        fronts = self._starter.new(search, self._search.answer(search))
        if beside:
            self._open.begin(fronts, search)
            return []
        begun = self._begun(fronts, search)
        if not begun:
            return []
        self._roster.introduce(search, begun)
        updates = {track: self._intake.feed(track, pair) for track, _ in begun}
        self._roster.tracks = [t for t in self._roster.tracks
                               if t not in updates or updates[t] is not None]
        self._roster.drop_missing()
        return list(updates.values())

    def _begun(self, fronts: Iterable[Detection], search: Search) -> list[Begun]:
        """Start tracks at fronts that a search has found; return those that could be."""
        begun = []
        for front in fronts:
            one = self._starter.at(front, search.pair)
            if one is not None:
                self._roster.tracks.append(one[0])
                begun.append(one)
        return begun

    def _drop_doubles(self, stamp_ns: int, told: Container[int] = ()) -> None:
        """
        End one of two tracks that hold the same vehicle, once it has said all.

        The parameters are those of :meth:`.roster.Roster.drop_doubles`.
        """
        for track in self._roster.drop_doubles(stamp_ns, told):
            if track.turn is not None:
                self._open.end_later(track)
            else:
                self._conclude(track, Reason.DUPLICATE)

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
        tracks = self._roster.tracks
        for track in [t for t in tracks if everything or t.ended]:
            tracks.remove(track)
            if track.confirmed or track.detection is None:
                self._conclude(track)
            elif track.ended and track.is_vehicle:
                self._conclude(track, Reason.TOO_FEW_PAIRS)

    def _conclude(self, track: Track, reason: Optional[Reason] = None) -> None:
        """
        Have the whole pass of a track measured, which is over.

        :param reason: why it is rejected whatever comes out; None where it is not.
        """
        lag_share = 0.0 if track.last is None else self._times.lag_share(track, track.last)
        rig_shares = {} if self.steadier is None else self._doubt.shares(
            self.steadier, track.drift_change_rad)
        track.fed = None  # or its images would go with it to where it is measured
        self._concluding.add(track.tracker.track)
        self._conclusions.add(
            PassEnd(
                track, self.lanes, self.config, self._doubt, lag_share, rig_shares, reason),
            partial(self._concluding.discard, track.tracker.track))


def _raised(error: Exception) -> PassResult:
    """Raise an error, where a pass is measured."""
    raise error
