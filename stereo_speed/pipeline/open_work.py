# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Work in progress beside the pairs: solutions that readings do not wait for, and new tracks.

A track that must solve for a pair does so in another thread while further pairs come; this is its
turn.  Until the result is taken in, updates give the predicted place of the vehicle.  Tracks are
started in that thread too.  A track found to be a duplicate during its turn ends after the turn.
Results are taken in between two pairs, by the thread of the pairs, so that no track changes while
a pair is processed.
"""
from __future__ import annotations

from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import Any, Iterable, Optional, Sequence

from .intake import Intake
from .roster import Begun, Roster
from .search import Search
from .solving import later_pairs, SolvingBeside, Turn
from .starting import Starter
from .track import holds, Track
from ..core.records import StereoPair, TrackUpdate
from ..detection.protocol import Detection
from ..tracking.protocol import CarriesOn


@dataclass(frozen=True, eq=False)
class _Beginning:
    """
    A track that is being started.

    :param front: the front that it starts from.
    :param search: the search that found the front.
    :param begun: the track, and its update for the pair of the search; None if it does not start.
    """

    front: Detection
    search: Search
    begun: Future[Optional[Begun]]


@dataclass(frozen=True)
class Ended:
    """
    What ended when finished work was taken in.

    :param doubles: duplicate tracks whose turns are over.
    :param errors: errors of the work; each has ended a track.
    """

    doubles: Sequence[Track]
    errors: Sequence[Exception]


class OpenWork:
    """
    See the module's docstring.

    :param solving: thread that does the work; None where each pair waits for its solutions, so
        that no work is ever open.
    :param roster: the tracks; new ones are added to it, failed ones removed.
    :param intake: handles updates of trackers.
    :param starter: starts tracks.
    """

    def __init__(self, solving: Optional[SolvingBeside], roster: Roster, intake: Intake,
                 starter: Starter) -> None:
        self._solving, self._roster, self._intake = solving, roster, intake
        self._starter = starter
        self._beginnings: list[_Beginning] = []
        self._doubles: list[Track] = []

    @property
    def is_possible(self) -> bool:
        """Return whether there is a thread to do the work."""
        return self._solving is not None

    @property
    def double_numbers(self) -> set[int]:
        """Return the numbers of duplicate tracks that have left the roster and are yet to end."""
        return {track.tracker.track for track in self._doubles}

    @property
    def beginnings(self) -> list[tuple[Detection, int]]:
        """Return the fronts at which tracks are being started, with the stamps of their pairs."""
        return [(one.front, one.search.pair.stamp_ns) for one in self._beginnings]

    def held_up(self) -> AbstractContextManager[None]:
        """Return a context that pauses the work while a pair is processed."""
        return self._worker.held_up()

    def follow(self, pair: StereoPair, particles: int) -> list[Optional[TrackUpdate]]:
        """
        Have the tracks fed a pair, at once or in the thread beside.

        :param particles: number of particles of each track.
        :return: the update, or its prediction, of each track, in the order of the roster.
        """
        return [self._carried(track, pair, particles) for track in self._roster.tracks]

    def begin(self, fronts: Iterable[Detection], search: Search) -> None:
        """Have tracks started at fronts that a search has found."""
        self._beginnings += [_Beginning(front, search, self._worker.submit(
            partial(self._starter.at, front, search.pair), urgent=False)) for front in fronts]

    def end_later(self, double: Track) -> None:
        """Take over a duplicate track that has left the roster during its turn."""
        self._doubles.append(double)

    def take(self, wait_before_ns: float) -> Ended:
        """
        Take in finished work.

        :param wait_before_ns: work for pairs with earlier stamps is waited for.
        """
        errors: list[Exception] = []
        for track in [*self._roster.tracks, *self._doubles]:
            turn = track.turn
            if turn is not None and (
                    turn.pair.stamp_ns < wait_before_ns or turn.fed.done()):
                self._worker.wait(turn.fed)
                self._take_turn(track, turn, errors)
        ended = [track for track in self._doubles if track.turn is None]
        self._doubles = [track for track in self._doubles if track.turn is not None]
        for one in list(self._beginnings):
            if one.search.pair.stamp_ns < wait_before_ns:
                self._worker.wait(one.begun)
            if one.begun.done():
                self._beginnings.remove(one)
                self._take_beginning(one, errors)
        return Ended(ended, errors)

    def drop_beginnings(self) -> None:
        """Drop tracks that are being started; none of their readings are published yet."""
        beginnings, self._beginnings = self._beginnings, []
        self._give_up(one.begun for one in beginnings)

    def drop(self) -> None:
        """Drop all open work."""
        self.drop_beginnings()
        self._give_up(track.turn.fed for track in [*self._roster.tracks, *self._doubles]
                      if track.turn is not None)
        self._doubles = []

    @property
    def _worker(self) -> SolvingBeside:
        """Return the thread that does the work; called only where there is one."""
        if self._solving is None:
            raise RuntimeError('no thread works beside the pairs')
        return self._solving

    def _carried(self, track: Track, pair: StereoPair, particles: int) -> Optional[TrackUpdate]:
        """Return the update or prediction of one track; arguments as for :meth:`follow`."""
        tracker = track.tracker
        if track.ended:
            return None
        if not isinstance(tracker, CarriesOn):
            return self._intake.feed(track, pair, particles)
        if track.turn is None:
            update = tracker.carry(pair)
            if update is not None:
                return self._intake.take(track, pair, particles, track.gather(pair, update))
        expected = tracker.expected(pair)
        if track.turn is None:
            later = later_pairs()
            track.turn = Turn(pair, particles, later, self._worker.submit(
                partial(track.solve, pair, later)))
        else:
            track.turn.later.append(pair)
        if expected is None:
            return None
        track.turn.expected[pair.stamp_ns] = expected
        return self._intake.expect(track, pair, expected)

    def _take_turn(self, track: Track, turn: Turn, errors: list[Exception]) -> None:
        """Take in a track's updates for the pairs of its finished turn."""
        track.turn, roster = None, self._roster
        try:
            fed = turn.fed.result()
        except Exception as error:
            if track in roster.tracks:
                roster.tracks.remove(track)
            errors.append(error)
            return
        reported = dict(turn.expected)
        for pair, update in fed:
            self._intake.take(
                track, pair, turn.particles if pair is turn.pair else None, update)
            track.trace.add_others(pair.stamp_ns, turn.others.get(pair.stamp_ns, ()))
            if update is not None:
                reported[pair.stamp_ns] = update
        if turn.stamp_std_s is not None:
            track.see_stamps(turn.stamp_std_s)
        for other in roster.tracks:
            for stamp_ns, update in reported.items():
                if other is not track:
                    other.add_others(stamp_ns, [update])
        if track in roster.tracks and not (
                track.confirmed or track.detection is None or track.ended
                or all(holds(update) for _, update in fed)):
            roster.tracks.remove(track)  # as any unconfirmed track that misses a pair

    def _take_beginning(self, one: _Beginning, errors: list[Exception]) -> None:
        """Add a started track to the roster, or the error of starting it to ``errors``."""
        try:
            begun = one.begun.result()
        except Exception as error:
            errors.append(error)
            return
        if begun is not None:
            self._roster.tracks.append(begun[0])
            self._roster.introduce(one.search, [begun])
            one.search.seen.append(begun[1])

    def _give_up(self, futures: Iterable[Future[Any]]) -> None:
        """Cancel work, or wait for it where it has begun, and ignore its results."""
        for future in futures:
            if not future.cancel():
                self._worker.wait(future)
