# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Turns proposals into fronts of vehicles; shared by all detectors of this package.

A front must pass two tests.  By both views it stands upright on the road at one depth, unlike
shadows, pools of light and lane markings, which lie on the road.  By time it was further back
along the lane in an earlier pair, unlike anything that stands still.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Mapping, Optional, Protocol, Sequence

import numpy as np

from .config import FrontConfig, MotionConfig, SpacingConfig
from .front_refiner import AS_SHARP, FrontKind, FrontRefiner
from .front_sampler import FrontHypothesis, FrontSampler, GRID_M
from .lamps import Look, uncut_heights
from .lane_geometry import LaneGeometry, well_inside
from .outline import going_extent, moving_outline
from .plane_sweep import Proposal
from .protocol import Detection, EarlierFront
from .pyramid import PairPyramids
from .spacing import Held, Lengths, MovingBeside, Place, Spacing
from .temporal_match import (
    find_motion, find_travel, Interval, Motion, moved, moving_half)
from ..core.records import Array, StereoPair
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_LEAST_DOUBT = 0.005  # least value of 1 - NCC; no two views agree better than this
# Levels of (left, right) to try: a coarser level of one view matches the other if that is out of
# focus; coarser levels of both have less noise.
_SHARPNESSES = (AS_SHARP, (1, 0), (0, 1), (2, 0), (0, 2)), ((1, 1),)
_WHOLE_SHARE = 0.85  # share of a front's width below which only part of it is visible
_OWN_M = 0.25  # by which what moves may extend beyond the edge of the front that it belongs to
_BLUR_M = 0.15  # by which the width of everything that moves with a front is overestimated
_NOISE_SHARE = 0.2  # weight of a pair in the running estimate of the noise
_NOISE_STEP = 8  # spacing of the pixels that the noise is estimated from
FIRST_NOISE = 2.0  # grey levels, assumed before two pairs have been seen
_NORMAL = 0.6745  # median of the absolute value of a normal variable of unit variance


class SearchConfig(Protocol):
    """The parameters that all detectors of this package have."""

    @property
    def front(self) -> FrontConfig:
        """Return what both views must show of a front."""

    @property
    def motion(self) -> MotionConfig:
        """Return how a front must have moved."""

    @property
    def spacing(self) -> SpacingConfig:
        """Return how close two vehicles can be."""


@dataclass(frozen=True, eq=False)
class FoundFront:
    """
    A front that stands upright and has moved along its lane.

    :param lane: name of its lane.
    :param front: its place and width.
    :param motion: its motion since the earlier pair.
    :param place: its place, for distances from others.
    :param sampler: sampler of its lane at its heights.
    :param before: the earlier pair.
    :param heights_m: (2,) heights of its upper and its lower edge above the road, m.
    """

    lane: str
    front: FrontHypothesis
    motion: Motion
    place: Place
    sampler: FrontSampler
    before: PairPyramids
    heights_m: Array


@dataclass(frozen=True, eq=False)
class Moment:
    """
    The pairs in which fronts are searched for.

    :param now: the pair.
    :param past: earlier pairs in which fronts may be found further back, in the order to try.
    :param noise: 1-sigma of a grey value.
    """

    now: PairPyramids
    past: Sequence[PairPyramids]
    noise: float


class NoiseEstimate:
    """
    A running estimate of the noise of grey values, from robust differences between pairs.

    :param std: initial 1-sigma.
    """

    def __init__(self, std: float = FIRST_NOISE) -> None:
        self.std = std

    def learn(self, now: PairPyramids, before: PairPyramids) -> None:
        """Update the estimate by two pairs."""
        places = now.left.places(_NOISE_STEP)
        a, b = (v.left.pick(places) for v in (now, before))
        difference = a - b
        spread = float(np.median(np.abs(difference - np.median(difference))))
        self.std += _NOISE_SHARE * (spread / _NORMAL / np.sqrt(2) - self.std)


