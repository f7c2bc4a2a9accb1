# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Finds vehicles by themselves: upright, symmetric faces that come along a lane.

Three things must agree.  Both views: what stands upright on the road at one depth (``scan``,
``faces``); what lies on the road, such as shadows, pools of light and paint, does not.  Its
look: the lower part of a front or rear is symmetric.  And time: it was further back along the lane
in an earlier pair (``motion``); what stands still is no vehicle in traffic.  So vehicles are
found from the second pair on, whatever the light, without anything to be learned first.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Mapping, NamedTuple, Optional, Sequence

import numpy as np

from .config import DetectorConfig
from .front_refiner import FrontHypothesis, FrontRefiner
from .lane_geometry import LaneGeometry
from .plane_sweep import PlaneSweep, Proposal
from .protocol import Detection, EarlierFront, TrackedRegion
from .pyramid import PairPyramids, region_of
from .temporal_match import find_motion, Motion, moved, moving_half
from ..core.records import Array, StereoPair
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_AXIS_M = 0.03  # 1-sigma of its middle
_ACROSS_M = 1.2  # vehicles whose middles are nearer are in each other's way,
_OVERLAP = 1.0  # and so are those that overlap
_LEAST_HALF_M = 0.8  # half the width of a vehicle whose track sees less of it
_NOISE_SHARE = 0.2  # of each pair in the running estimate of the noise
_NOISE_STEP = 8  # pixels between those that tell it
_MARGIN_PX = 2.0
_STALE_S = 3.0  # after a gap so long whatever was in view has left
_UPRIGHT_TIMES = 2.0  # upright, the views must differ so many times less than lying
_LEAST_DOUBT = 0.005
_MOST_SEEDS = 4  # of a lane, the best first, are looked into
_LONG_EVERY = 3  # at every so manieth time slow vehicles are looked for


@dataclass(frozen=True)
class _Place:
    """Where a face is and how wide, m."""

    centre_m: Array
    half_m: float


class _Candidate(NamedTuple):
    """A face of a lane that stands upright, among others."""

    lane: int
    finder: FrontRefiner
    face: FrontHypothesis
    place: _Place
    others: list[_Place]


@dataclass(frozen=True)
class _Found:
    """A verified face of a lane, its upper and its lower edge."""

    lane: int
    face: FrontHypothesis
    motion: Motion
    place: _Place
    heights_m: Array
    since: tuple[StereoPair, ...]


