# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The roster of tracks: finds duplicates, and drops tracks that end without a pass."""
from __future__ import annotations

from typing import Container, Sequence

import numpy as np

from .search import Search
from .track import holds, place_m, Track
from ..core.records import Array, TrackUpdate

Begun = tuple[Track, TrackUpdate]  # a new track, and its update for the pair it was found in

_APART = 2.0  # in distances of duplicates; a solution moves a predicted place by less
# Of two vehicles one behind the other, the fronts are further apart than a motorcycle is long; of
# two side by side, further than it is wide.
_SHORTEST_M = 2.0
_NARROWEST_M = 0.8
_INSIDE = 0.9  # share of a front's half width; no other vehicle's middle is seen within it


class Roster:
    """
    The tracks of the vehicles in view.

    ``tracks`` are in the order in which they were added.

    :param same_vehicle_m: distance below which two tracks are taken to hold one vehicle.
    """

    def __init__(self, same_vehicle_m: float) -> None:
        self.tracks: list[Track] = []
        self._near_m = same_vehicle_m

    def introduce(self, search: Search, begun: Sequence[Begun]) -> None:
        """Add new tracks' updates for the pair of a search to all traces, and others to theirs."""
        new, updates = [track for track, _ in begun], [update for _, update in begun]
        for track in self.tracks:
            track.add_others(
                search.pair.stamp_ns, [*search.seen, *updates] if track in new else updates)

    def is_apart(self, update: TrackUpdate) -> bool:
        """Return whether no other track, predicted to now, can hold the same vehicle."""
        near_m = _APART * self._near_m
        return not any(
            t.last is not None and t.tracker.track != update.track
            and np.linalg.norm(place_m(t.last, update.stamp_ns) - update.position_m) < near_m
            for t in self.tracks)

    def drop_missing(self) -> None:
        """End tracks that miss a pair before they are confirmed; real vehicles are found again."""
        self.tracks = [
            t for t in self.tracks if t.confirmed or t.detection is None
            or t.ended or holds(t.last) or t.turn is not None]

    def drop_doubles(self, stamp_ns: int, published: Container[int] = ()) -> list[Track]:
        """
        End one of two tracks that hold the same vehicle.

        The one that does not see the vehicle ends, or the younger one if both see it.  One that
        lies within the other's vehicle ends, annotated or not: it has slid from a vehicle that
        cannot be there.

        :param stamp_ns: stamp of the current pair.
        :param published: numbers of tracks whose readings of this pair are published already;
            they stay.
        :return: the ended tracks that were confirmed.
        """
        doubles = self._drop_near(stamp_ns, published)
        doubles += self._drop_within(stamp_ns, published)
        return [track for track in doubles if track.confirmed]

    def _drop_near(self, stamp_ns: int, published: Container[int]) -> list[Track]:
        """End and return detected tracks so near to another one that both hold one front."""
        held: list[Array] = []
        ended: list[Track] = []
        for track in sorted(self.tracks, key=lambda t: (
                t.tracker.track not in published, not holds(t.last))):
            if track.last is None or track.ended:
                continue
            at_m = place_m(track.last, stamp_ns)
            if track.detection is not None and any(
                    np.linalg.norm(at_m - other_m) < self._near_m for other_m in held):
                self.tracks.remove(track)
                ended.append(track)
            else:
                held.append(at_m)
        return ended

    def _drop_within(self, stamp_ns: int, published: Container[int]) -> list[Track]:
        """End and return tracks whose front lies within the vehicle of another one."""
        sure = [(track, track.last, place_m(track.last, stamp_ns)) for track in self.tracks
                if track.last is not None and holds(track.last) and track.confirmed
                and not track.ended]
        ended = [
            track for track, last, at_m in sure if track.tracker.track not in published and any(
                _is_within(at_m, last, other_m, other_last) for other, other_last, other_m in sure
                if other is not track)]
        self.tracks = [track for track in self.tracks if track not in ended]
        return ended


def _is_within(at_m: Array, update: TrackUpdate, other_m: Array, other: TrackUpdate) -> bool:
    """
    Return whether a front lies where the vehicle of another one is.

    A vehicle extends away from the cameras, as its end that faces them is tracked: the front of
    one that approaches, the rear of one that recedes.

    :param at_m: (3,) its place.
    :param update: the newest update of its track.
    :param other_m: (3,) place of the other front.
    :param other: the newest update of the other front's track.
    """
    ahead, beside = (at_m - other_m) @ update.axes[:, :2]
    farther = ahead if at_m @ update.axes[:, 0] > 0 else -ahead
    return bool(0 < farther < _SHORTEST_M
                and (abs(beside) < _NARROWEST_M or _is_seen_inside(update, other)))


def _is_seen_inside(update: TrackUpdate, other: TrackUpdate) -> bool:
    """Return whether the middle of a front is seen well inside of another front of its pair."""
    mine, others = (one.quad_left_px[:, 0] for one in (update, other))
    left, right = float(others.min()), float(others.max())
    off = abs(float(mine.min() + mine.max()) - (left + right)) / 2
    return update.stamp_ns == other.stamp_ns and off < _INSIDE * (right - left) / 2
