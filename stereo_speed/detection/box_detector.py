# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Turns boxes of another program, such as a neural network, into fronts of vehicles.

A box gives the approximate place of a vehicle in the left image.  The range of its front and its
speed follow from both views and an earlier pair (``front_search``), as for every detector of this
package.  Boxes may come some pairs late: they are applied to the pair that they were found in, and
the front is followed from there to the newest pair.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Mapping, Optional, Sequence

import numpy as np

from .box_proposals import box_proposals, BoxFitConfig, fits_box
from .config import FrontConfig, MotionConfig, SpacingConfig
from .front_search import FoundFront, FrontSearch, Moment, NoiseEstimate
from .protocol import Detection, ImageBox, TrackedRegion
from .pyramid import PairPyramids, PairRegions, Region
from .spacing import Held, Place
from ..core.config import CheckedRecord, parameter, section
from ..core.errors import InputError
from ..core.records import StereoPair
from ..geometry.rig import StereoRig
from ..geometry.steadied import moved_px
from ..road.lanes import LanePath

_MOST_WAITING = 10_000  # offers kept for pairs still to come; more must be of another clock
_MOST_PYRAMIDS = 6  # pyramids kept, because a pair is used again later as the earlier one


@dataclass(frozen=True)
class BoxConfig(CheckedRecord):
    """Parameters of the detector that takes boxes."""

    least_score: float = parameter(
        0.5, 0.0, 1.0, '', 'boxes with a lower score are ignored')
    history_pairs: int = parameter(
        10, 0, 1000, '', 'boxes that come more than this many pairs late are ignored')
    forget_after_s: float = parameter(
        3.0, 0.1, 60.0, 's', 'gap between pairs after which earlier pairs are discarded, because '
        'all vehicles have left the view')

    fit: BoxFitConfig = section(BoxFitConfig, 'where a front lies in its box')
    front: FrontConfig = section(FrontConfig, 'what both views must show of a front')
    motion: MotionConfig = section(MotionConfig, 'how a front must have moved')
    spacing: SpacingConfig = section(SpacingConfig, 'least distances between vehicles')

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.motion.reference_s < self.forget_after_s:
            raise InputError('configuration', 'motion.reference_s', self.motion.reference_s,
                             f'less than forget_after_s, {self.forget_after_s}')


@dataclass(frozen=True, eq=False)
class _Kept:
    """A pair, and the places that tracks held in it."""

    pair: StereoPair
    taken: Sequence[Place]


