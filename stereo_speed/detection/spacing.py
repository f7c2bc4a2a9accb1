# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Whether two fronts are nearer to each other than two vehicles can be."""
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
    Where a front is and how wide.

    :param centre_m: (3,) its middle, left optical frame, m.
    :param half_m: half of its width, m.
    :param lane: name of its lane; empty where that is not known.
    :param frames: frames (3, 3) of lanes where they are nearest to it, by the names of those that
        were asked for.
    """

    centre_m: Array
    half_m: float
    lane: str = ''
    frames: dict[str, Array] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, eq=False)
class Question:
    """
    What was asked of the places that tracks hold, and answered.

    :param lane: of a front.
    :param one: where it is.
    :param answer: whether it is too near to one of them.
    :param speed_mps: of the front; 0 where it is not known.
    :param side_m: whether it is at the side of one was asked, of those at least so far from their
        middle to their edge, so far beyond and so near to it; None where it was not.
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
        Return whether a front is nearer to another one than two vehicles can be.

        :param lane: of the front.
        :param speed_mps: of the front; 0 where it is not known.
        """
        along_m = self.config.along_m + self.config.headway_s * speed_mps
        return any(self._near(lane, one, other, along_m) for other in others)

    def is_at_side(self, lane: str, one: Place, others: Iterable[Place], behind_m: float,
                   side_m: float) -> bool:
        """
        Return whether a place is at the side of a vehicle, beyond what faces the cameras of it.

        That is its front where it comes, and its rear where it goes away.  What goes along the
        lane is no part of a vehicle that goes the other way.

        :param lane: of the place.
        :param behind_m: so far beyond at most.
        :param side_m: so near to its side, across the lane.
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
        """Return the direction (3,) of a lane where a place is."""
        return self._frame(lane, place)[:, 0]

    def _near(self, lane: str, one: Place, other: Place, along_m: float) -> bool:
        apart = np.abs(self._apart(lane, one, other))
        across_m = max(one.half_m + other.half_m, self.config.across_m)
        return bool(apart[0] < along_m and apart[1] < across_m)

    def _apart(self, lane: str, one: Place, other: Place) -> Array:
        """Return how far one place is ahead of another, to its left and above it, m."""
        return np.asarray(self._frame(lane, other).T @ (one.centre_m - other.centre_m))

    def _frame(self, lane: str, place: Place) -> Array:
        """Return the frame (3, 3) of a lane where it is nearest to a place."""
        if lane not in place.frames:
            path = self.lanes[lane].path
            place.frames[lane] = np.asarray(path.frame(path.arc_length(place.centre_m)))
        return place.frames[lane]

    def answer(self, question: Question, places: Iterable[Place]) -> bool:
        """Return what some places answer to a question."""
        if question.side_m is None:
            return self.meet(question.lane, question.one, places, question.speed_mps)
        least_half_m, behind_m, side_m = question.side_m
        return self.is_at_side(question.lane, question.one, [
            place for place in places if place.half_m >= least_half_m], behind_m, side_m)

    def agree(self, asked: Iterable[Question], places: Sequence[Place]) -> bool:
        """Return whether some places answer all questions as others have."""
        return all(self.answer(question, places) == question.answer for question in asked)


class Held:
    """
    Places where no vehicle is sought: those that tracks hold, and those found since.

    What is asked of the tracks is kept in ``asked``.  Other tracks that answer it alike would have
    led to the same fronts.

    :param spacing: says what is too near.
    :param tracked: that tracks hold.
    """

    def __init__(self, spacing: Spacing, tracked: Iterable[Place]) -> None:
        self.asked: list[Question] = []
        self._spacing, self._tracked = spacing, list(tracked)
        self._found: list[Place] = []

    def anew(self) -> Held:
        """Return the tracks alone, without what was found since; they share what is asked."""
        other = Held(self._spacing, self._tracked)
        other.asked = self.asked
        return other

    def add(self, place: Place) -> None:
        """Take in a place that was found."""
        self._found.append(place)

    def meet(self, lane: str, one: Place, speed_mps: float = 0.0) -> bool:
        """Return whether a front is nearer to one of them than two vehicles can be."""
        return self._ask(Question(lane, one, speed_mps=speed_mps))

    def is_at_side(self, lane: str, one: Place, behind_m: float, side_m: float,
                   least_half_m: float = 0.0) -> bool:
        """
        Return whether a place is at the side of one of them; see :meth:`Spacing.is_at_side`.

        :param least_half_m: those that are narrower do not count.
        """
        return self._ask(Question(lane, one, side_m=(least_half_m, behind_m, side_m)))

    def _ask(self, question: Question) -> bool:
        answer = self._spacing.answer(question, self._tracked)
        self.asked.append(replace(question, answer=answer))
        return answer or self._spacing.answer(question, self._found)
