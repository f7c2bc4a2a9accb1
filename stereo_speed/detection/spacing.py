# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Decides whether two fronts are too close to each other to be two vehicles."""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Iterable, Mapping, Optional, Sequence

import numpy as np

from .config import SpacingConfig
from .protocol import TrackedRegion
from ..core.records import Array
from ..road.lanes import LanePath


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


@dataclass(frozen=True, eq=False)
class Question:
    """
    A question about the places that tracks hold, with its answer.

    The question is whether a front is too near to one of these places or, where ``side_m`` is
    given, whether it is at the side of one of them.

    :param lane: lane of the front.
    :param one: place of the front.
    :param answer: the answer.
    :param speed_mps: speed of the front, m/s; 0 where it is not known.
    :param side_m: least half width of the places that count, greatest distance behind them, and
        greatest distance from their side, m; None for the question of distance.
    """

    lane: str
    one: Place
    answer: bool = False
    speed_mps: float = 0.0
    side_m: Optional[tuple[float, float, float]] = None


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
            along_m, across_m, _ = self._apart(lane, one, other)
            ahead = self._ahead(lane, other)
            if other.lane and ahead @ self._ahead(other.lane, other) < 0:
                continue
            beyond_m = along_m if ahead @ other.centre_m > 0 else -along_m
            if 0 < beyond_m < behind_m and abs(abs(across_m) - other.half_m) < side_m:
                return True
        return False

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

    def _ask(self, question: Question) -> bool:
        answer = self._spacing.answer(question, self._tracked)
        self.asked.append(replace(question, answer=answer))
        return answer or self._spacing.answer(question, self._found)