class BoxDetector:
    """
    Finds the fronts of vehicles in boxes that it is offered; see the module's docstring.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters.

    ``unmatched`` counts the offers whose pair never came, or was no longer kept.
    """

    Settings = BoxConfig

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath], config: BoxConfig) -> None:
        self.config, self.unmatched = config, 0
        self._search = FrontSearch(rig, lanes, config, None)
        self._regions = PairRegions(*(Region(0, 0, camera.width_px, camera.height_px)
                                      for camera in (rig.left, rig.right)))
        self._history: deque[_Kept] = deque()
        self._pyramids: dict[int, PairPyramids] = {}
        self._waiting: dict[int, Sequence[ImageBox]] = {}
        self._noise = NoiseEstimate()

    def reset(self) -> None:
        """Discard all earlier pairs and boxes, as after a jump back in time."""
        self._forget_pairs()
        self._waiting.clear()

    def offer(self, stamp_ns: int, boxes: Sequence[ImageBox]) -> None:
        """
        Take the boxes of one pair; they are used when the next pair comes.

        :param stamp_ns: header stamp of the left image that they were found in, ns.
        :param boxes: all boxes of that image.
        """
        self._waiting[stamp_ns] = tuple(boxes)
        if len(self._waiting) > _MOST_WAITING:
            del self._waiting[min(self._waiting)]
            self.unmatched += 1

    def update(self, pair: StereoPair, tracked: Sequence[TrackedRegion] = ()) -> list[Detection]:
        """
        Process a pair and return the vehicles in boxes that no track holds.

        :param pair: pairs in order of stamps.
        :param tracked: regions that tracks hold, predicted for this pair.
        """
        if self._history and (pair.stamp_ns - self._history[-1].pair.stamp_ns) * 1e-9 \
                > self.config.forget_after_s:
            self._forget_pairs()
        newest = _Kept(pair, self._search.spacing.tracked(tracked))
        self._history.append(newest)
        found: list[FoundFront] = []
        for kept, boxes in self._matched():
            for one in self._found_in(kept, boxes):
                held = [*newest.taken, *(f.place for f in found)]
                now = self._now(one, kept)
                if now is not None and not self._search.spacing.meet(
                        now.lane, now.place, held, now.motion.speed_mps):
                    found.append(now)
        detections = [self._search.detection(f, pair, self._since(f.before)) for f in found]
        self._trim()
        return [d for d in detections if d is not None]

    def _matched(self) -> list[tuple[_Kept, Sequence[ImageBox]]]:
        """Return the pairs whose boxes have arrived, the earliest first, with the boxes."""
        newest_ns = self._history[-1].pair.stamp_ns
        come = {stamp_ns: self._waiting.pop(stamp_ns)
                for stamp_ns in sorted(self._waiting) if stamp_ns <= newest_ns}
        recent = list(self._history)[-1 - self.config.history_pairs:]
        out = [(kept, come.pop(kept.pair.stamp_ns))
               for kept in recent if kept.pair.stamp_ns in come]
        self.unmatched += len(come)
        return out

    def _found_in(self, kept: _Kept, boxes: Sequence[ImageBox]) -> list[FoundFront]:
        """Return the fronts of vehicles in the boxes of a pair, at most one per box."""
        past = self._references(kept.pair.stamp_ns)
        good = [box for box in boxes if box.score >= self.config.least_score]
        if not past or not good:
            return []
        now = self._pyramids_of(kept.pair)
        self._noise.learn(now, past[0])
        moment = Moment(now, past, self._noise.std)
        out: list[FoundFront] = []
        for box in sorted(good, key=lambda box: -box.score):
            one = self._front_of(box, moment, Held(
                self._search.spacing, [*kept.taken, *(f.place for f in out)]))
            if one is not None:
                out.append(one)
        return out

    def _front_of(self, box: ImageBox, moment: Moment, taken: Held) -> Optional[FoundFront]:
        """Return the front in a box, found by symmetry or, if that fails, without it."""
        fit, reach_m = self.config.fit, self.config.front.reach_m
        pair = moment.now.pair
        there = self._unmoved(box, pair)
        proposals = {lane: box_proposals(geometry, there, reach_m, fit)
                     for lane, geometry in self._search.geometry.items()}
        for symmetric in (True, False):
            found = [one for lane, some in proposals.items() for one in self._search.search(
                lane, some, moment, taken, len(some), symmetric)
                if fits_box(self._search.quads(one, one.front, pair)[0], box, fit)]
            if found:
                return max(self._search.distinct(found), key=lambda one: one.front.cross_ncc)
        return None

    def _unmoved(self, box: ImageBox, pair: StereoPair) -> ImageBox:
        """Return a box with the motion of the rig removed."""
        if pair.motion is None:
            return box
        rig = self._search.rig
        middle = np.array([box.left_px + box.width_px / 2, box.top_px + box.height_px])
        moved = moved_px(rig.as_taken(pair.motion), rig, False, middle) - middle
        return replace(box, left_px=box.left_px + float(moved[0]),
                       top_px=box.top_px + float(moved[1]))

    def _now(self, found: FoundFront, kept: _Kept) -> Optional[FoundFront]:
        """Return a front as it is in the newest pair; None where it is not seen there."""
        newest = self._history[-1]
        if newest is kept:
            return found
        return self._search.followed(found, self._pyramids_of(kept.pair),
                                     self._pyramids_of(newest.pair))

    def _references(self, stamp_ns: int) -> list[PairPyramids]:
        """Return the newest pair that is old enough, then an older one for slow vehicles."""
        motion = self.config.motion
        past = [k.pair for k in self._history if k.pair.stamp_ns < stamp_ns]
        out: list[StereoPair] = []
        for age_s in (motion.reference_s, motion.long_reference_s) if past else ():
            old = [p for p in past if (stamp_ns - p.stamp_ns) * 1e-9 >= age_s]
            one = old[-1] if old else past[0]
            if one not in out:
                out.append(one)
        return [self._pyramids_of(pair) for pair in out]

    def _pyramids_of(self, pair: StereoPair) -> PairPyramids:
        if pair.stamp_ns not in self._pyramids:
            if len(self._pyramids) >= _MOST_PYRAMIDS:
                del self._pyramids[min(self._pyramids)]
            self._pyramids[pair.stamp_ns] = PairPyramids.of(
                pair, self._regions, self._search.rig)
        return self._pyramids[pair.stamp_ns]

    def _since(self, before: PairPyramids) -> tuple[StereoPair, ...]:
        """Return an earlier pair and those since, without the newest."""
        return tuple(k.pair for k in list(self._history)[:-1]
                     if k.pair.stamp_ns >= before.pair.stamp_ns)

    def _forget_pairs(self) -> None:
        self._history.clear()
        self._pyramids.clear()

    def _trim(self) -> None:
        """Drop the pairs that neither late boxes nor comparisons with their pairs can need."""
        history, keep_ns = self._history, self.config.motion.long_reference_s * 1e9
        while len(history) > self.config.history_pairs + 2 and (
                history[-1 - self.config.history_pairs].pair.stamp_ns
                - history[1].pair.stamp_ns > keep_ns):
            history.popleft()