class FrontSearch:
    """
    Turns proposals into fronts.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters.
    :param least_symmetry: least correlation of a front with its mirror image; None where fronts
        need not be symmetric.
    """

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath], config: SearchConfig,
                 least_symmetry: Optional[float]) -> None:
        self.rig, self.lanes, self.config = rig, dict(lanes), config
        self.least_symmetry = least_symmetry
        self.spacing = Spacing(self.lanes, config.spacing)
        self.geometry = {name: LaneGeometry(rig, lane) for name, lane in self.lanes.items()}
        front = config.front
        kinds = (FrontKind(front.low_m, front.high_m, front.least_width_m),
                 FrontKind(front.tall_low_m, front.tall_high_m, front.tall_width_m),
                 FrontKind(front.raised_low_m, front.raised_high_m, front.least_width_m),
                 FrontKind(front.narrow_low_m, front.narrow_high_m, front.narrow_least_m,
                           front.narrow_most_m))
        self._refiners = {
            name: [FrontRefiner(geometry, kind, front, config.motion, least_symmetry)
                   for kind in kinds]
            for name, geometry in self.geometry.items()}

    def search(self, lane: str, proposals: Sequence[Proposal], moment: Moment,
               taken: Held, most: int, symmetric: bool = True) -> list[FoundFront]:
        """
        Return the fronts of a lane that result from proposals.

        :param lane: name of the lane.
        :param proposals: proposals, the best first.
        :param moment: the pair and earlier pairs.
        :param taken: places where no vehicle is searched for.
        :param most: greatest number of proposals that are refined for each kind of front.
        :param symmetric: whether middle and width of fronts are found by their symmetry.
        """
        out: list[FoundFront] = []
        places = self._places(lane, proposals)
        held = taken.anew()
        for refiner in self._refiners[lane]:
            free = [p for p, place in zip(proposals, places) if not held.meet(
                lane, place)][:most]
            interval = Interval(moment.now, moment.past[0])
            fronts = refiner.refine(free, interval, moment.noise, symmetric)
            if refiner.kind.narrow_m is not None and symmetric:
                fronts += refiner.refine(self._outlined(free, refiner, interval, moment.noise),
                                         interval, moment.noise, False)
            for front in sorted(fronts, key=lambda f: -min(f.cross_ncc, f.symmetry)):
                found = self._verified(lane, refiner, front, moment, held)
                if found is not None:
                    out.append(self._whole(found, moment, held) if symmetric else found)
                    held.add(out[-1].place)
        return out

    def _whole(self, found: FoundFront, moment: Moment, others: Held) -> FoundFront:
        """
        Return a front found at greater height, if only part of its width shows lower down.

        At night the bumper of a lorry is dark, and its lamps are higher up.
        """
        low, tall = self._refiners[found.lane][:2]
        if found.sampler is not low.sampler:
            return found
        proposal = Proposal(found.front.s_m, found.front.x_m, ahead_m=found.front.ahead_m)
        for front in tall.refine([proposal], Interval(moment.now, found.before), moment.noise):
            if found.front.half_m >= _WHOLE_SHARE * front.half_m:
                continue
            higher = self._verified(found.lane, tall, front, moment, others)
            # Both widths are now those of the moving part.
            if higher is not None and found.front.half_m < _WHOLE_SHARE * higher.front.half_m:
                return higher
        return found

    def _outlined(self, proposals: Sequence[Proposal], refiner: FrontRefiner, interval: Interval,
                  noise: float) -> list[Proposal]:
        """Return proposals with middle and width of the narrow moving outline found there."""
        out = []
        for one in proposals:
            found = moving_outline(refiner.sampler, one.x_m, one.s_m,
                                   2 * refiner.kind.half * GRID_M, interval, noise,
                                   self.config.motion)
            if found is not None and 2 * found[1] >= refiner.kind.least_width_m:
                out.append(replace(one, x_m=found[0], half_m=found[1]))
        return out

    def _verified(self, lane: str, refiner: FrontRefiner, front: FrontHypothesis, moment: Moment,
                  others: Held) -> Optional[FoundFront]:
        """Return a front that stands upright and was further back in one of the earlier pairs."""
        place = self._place(lane, front.s_m, front.x_m, front.half_m)
        if others.meet(lane, place) or (
                refiner.kind.narrow_m is not None and self._is_at_side(lane, place, others)):
            return None
        if not self._is_upright(front, refiner, moment.now):
            return None
        for before in moment.past:
            interval = Interval(moment.now, before)
            motion = find_motion(refiner.sampler, front, interval, self.config.motion)
            if not moved(motion, self.config.motion) or others.meet(
                    lane, place, motion.speed_mps):
                continue
            half_m = moving_half(refiner.sampler, front, motion, interval, moment.noise,
                                 self.config.motion)
            if half_m > 0:
                moving = replace(front, half_m=half_m)
                if refiner.kind.narrow_m is None and not refiner.is_one_body(
                        moving, moment.now, _SHARPNESSES[0]):
                    return None  # halves of a two-wheeler are too narrow to tell
                found = FoundFront(lane, moving, motion, place, refiner.sampler, before,
                                   refiner.sampler.heights_m[[0, -1]])
                # Final, as another pair may not show the wider front.
                return None if self._is_part(
                    found, front, refiner, interval, moment.noise, others) else found
        return None

    def _is_at_side(self, lane: str, place: Place, others: Held) -> bool:
        """Return whether a place is at the side of a vehicle, given the lengths of vehicles."""
        limits = self.config.front
        return (others.is_at_side(lane, place, limits.narrow_behind_m, limits.narrow_side_m,
                                  limits.narrow_car_width_m / 2)
                or others.is_at_side(lane, place, limits.narrow_behind_car_m,
                                     limits.narrow_side_m))

    def _is_upright(self, front: FrontHypothesis, refiner: FrontRefiner, now: PairPyramids
                    ) -> bool:
        """Return whether a front stands on its plane and is symmetric where it has to be."""
        looks_like_one = (self.least_symmetry is None or refiner.kind.narrow_m is not None
                          or front.symmetry >= self.least_symmetry)
        return (looks_like_one and abs(front.x_m) < self.config.front.reach_m
                and any(self._stands(front, refiner, now, some) for some in _SHARPNESSES))

    def _stands(self, front: FrontHypothesis, refiner: FrontRefiner, now: PairPyramids,
                sharpnesses: Sequence[tuple[int, int]]) -> bool:
        """
        Return whether the views of a front agree on its plane, and much less on the road.

        :param sharpnesses: trial pyramid levels, coarser than the usual one, of the left and the
            right view; the best of them is used for each hypothesis.
        """
        limits = self.config.front
        stands, lies = (max(ncc(front, now, coarser) for coarser in sharpnesses)
                        for ncc in (refiner.standing_ncc, refiner.lying_ncc))
        if AS_SHARP in sharpnesses:  # the refined NCC is interpolated, and so higher
            stands = max(stands, front.cross_ncc)
        return (stands >= limits.least_cross_ncc
                and 1 - lies > limits.upright_factor * max(1 - stands, _LEAST_DOUBT))

    def _is_part(self, found: FoundFront, front: FrontHypothesis, refiner: FrontRefiner,
                 interval: Interval, noise: float, others: Held) -> bool:
        """
        Return whether a narrow front is part of a wider one that moves with it.

        :param found: the front, as wide as what moves.
        :param front: the same, as wide as it looks.
        """
        kind, limits = refiner.kind, self.config
        if kind.narrow_m is None:
            return False
        sizes = limits.front
        # How far its own rider and luggage are seen to the left of it; to the right if negative.
        aslant_m = sizes.narrow_length_m * refiner.sampler.geometry.aslant(front.s_m, front.x_m)
        most_m = kind.narrow_m + abs(aslant_m) + _BLUR_M
        extent = going_extent(
            refiner.sampler, front, found.motion, interval, noise, limits.motion,
            refiner.apart_shift_m(front.s_m))
        if extent.width_m <= most_m:
            return False
        own_m = front.half_m + _OWN_M
        lengths = Lengths(sizes.narrow_behind_car_m, sizes.narrow_behind_m,
                          sizes.narrow_car_width_m / 2)
        return not others.stands_alone(found.lane, found.place, MovingBeside(
            extent, min(aslant_m, 0.0) - own_m, max(aslant_m, 0.0) + own_m, most_m, lengths))

    def _place(self, lane: str, s_m: float, x_m: float, half_m: float) -> Place:
        middle = self._middles(lane, np.array([s_m]), np.array([x_m]))[0]
        return Place(middle, half_m, lane)

    def _places(self, lane: str, proposals: Sequence[Proposal]) -> list[Place]:
        """Return the places of proposals, with zero width."""
        middles = self._middles(lane, np.array([p.s_m for p in proposals]),
                                np.array([p.x_m for p in proposals]))
        return [Place(middle, 0.0, lane) for middle in middles]

    def _middles(self, lane: str, s_m: Array, x_m: Array) -> Array:
        """Return the middles (n, 3) of fronts, left optical frame, m."""
        front = self.config.front
        height = np.array([(front.low_m + front.high_m) / 2])
        return self.geometry[lane].points(s_m, x_m[:, None], height)[:, 0, 0]

    def followed(self, found: FoundFront, then: PairPyramids, now: PairPyramids
                 ) -> Optional[FoundFront]:
        """
        Return a front as it is in a later pair; None where it is not seen there.

        :param found: the front.
        :param then: the pair that it was found in.
        :param now: the later pair.
        """
        front, motion = found.front, found.motion
        later = Interval(then, now)  # reversed in time, so the distance travelled is negative
        travel = find_travel(found.sampler, front, later, self.config.motion,
                             motion.speed_mps * later.seconds)
        if travel.ncc < self.config.motion.least_ncc:
            return None
        gone_m = motion.gone_m - travel.gone_m
        speed_mps = gone_m / Interval(now, found.before).seconds
        front = replace(front, s_m=front.s_m - travel.gone_m, x_m=front.x_m + travel.aside_m,
                        ahead_m=now.pair.right_lag_s * speed_mps)
        return replace(
            found, front=front, place=self._place(found.lane, front.s_m, front.x_m, front.half_m),
            motion=replace(motion, speed_mps=speed_mps, gone_m=gone_m,
                           aside_m=motion.aside_m - travel.aside_m))

    def distinct(self, found: Sequence[FoundFront]) -> list[FoundFront]:
        """Return one front per vehicle, the nearest to its path, if two lanes found the same."""
        out: list[FoundFront] = []
        for one in sorted(found, key=lambda f: abs(f.front.x_m)):
            if not self.spacing.meet(one.lane, one.place, [f.place for f in out]):
                out.append(one)
        return out

    def detection(self, found: FoundFront, now: StereoPair, since: tuple[StereoPair, ...]
                  ) -> Optional[Detection]:
        """
        Return the detection of a front; None where it does not lie well inside both images.

        Its upper and its lower edge are off lamps that clip, where they can be.

        :param found: the front.
        :param now: the newest pair.
        :param since: the earlier pair that shows it and those since, without the newest.
        """
        front, motion, before = found.front, found.motion, found.before.pair
        earlier = replace(front, s_m=front.s_m - motion.gone_m, x_m=front.x_m + motion.aside_m,
                          ahead_m=before.right_lag_s * motion.speed_mps)
        found = replace(found, heights_m=uncut_heights(
            self.geometry[found.lane], found.heights_m,
            [Look.now(front, now), Look.before(earlier, found.before)]))
        left, right = self.quads(found, front, now)
        if not self._inside(left, right):
            return None
        then = self.quads(found, earlier, before)
        rates = self.geometry[found.lane].rates(np.array([front.s_m]))
        return Detection(
            lane=found.lane, left_px=left, right_px=right,
            std_px=self.config.front.axis_std_m * float(rates.px_per_m[0]),
            s_m=front.s_m, lateral_m=front.x_m, width_m=2 * front.half_m,
            height_m=float(np.ptp(found.heights_m)), speed_mps=motion.speed_mps,
            speed_std_mps=self.config.motion.speed_std_share * motion.speed_mps,
            earlier=EarlierFront(pairs=since, left_px=then[0], right_px=then[1])
            if self._inside(*then) else None)

    def quads(self, found: FoundFront, front: FrontHypothesis, pair: StereoPair
              ) -> tuple[Array, Array]:
        """Return the corners (4, 2) of a front, clockwise, in both views of a pair."""
        edges = front.x_m + np.array([-1.0, 1.0]) * front.half_m
        geometry, rig = self.geometry[found.lane], self.rig.as_taken(pair.motion)
        left, right = (rig.project(geometry.points(
            np.array([front.s_m + ahead_m]), edges, found.heights_m))[side]
            for side, ahead_m in enumerate((0.0, front.ahead_m)))
        return _clockwise(left[0]), _clockwise(right[0])

    def _inside(self, left_px: Array, right_px: Array) -> bool:
        """Return whether a quad lies in both images, off their edges."""
        return bool(well_inside(self.rig.left, left_px).all()
                    and well_inside(self.rig.right, right_px).all())


def _clockwise(corners: Array) -> Array:
    """Return corners (upper and lower, by x) clockwise from the image's top left."""
    if corners[0, 0, 0] > corners[0, 1, 0]:
        corners = corners[:, ::-1]
    return np.stack([corners[0, 0], corners[0, 1], corners[1, 1], corners[1, 0]])