class PlaneSweepDetector:
    """
    Finds vehicles pair after pair; see the module's docstring.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: parameters.
    """

    Settings = DetectorConfig

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath],
                 config: DetectorConfig) -> None:
        self.rig, self.lanes, self.config = rig, dict(lanes), config
        self._names = list(self.lanes)
        self._geometry = [LaneGeometry(rig, lane) for lane in self.lanes.values()]
        self._scans = [PlaneSweep(g, config) for g in self._geometry]
        self._finders = [
            (FrontRefiner(g, config.face_low_m, config.face_high_m, config.least_width_m),
             FrontRefiner(g, config.tall_low_m, config.tall_high_m, config.tall_width_m))
            for g in self._geometry]
        self._regions = (
            region_of([scan.pixels[0] for scan in self._scans],
                      (rig.left.width_px, rig.left.height_px)),
            region_of([scan.pixels[1] for scan in self._scans],
                      (rig.right.width_px, rig.right.height_px)))
        self._past: deque[PairPyramids] = deque()
        self._noise, self._turn = 2.0, 0

    def reset(self) -> None:
        """Forget the earlier pairs, as after a jump back of time."""
        self._past.clear()

    def update(self, pair: StereoPair, occupied: Sequence[TrackedRegion] = ()) -> list[Detection]:
        """
        Take in a pair and find the vehicles that no track holds.

        :param pair: in order of stamps.
        :param occupied: what the tracks hold, predicted for this pair.
        """
        if self._past and (pair.stamp_ns - self._past[-1].stamp_ns) * 1e-9 > _STALE_S:
            self.reset()
        if self._past and (pair.stamp_ns - self._past[-1].stamp_ns) * 1e-9 \
                < self.config.interval_s:
            return []
        now = PairPyramids.of(pair, self._regions)
        found: list[_Found] = []
        self._learn_noise(now)
        past = self._references(now.stamp_ns)
        if past:
            taken = [self._held_place(o) for o in occupied if o.finite and o.lane in self.lanes]
            for lane in range(len(self._names)):
                found += self._search(lane, now, past, taken)
        self._remember(now)
        detections = (self._detection(f) for f in self._distinct(found))
        return [d for d in detections if self._inside(d.left_px, d.right_px)]

    def _inside(self, left_px: Array, right_px: Array) -> bool:
        """Say whether a quad lies well in both images."""
        for camera, quad in ((self.rig.left, left_px), (self.rig.right, right_px)):
            last = np.array([camera.width_px, camera.height_px]) - 1 - _MARGIN_PX
            if not ((quad >= _MARGIN_PX) & (quad <= last)).all():
                return False
        return True

    def _references(self, stamp_ns: int) -> list[PairPyramids]:
        """Give the youngest pair that is old enough; now and then, for the slow, an older too."""
        self._turn += 1
        ages_s = [self.config.reference_s]
        if self._turn % _LONG_EVERY == 0:
            ages_s.append(self.config.long_reference_s)
        out: list[PairPyramids] = []
        for age_s in ages_s if self._past else ():
            old = [v for v in self._past if (stamp_ns - v.stamp_ns) * 1e-9 >= age_s]
            one = old[-1] if old else self._past[0]
            if one not in out:
                out.append(one)
        return out

    def _since(self, before: PairPyramids) -> tuple[StereoPair, ...]:
        return tuple(v.pair for v in self._past if v.stamp_ns >= before.stamp_ns)

    def _remember(self, now: PairPyramids) -> None:
        self._past.append(now)
        keep_ns = self.config.long_reference_s * 1e9
        while len(self._past) > 2 and now.stamp_ns - self._past[1].stamp_ns > keep_ns:
            self._past.popleft()

    def _learn_noise(self, now: PairPyramids) -> None:
        """Estimate the noise of a grey value from how most pixels differ from a pair ago."""
        if not self._past:
            return
        a, b = (v.left.levels[0][::_NOISE_STEP, ::_NOISE_STEP] for v in (now, self._past[-1]))
        difference = a - b
        spread = float(np.median(np.abs(difference - np.median(difference))))
        noise = spread / 0.6745 / np.sqrt(2)
        self._noise += _NOISE_SHARE * (noise - self._noise)

    def _search(self, lane: int, now: PairPyramids, past: Sequence[PairPyramids],
                taken: Sequence[_Place]) -> list[_Found]:
        """Find and verify the faces of a lane."""
        seeds = self._scans[lane].seeds(now, past[-1], self._noise)
        out: list[_Found] = []
        for finder in self._finders[lane]:
            free = [seed for seed in seeds if not self._held(
                lane, seed, [*taken, *(f.place for f in out)])][:_MOST_SEEDS]
            faces = finder.refine(free, now, self._noise)
            for face in sorted(faces, key=lambda f: -min(f.cross_ncc, f.symmetry)):
                place = self._place(lane, face.s_m, face.x_m, face.half_m)
                others = [*taken, *(f.place for f in out)]
                if any(self._overlap(lane, place, other) for other in others) \
                        or not self._upright(face, finder, now):
                    continue
                one = self._came(_Candidate(lane, finder, face, place, others), now, past)
                if one is not None:
                    out.append(one)
        return out

    def _came(self, one: _Candidate, now: PairPyramids, past: Sequence[PairPyramids]
              ) -> Optional[_Found]:
        """Find in which of the earlier pairs a face was seen, further back along its lane."""
        for before in past:
            motion = find_motion(one.finder, one.face, now, before, self.config)
            spacing_m = self.config.spacing_m + self.config.headway_s * motion.speed_mps
            if not moved(motion, self.config) or any(
                    self._overlap(one.lane, one.place, other, spacing_m)
                    for other in one.others):
                continue
            half_m = moving_half(one.finder, one.face, motion, now, before, self._noise)
            if half_m > 0:
                return _Found(one.lane, replace(one.face, half_m=half_m), motion, one.place,
                              one.finder.heights_m[[0, -1]], self._since(before))
        return None

    def _held(self, lane: int, seed: Proposal, taken: Sequence[_Place]) -> bool:
        """Say whether a seed is on a vehicle that a track holds."""
        place = self._place(lane, seed.s_m, seed.x_m, 0.0)
        return any(self._overlap(lane, place, other) for other in taken)

    def _upright(self, face: FrontHypothesis, finder: FrontRefiner, now: PairPyramids) -> bool:
        """Say whether a face stands on its plane and looks like one."""
        c = self.config
        doubt = max(1 - face.cross_ncc, _LEAST_DOUBT)
        return (face.cross_ncc >= c.least_cross_ncc and face.symmetry >= c.least_symmetry
                and abs(face.x_m) < c.reach_m
                and 1 - finder.lying_ncc(face, now) > _UPRIGHT_TIMES * doubt)

    def _place(self, lane: int, s_m: float, x_m: float, half_m: float) -> _Place:
        height = np.array([(self.config.face_low_m + self.config.face_high_m) / 2])
        return _Place(self._geometry[lane].points(
            np.array([s_m]), np.array([x_m]), height)[0, 0, 0], half_m)

    def _held_place(self, held: TrackedRegion) -> _Place:
        path = self.lanes[held.lane].path
        s = np.array(held.s_m)
        return _Place(path.position(s) + held.lateral_m * path.frame(s)[:, 1],
                      max(held.width_m / 2, _LEAST_HALF_M))

    def _overlap(self, lane: int, one: _Place, other: _Place,
                 spacing_m: Optional[float] = None) -> bool:
        """Say whether two faces are nearer to each other than two vehicles can be."""
        path = self.lanes[self._names[lane]].path
        frame = path.frame(path.arc_length(other.centre_m))
        apart = np.abs(frame.T @ (one.centre_m - other.centre_m))
        across = max(_OVERLAP * (one.half_m + other.half_m), _ACROSS_M)
        return bool(apart[0] < (spacing_m or self.config.spacing_m) and apart[1] < across)

    def _distinct(self, found: Sequence[_Found]) -> list[_Found]:
        """Keep the best of those that are the same vehicle, seen from two lanes."""
        out: list[_Found] = []
        for one in sorted(found, key=lambda f: abs(f.face.x_m)):
            if not any(self._overlap(one.lane, one.place, f.place) for f in out):
                out.append(one)
        return out

    def _detection(self, found: _Found) -> Detection:
        face, motion = found.face, found.motion
        rates = self._geometry[found.lane].rates(np.array([face.s_m]))
        left, right = self._quads(found, face.s_m, face.x_m)
        then = self._quads(found, face.s_m - motion.gone_m, face.x_m + motion.aside_m)
        px_per_m = float(rates.px_per_m[0])
        return Detection(
            lane=self._names[found.lane], left_px=left, right_px=right,
            std_px=_AXIS_M * px_per_m, s_m=face.s_m, lateral_m=face.x_m,
            width_m=2 * face.half_m, height_m=float(np.ptp(found.heights_m)),
            speed_mps=motion.speed_mps,
            speed_std_mps=self.config.speed_std_share * motion.speed_mps,
            earlier=EarlierFront(pairs=found.since, left_px=then[0], right_px=then[1])
            if self._inside(*then) else None)

    def _quads(self, found: _Found, s_m: float, x_m: float) -> tuple[Array, Array]:
        """Project the corners of a face at a place, clockwise, into both views."""
        edges = x_m + np.array([-1.0, 1.0]) * found.face.half_m
        left, right, _, _ = self._geometry[found.lane].project(
            np.array([s_m]), edges, found.heights_m)
        return _clockwise(left[0]), _clockwise(right[0])


def _clockwise(corners: Array) -> Array:
    """Order corners (upper and lower, by x) clockwise from the image's top left."""
    if corners[0, 0, 0] > corners[0, 1, 0]:
        corners = corners[:, ::-1]
    return np.stack([corners[0, 0], corners[0, 1], corners[1, 1], corners[1, 0]])
