# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Decides what fronts near to each other have to do with each other.

Two fronts may be too close to each other to be two vehicles.  What moves beside a narrow front may
be the rest of its own vehicle, or another vehicle before or behind it.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Iterable, Mapping, NamedTuple, Optional, Sequence

import numpy as np

from .config import SpacingConfig
from .outline import Extent
from .protocol import TrackedRegion
from ..core.records import Array
from ..road.lanes import LanePath

# How far behind a narrow front a vehicle may be seen beside it: nearer ones may be what it is part
# of, and those farther away are seen above it.
_BEHIND_M = 3.0, 15.0
_CLEAR_M = 1.0  # least distance of its middle from the side of a vehicle in the next lane
_OWN_M = 0.25  # how far what moves may extend beyond the edge of the front that it belongs to
_BESIDE_M = 0.3  # how much wider than its front a vehicle may be, by its mirrors


@dataclass(frozen=True, eq=False)
class Place:
    """
    The place and width of a front.

    :param centre_m: (3,) middle of the front, left optical frame, m.
    :param half_m: half of its width, m.
    :param lane: name of its lane; empty where that is not known.
    :param frames: cache, lane name to the frame (3, 3) of the lane at its point nearest to the
        front.
    """

    centre_m: Array
    half_m: float
    lane: str = ''
    frames: dict[str, Array] = field(default_factory=dict, repr=False)


class Lengths(NamedTuple):
    """
    Assumed lengths of vehicles, by the width of their fronts.

    :param car_m: length of a car, m.
    :param long_m: length of a wider vehicle, which may be a lorry, m.
    :param car_half_m: half width from which on a front may be that of a lorry, m.
    """

    car_m: float
    long_m: float
    car_half_m: float


class Beside(NamedTuple):
    """
    What moves with a narrow front beside it.

    :param extent: how far it extends.
    :param most_m: greatest width of what is not part of something wider, m.
    :param lengths: lengths of the vehicles that may be beside it in the image.
    """

    extent: Extent
    most_m: float
    lengths: Lengths


@dataclass(frozen=True, eq=False)
class Question:
    """
    A question about the places that tracks hold, with its answer.

    The question is whether a front is too near to one of these places; where ``side_m`` is given,
    whether it is at the side of one of them; where ``beside`` is given, whether it stands alone.

    :param lane: lane of the front.
    :param one: place of the front.
    :param answer: the answer.
    :param speed_mps: speed of the front, m/s; 0 where it is not known.
    :param side_m: least half width of the places that count, greatest distance behind them, and
        greatest distance from their side, m; None for other questions.
    :param beside: what moves with the front; None for other questions.
    """

    lane: str
    one: Place
    answer: bool = False
    speed_mps: float = 0.0
    side_m: Optional[tuple[float, float, float]] = None
    beside: Optional[Beside] = None


