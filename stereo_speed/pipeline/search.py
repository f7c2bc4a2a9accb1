# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The search of pairs for new vehicles, which leaves out the places of known ones."""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Mapping, Optional, Sequence

import numpy as np

from .track import ahead_m, Track
from ..core.records import StereoPair, TrackUpdate
from ..core.tracker_config import AssociationConfig
from ..detection.protocol import AnswersLater, Detection, Detector, LooksAhead, TrackedRegion
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_ANSWERED_S = 0.5  # age, by stamps, from which a missing answer is waited for
_UNSEARCHED_S = 0.3  # longest time without a search; vehicles are in view for seconds


@dataclass(frozen=True, eq=False)
class Search:
    """
    A search of a pair.

    :param pair: the pair that is searched.
    :param tracked: regions that tracks held in it.
    :param doubted: tracks that were doubted, each with its last update.
    :param found: fronts found in it; None while the search is under way.
    :param seen: updates of the tracks for the pair.
    """

    pair: StereoPair
    tracked: Sequence[TrackedRegion]
    doubted: Sequence[tuple[Track, TrackUpdate]]
    found: Optional[Sequence[Detection]] = None
    seen: list[TrackUpdate] = field(default_factory=list)


@dataclass
class VehicleSearch:
    """
    Has pairs searched for new vehicles.

    :param rig: the cameras.
    :param detector: finds vehicles; None where only annotated vehicles are measured.
    :param limits: parameters; here, how long a vehicle that has left may still be visible.
    :param lanes: lane name to lane path.
    :param under_way: search whose answer is still to be taken.
    :param gone: last updates of vehicles that left recently.
    :param last_ns: stamp of the last pair that was searched.
    """

    rig: StereoRig
    detector: Optional[Detector]
    limits: AssociationConfig
    lanes: Mapping[str, LanePath]
    under_way: Optional[Search] = None
    gone: list[TrackUpdate] = field(default_factory=list)
    last_ns: Optional[int] = None

    def is_ready(self, stamp_ns: int) -> bool:
        """Return whether no search is under way, or its answer is there or overdue."""
        search, detector = self.under_way, self.detector
        return search is None or search.found is not None \
            or not isinstance(detector, AnswersLater) or detector.is_ready() \
            or (stamp_ns - search.pair.stamp_ns) * 1e-9 > _ANSWERED_S

    def is_due(self, stamp_ns: int, *, hurried: bool) -> bool:
        """Return whether the next pair, of this stamp, is to be searched, and note its stamp."""
        due = not hurried or self.last_ns is None or (
            stamp_ns - self.last_ns) * 1e-9 >= _UNSEARCHED_S
        if due:
            self.last_ns = stamp_ns
        return due

    def of(self, pair: StereoPair, tracks: Sequence[Track]) -> Search:
        """Return a search of a pair that the tracks have been fed."""
        return Search(pair, self._regions(pair, tracks), [
            (t, t.last) for t in tracks if t.doubted and t.last is not None])

    def expect(self, pair: StereoPair, tracks: Sequence[Track]) -> None:
        """Have a pair searched before the tracks are fed it."""
        if isinstance(self.detector, LooksAhead):
            self.settle()
            self._forget(pair)
            self.detector.expect(pair, self._regions(pair, tracks))

    def begin(self, pair: StereoPair, tracks: Sequence[Track], seen: Sequence[TrackUpdate],
              beginning: Sequence[tuple[Detection, int]]) -> None:
        """
        Begin to search a pair; the answer is taken with a later one.

        :param seen: updates of the tracks for it.
        :param beginning: fronts at which tracks are being started, with the stamps of their pairs.
        """
        search = self.of(pair, tracks)
        search = replace(search, seen=list(seen), tracked=[
            *search.tracked, *(_front_region(*one, pair.stamp_ns) for one in beginning)])
        if isinstance(self.detector, LooksAhead):
            self.detector.expect(pair, search.tracked)
        else:
            search = replace(search, found=self.answer(search))
        self.under_way = search

    def take(self) -> Optional[Search]:
        """Return the search under way, which then is under way no more; None without one."""
        search, self.under_way = self.under_way, None
        return search

    def answer(self, search: Search) -> Sequence[Detection]:
        """Return the fronts that a search finds, waiting for them where necessary."""
        if search.found is not None:
            return search.found
        return [] if self.detector is None else self.detector.update(search.pair, search.tracked)

    def settle(self) -> None:
        """Wait for the answer of the search under way, and keep it for the next pair."""
        if self.under_way is not None:
            self.under_way = replace(self.under_way, found=self.answer(self.under_way))

    def see_gone(self, pair: StereoPair, tracks: Sequence[Track]) -> None:
        """
        Remember the vehicles that have left the view by a pair.

        A vehicle that left must not be found again, by what is still in view of it, even if it was
        hidden when it left.  One that was lost in view may be.
        """
        self._forget(pair)
        self.gone += [t.last for t in tracks if t.last is not None and t.ended
                      and t.has_left and t.is_vehicle]

    def has_lately_gone(self, stamp_ns: Optional[int]) -> bool:
        """Return whether a vehicle has left the view shortly before a stamp."""
        return any(((stamp_ns or 0) - u.stamp_ns) * 1e-9 < self.limits.gone_s for u in self.gone)

    def reset(self) -> None:
        """Discard all state, including that of the detector."""
        self.under_way, self.gone, self.last_ns = None, [], None
        if self.detector is not None:
            self.detector.reset()

    def _forget(self, pair: StereoPair) -> None:
        """Forget vehicles that left too long before a pair to be visible in it."""
        self.gone = [u for u in self.gone
                     if (pair.stamp_ns - u.stamp_ns) * 1e-9 < self.limits.gone_s]

    def _regions(self, pair: StereoPair, tracks: Sequence[Track]) -> list[TrackedRegion]:
        """
        Return the regions of a pair that tracks hold, and those of vehicles that have just left.

        Doubted tracks are left out, so that the detector looks there again: either it or the track
        was mistaken.
        """
        held = [t.last for t in tracks if t.last is not None and not t.ended and not t.doubted]
        return [self._region(u, pair.stamp_ns) for u in [*held, *self.gone]]

    def _region(self, update: TrackUpdate, stamp_ns: int) -> TrackedRegion:
        """Return the region that a track holds at a stamp, by its last update."""
        # An overtaker travels against the lane that it is in.
        along = update.axes[:, 0] @ self.lanes[update.lane].path.tangent(np.array(update.s_m))
        oncoming, travelled_m = bool(along < 0), ahead_m(update, stamp_ns)
        width_m, height_m = np.ptp(update.quad_left_px, axis=0) * self.rig.left.metres_per_px(
            float(update.position_m[2]))
        return TrackedRegion(
            lane=update.lane, s_m=update.s_m + (-travelled_m if oncoming else travelled_m),
            lateral_m=update.lateral_m, width_m=float(width_m), height_m=float(height_m),
            left_px=update.quad_left_px, right_px=update.quad_right_px, oncoming=oncoming)


def _front_region(front: Detection, found_ns: int, stamp_ns: int) -> TrackedRegion:
    """Return the region predicted for a later stamp of a front found in one pair."""
    ahead = (front.speed_mps or 0.0) * (stamp_ns - found_ns) * 1e-9
    return TrackedRegion(
        lane=front.lane, s_m=front.s_m + ahead, lateral_m=front.lateral_m, width_m=front.width_m,
        height_m=front.height_m, left_px=front.left_px, right_px=front.right_px)
