# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Readings that wait for no solution, and the work that they do not wait for.

A track that must solve for a pair does so beside those that come, which is its turn: until that
is taken in, updates tell where the vehicle is expected.  Tracks are begun beside the pairs too.  A
track that doubles another one while it has its turn ends when that is over.  What came of all this
is taken in between two pairs, in the thread of the pairs, so that no track changes under one.
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
    A track that is being begun.

    :param front: that it is begun at.
    :param search: that found it.
    :param begun: the track, and what it says of the pair of the search; None where it is none.
    """

    front: Detection
    search: Search
    begun: Future[Optional[Begun]]


@dataclass(frozen=True)
class Ended:
    """
    What ended with work that was taken in.

    :param doubles: tracks of vehicles that others hold, which have said all.
    :param errors: each has cost a track.
    """

    doubles: Sequence[Track]
    errors: Sequence[Exception]


class OpenWork:
    """
    See the module's docstring.

    :param solving: works; None where each pair waits for its solutions, and nothing is ever open.
    :param roster: the tracks there are; those begun are added, those that fail taken out.
    :param intake: takes in what trackers say.
    :param starter: begins tracks.
    """

    def __init__(self, solving: Optional[SolvingBeside], roster: Roster, intake: Intake,
                 starter: Starter) -> None:
        self._solving, self._roster, self._intake = solving, roster, intake
        self._starter = starter
        self._beginnings: list[_Beginning] = []
        self._doubles: list[Track] = []

    @property
    def is_possible(self) -> bool:
        """Return whether there is somebody who works."""
        return self._solving is not None

    @property
    def double_numbers(self) -> set[int]:
        """Return the numbers of tracks that are of the roster no more and still to end."""
        return {track.tracker.track for track in self._doubles}

    @property
    def beginnings(self) -> list[tuple[Detection, int]]:
        """Return the fronts that tracks are being begun at, and the stamps of their pairs."""
        return [(one.front, one.search.pair.stamp_ns) for one in self._beginnings]

    def held_up(self) -> AbstractContextManager[None]:
        """Hold the work up while a pair is in hand."""
        return self._worker.held_up()

    def follow(self, pair: StereoPair, particles: int) -> list[Optional[TrackUpdate]]:
        """
        Have the tracks fed a pair, now or beside.

        :param particles: number of particles of each.
        :return: where each vehicle is by what is known of it, in the order of the roster.
        """
        return [self._carried(track, pair, particles) for track in self._roster.tracks]

    def begin(self, fronts: Iterable[Detection], search: Search) -> None:
        """Have tracks begun at fronts that a search has found."""
        self._beginnings += [_Beginning(front, search, self._worker.submit(
            partial(self._starter.at, front, search.pair), urgent=False)) for front in fronts]

    def end_later(self, double: Track) -> None:
        """Take over a track that has its turn and is of the roster no more."""
        self._doubles.append(double)

    def take(self, wait_before_ns: float) -> Ended:
        """
        Take in what is ready.

        :param wait_before_ns: work for pairs with earlier stamps is waited for.
        """
        errors: list[Exception] = []
        for track in [*self._roster.tracks, *self._doubles]:
            turn = track.turn
            if turn is not None and (
                    turn.pair.stamp_ns < wait_before_ns or turn.said.done()):
                self._worker.wait(turn.said)
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
        """Give up tracks that are being begun: nothing was told of them."""
        beginnings, self._beginnings = self._beginnings, []
        self._give_up(one.begun for one in beginnings)

    def drop(self) -> None:
        """Give up everything."""
        self.drop_beginnings()
        self._give_up(track.turn.said for track in [*self._roster.tracks, *self._doubles]
                      if track.turn is not None)
        self._doubles = []

    @property
    def _worker(self) -> SolvingBeside:
        """Return who works; asked for only where there is work."""
        if self._solving is None:
            raise RuntimeError('nobody works beside the pairs')
        return self._solving

    def _carried(self, track: Track, pair: StereoPair, particles: int) -> Optional[TrackUpdate]:
        """Return where a vehicle is by what is known of it; arguments as for :meth:`follow`."""
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
        return self._intake.expect(track, expected)

    def _take_turn(self, track: Track, turn: Turn, errors: list[Exception]) -> None:
        """Take in what a track says of the pairs of its turn, which is over."""
        track.turn, roster = None, self._roster
        try:
            said = turn.said.result()
        except Exception as error:
            if track in roster.tracks:
                roster.tracks.remove(track)
            errors.append(error)
            return
        told = dict(turn.expected)
        for pair, update in said:
            self._intake.take(
                track, pair, turn.particles if pair is turn.pair else None, update)
            track.trace.add_others(pair.stamp_ns, turn.others.get(pair.stamp_ns, ()))
            if update is not None:
                told[pair.stamp_ns] = update
        if turn.stamp_std_s is not None:
            track.see_stamps(turn.stamp_std_s)
        for other in roster.tracks:
            for stamp_ns, update in told.items():
                if other is not track:
                    other.add_others(stamp_ns, [update])
        if track in roster.tracks and not (
                track.confirmed or track.detection is None or track.ended
                or all(holds(update) for _, update in said)):
            roster.tracks.remove(track)  # as what misses a pair is

    def _take_beginning(self, one: _Beginning, errors: list[Exception]) -> None:
        """Take in a track that was begun, if it was."""
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
        """Have done with work, whatever comes of it."""
        for future in futures:
            if not future.cancel():
                self._worker.wait(future)