class Spacing:
    """
    Distances between fronts, along the lanes and across them.

    :param lanes: lane name to lane path.
    :param config: parameters.
    """

    def __init__(self, lanes: Mapping[str, LanePath], config: SpacingConfig) -> None:
        self.lanes, self.config = lanes, config

    def tracked(self, regions: Iterable[TrackedRegion]) -> list[Place]:
        """Return the places that tracks hold."""
        out = []
        for region in regions:
            if region.finite and region.lane in self.lanes:
                path, s = self.lanes[region.lane].path, np.array(region.s_m)
                centre = path.position(s) + region.lateral_m * path.frame(s)[:, 1]
                half_m = max(region.width_m / 2, self.config.least_half_m)
                out.append(Place(centre, half_m, region.lane))
        return out

    def meet(self, lane: str, one: Place, others: Iterable[Place], speed_mps: float = 0.0) -> bool:
        """
        Return whether a front is too near to another one for two vehicles.

        :param lane: lane of the front.
        :param one: place of the front.
        :param others: places of the other fronts.
        :param speed_mps: speed of the front, m/s; 0 where it is not known.
        """
        along_m = self.config.along_m + self.config.headway_s * speed_mps
        return any(self._near(lane, one, other, along_m) for other in others)

    def is_at_side(self, lane: str, one: Place, others: Iterable[Place], behind_m: float,
                   side_m: float) -> bool:
        """
        Return whether a place is at the side of a vehicle, beyond its end that faces the cameras.

        This end is the front of an approaching vehicle and the rear of a receding one.  Vehicles
        that travel in the opposite direction do not count.

        :param lane: lane of the place.
        :param one: the place.
        :param others: places of the ends of vehicles that face the cameras.
        :param behind_m: greatest distance beyond that end, m.
        :param side_m: greatest distance from the side, across the lane, m.
        """
        for other in others:
            ahead, across_m = self._ahead(lane, other), self._apart(lane, one, other)[1]
            if other.lane and ahead @ self._ahead(other.lane, other) < 0:
                continue
            beyond_m = self._beyond_m(lane, one, other)
            if 0 < beyond_m < behind_m and abs(abs(across_m) - other.half_m) < side_m:
                return True
        return False

    def stands_alone(self, lane: str, one: Place, beside: Beside, others: Iterable[Place]) -> bool:
        """
        Return whether what moves beside a narrow front is other vehicles behind it.

        Their speeds may be nearly the same, and far away their ranges look the same.  Only what
        something static separates from the edge of the front counts, and only vehicles in the
        lanes beside it: one in its own lane may be behind the vehicle that it is part of.

        :param lane: lane of the front.
        :param one: place of the front.
        :param beside: what moves with the front.
        :param others: places of the ends of vehicles that face the cameras.
        """
        right_m, left_m, near_right_m, near_left_m = beside.extent
        edge_m = one.half_m + _OWN_M
        for other in others:
            across_m = abs(self._apart(lane, one, other)[1])
            behind_m = -self._beyond_m(lane, one, other)
            if not _BEHIND_M[0] < behind_m < _BEHIND_M[1] or across_m < other.half_m + _CLEAR_M:
                continue
            from_m, to_m = self._covered(lane, one, other, beside.lengths)
            if from_m <= right_m and near_right_m > -edge_m:
                right_m = max(right_m, min(to_m, near_right_m))
            if to_m >= left_m and near_left_m < edge_m:
                left_m = min(left_m, max(from_m, near_left_m))
        return left_m - right_m <= beside.most_m

    def _beyond_m(self, lane: str, one: Place, other: Place) -> float:
        """Return how much farther from the cameras a place is than another, along the lane, m."""
        along_m = float(self._apart(lane, one, other)[0])
        return along_m if self._ahead(lane, other) @ other.centre_m > 0 else -along_m

    def _covered(self, lane: str, one: Place, other: Place, lengths: Lengths
                 ) -> tuple[float, float]:
        """
        Return where the left camera sees a vehicle behind a front on the plane of the front.

        :return: its right and its left end, m to the left of the front's middle.
        """
        ahead, across, _ = self._frame(lane, one).T
        own, beside = self._frame(lane, other)[:, :2].T
        back = own if own @ other.centre_m > 0 else -own  # away from the cameras
        long_m = lengths.car_m if other.half_m < lengths.car_half_m else lengths.long_m
        corners = np.array([other.centre_m + side * other.half_m * beside + far_m * back
                            for side in (-1, 1) for far_m in (0.0, long_m)])
        ranges = corners @ ahead / (one.centre_m @ ahead)  # relative to the plane
        at = (corners / ranges[:, None] - one.centre_m) @ across
        return float(at.min()) - _BESIDE_M, float(at.max()) + _BESIDE_M

    def _ahead(self, lane: str, place: Place) -> Array:
        """Return the direction (3,) of a lane at a place."""
        return self._frame(lane, place)[:, 0]

    def _near(self, lane: str, one: Place, other: Place, along_m: float) -> bool:
        apart = np.abs(self._apart(lane, one, other))
        across_m = max(one.half_m + other.half_m, self.config.across_m)
        return bool(apart[0] < along_m and apart[1] < across_m)

    def _apart(self, lane: str, one: Place, other: Place) -> Array:
        """Return how far one place is ahead of another, to its left and above it, m."""
        return np.asarray(self._frame(lane, other).T @ (one.centre_m - other.centre_m))

    def _frame(self, lane: str, place: Place) -> Array:
        """Return the frame (3, 3) of a lane at its point nearest to a place."""
        if lane not in place.frames:
            path = self.lanes[lane].path
            place.frames[lane] = np.asarray(path.frame(path.arc_length(place.centre_m)))
        return place.frames[lane]

    def answer(self, question: Question, places: Iterable[Place]) -> bool:
        """Return the answer to a question for given places."""
        if question.beside is not None:
            return self.stands_alone(question.lane, question.one, question.beside, places)
        if question.side_m is None:
            return self.meet(question.lane, question.one, places, question.speed_mps)
        least_half_m, behind_m, side_m = question.side_m
        return self.is_at_side(question.lane, question.one, [
            place for place in places if place.half_m >= least_half_m], behind_m, side_m)

    def agree(self, asked: Iterable[Question], places: Sequence[Place]) -> bool:
        """Return whether given places lead to the recorded answers of all questions."""
        return all(self.answer(question, places) == question.answer for question in asked)


class Held:
    """
    Places where no vehicle is searched for: those that tracks hold, and those found since.

    All questions about the tracks are kept in ``asked``.  Other tracks for which the answers are
    the same would have led to the same fronts.

    :param spacing: decides what is too near.
    :param tracked: places that tracks hold.
    """

    def __init__(self, spacing: Spacing, tracked: Iterable[Place]) -> None:
        self.asked: list[Question] = []
        self._spacing, self._tracked = spacing, list(tracked)
        self._found: list[Place] = []

    def anew(self) -> Held:
        """Return a copy without the places found since, which shares ``asked``."""
        other = Held(self._spacing, self._tracked)
        other.asked = self.asked
        return other

    def add(self, place: Place) -> None:
        """Add a place that was found."""
        self._found.append(place)

    def meet(self, lane: str, one: Place, speed_mps: float = 0.0) -> bool:
        """Return whether a front is too near to one of these places for two vehicles."""
        return self._ask(Question(lane, one, speed_mps=speed_mps))

    def is_at_side(self, lane: str, one: Place, behind_m: float, side_m: float,
                   least_half_m: float = 0.0) -> bool:
        """
        Return whether a place is at the side of one of these; see :meth:`Spacing.is_at_side`.

        :param least_half_m: least half width of the places that count, m.
        """
        return self._ask(Question(lane, one, side_m=(least_half_m, behind_m, side_m)))

    def stands_alone(self, lane: str, one: Place, beside: Beside) -> bool:
        """
        Return whether what moves beside a front is these vehicles.

        See :meth:`Spacing.stands_alone`.
        """
        return self._ask(Question(lane, one, beside=beside))

    def _ask(self, question: Question) -> bool:
        answer = self._spacing.answer(question, self._tracked)
        self.asked.append(replace(question, answer=answer))
        return answer or self._spacing.answer(question, self._found)
