# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Decides what fronts near to each other have to do with each other.

Two fronts may be too close to each other to be two vehicles.  What moves beside a narrow front may
be the rest of its own vehicle, or another vehicle.
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

# How much farther or nearer than a narrow front a vehicle may be that is seen beside it.  At less,
# the front may be part of it; at more, cameras a few metres above the road see it above or, unless
# it is tall, below.  Where such a one is seen all the same, the two-wheeler may be missed.
_APART_M = 3.0, 15.0
_NEAREST = 0.3  # least range of such a vehicle, as a share of that of the front
_CLEAR_M = 1.0  # least distance of its middle from the side of a vehicle in the next lane
_MIRROR_M = 0.3  # how much wider than its front a vehicle may be


@dataclass(frozen=True, eq=False)
class Place:
    """
    The place and width of a front.

    :param centre_m: (3,) middle of the front, left optical frame, m.
    :param half_m: half of its width, m.
    :param lane: name of its lane; empty where that is not known.
    :param oncoming: whether it travels against the direction of that lane.
    :param frames: cache, lane name to the frame (3, 3) of the lane at its point nearest to the
        front.
    """

    centre_m: Array
    half_m: float
    lane: str = ''
    oncoming: bool = False
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


class MovingBeside(NamedTuple):
    """
    What moves with a narrow front.

    :param extent: how far it extends.
    :param own_right_m: how far to the right the front's own vehicle may be seen, m to the left of
        the front's middle.
    :param own_left_m: how far to the left.
    :param most_m: greatest width of what is not part of something wider, m.
    :param lengths: lengths of the vehicles that may be seen beside it.
    """

    extent: Extent
    own_right_m: float
    own_left_m: float
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
    beside: Optional[MovingBeside] = None


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
                out.append(Place(centre, half_m, region.lane, region.oncoming))
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
            if self._is_oncoming(lane, other):
                continue
            farther_m, across_m = self._farther(lane, one, other)
            if 0 < farther_m < behind_m and abs(abs(across_m) - other.half_m) < side_m:
                return True
        return False

    def stands_alone(self, lane: str, one: Place, beside: MovingBeside,
                     others: Iterable[Place]) -> bool:
        """
        Return whether what moves beside a narrow front is other vehicles.

        Their speeds may be nearly the same, and far away their ranges look the same.  Only what
        something static separates from the edge of the front counts, and only vehicles in the
        lanes beside it that travel in its direction: one in its own lane may be beyond the vehicle
        that the front is part of.

        :param lane: lane of the front.
        :param one: place of the front.
        :param beside: what moves with the front.
        :param others: places of the ends of vehicles that face the cameras.
        """
        extent = beside.extent
        if extent.near_right_m >= extent.near_left_m:
            return False
        covered = [self._covered(lane, one, other, beside.lengths) for other in others
                   if self._is_seen_beside(lane, one, other)]
        left_m = _left_end(extent.left_m, extent.near_left_m, beside.own_left_m, covered)
        right_m = -_left_end(-extent.right_m, -extent.near_right_m, -beside.own_right_m,
                             [(-to_m, -from_m) for from_m, to_m in covered])
        return left_m - right_m <= beside.most_m

    def _is_seen_beside(self, lane: str, one: Place, other: Place) -> bool:
        """Return whether a vehicle in a next lane may be seen beside a front nearer or farther."""
        if self._is_oncoming(lane, other):
            return False
        farther_m, across_m = self._farther(lane, other, one)
        ahead = self._ahead(lane, one)  # tracks are predicted to places behind the cameras, too
        share = float(other.centre_m @ ahead) / float(one.centre_m @ ahead)
        return (_APART_M[0] < abs(farther_m) < _APART_M[1] and share > _NEAREST
                and abs(across_m) > other.half_m + _CLEAR_M)

    def _farther(self, lane: str, one: Place, other: Place) -> tuple[float, float]:
        """
        Return how much farther from the cameras one place is than another, and to its left, m.

        Both are by the path of a lane, as it may bend between them.
        """
        (at_m, x_m), (other_at_m, other_x_m) = (self._on_lane(lane, p) for p in (one, other))
        return self._sense(lane, other) * (at_m - other_at_m), x_m - other_x_m

    def _on_lane(self, lane: str, place: Place) -> tuple[float, float]:
        """Return the arc length and the offset to the left of a place on the path of a lane, m."""
        path = self.lanes[lane].path
        s = path.arc_length(place.centre_m)
        return float(s), float(
            self._frame(lane, place)[:, 1] @ (place.centre_m - path.position(s)))

    def _is_oncoming(self, lane: str, other: Place) -> bool:
        """Return whether a vehicle is known to travel against the direction of a lane."""
        opposed = bool(other.lane
                       and self._ahead(lane, other) @ self._ahead(other.lane, other) < 0)
        return opposed != other.oncoming

    def _away(self, lane: str, place: Place) -> Array:
        """Return the direction (3,) along a lane at a place that leads away from the cameras."""
        return self._sense(lane, place) * self._ahead(lane, place)

    def _sense(self, lane: str, place: Place) -> int:
        """Return 1 if a lane leads away from the cameras at a place, else -1."""
        return 1 if self._ahead(lane, place) @ place.centre_m > 0 else -1

    def _covered(self, lane: str, one: Place, other: Place, lengths: Lengths
                 ) -> tuple[float, float]:
        """
        Return where the left camera sees a vehicle on the plane of a front.

        :return: its right and its left end, m to the left of the front's middle.
        """
        ahead, across, _ = self._frame(lane, one).T
        left, away = self._frame(lane, other)[:, 1], self._away(lane, other)
        length_m = lengths.car_m if other.half_m < lengths.car_half_m else lengths.long_m
        corners = np.array([other.centre_m + side * other.half_m * left + far_m * away
                            for side in (-1, 1) for far_m in (0.0, length_m)])
        ranges = corners @ ahead / (one.centre_m @ ahead)  # relative to the plane
        at = (corners / ranges[:, None] - one.centre_m) @ across
        return float(at.min()) - _MIRROR_M, float(at.max()) + _MIRROR_M

    def _ahead(self, lane: str, place: Place) -> Array:
        """Return the direction (3,) of a lane at a place."""
        return self._frame(lane, place)[:, 0]

    def _near(self, lane: str, one: Place, other: Place, along_m: float) -> bool:
        apart = np.abs(self._apart(lane, one, other))
        across_m = max(one.half_m + other.half_m + self.config.beside_m, self.config.across_m)
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

    def stands_alone(self, lane: str, one: Place, beside: MovingBeside) -> bool:
        """
        Return whether what moves beside a front is tracked vehicles.

        See :meth:`Spacing.stands_alone`.  Fronts found since do not count.
        """
        return self._ask_tracks(Question(lane, one, beside=beside))

    def _ask(self, question: Question) -> bool:
        return self._ask_tracks(question) or self._spacing.answer(question, self._found)

    def _ask_tracks(self, question: Question) -> bool:
        answer = self._spacing.answer(question, self._tracked)
        self.asked.append(replace(question, answer=answer))
        return answer


def _left_end(left_m: float, near_m: float, own_m: float,
              covered: Sequence[tuple[float, float]]) -> float:
    """
    Return the left end of what moves without the vehicles that are seen there.

    :param left_m: left end of all that moves.
    :param near_m: left end of the part that nothing static separates from the front.
    :param own_m: how far to the left the front's own vehicle may be seen.
    :param covered: right and left ends of those vehicles.
    """
    if near_m >= own_m:
        return left_m
    for from_m, to_m in sorted(covered, key=lambda ends: -ends[1]):
        if to_m >= left_m:
            left_m = min(left_m, max(from_m, near_m))
    return left_m
