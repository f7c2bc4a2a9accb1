# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Finds vehicles by itself: upright, symmetric fronts that come along a lane.

Proposals come from a plane sweep along each lane (``plane_sweep``); what both views and an earlier
pair must show of them is in ``front_search``.  A front
is symmetric besides: the lower part of a vehicle is; that of a two-wheeler need not be, for it is
outlined by what moves.  So vehicles are found from the second pair on, whatever the light, without
anything to be learned first.
"""
from __future__ import annotations

from collections import deque
import math
from typing import Mapping, Optional, Sequence

from .config import DetectorConfig
from .front_search import FoundFront, FrontSearch, Moment, NoiseEstimate
from .plane_sweep import PlaneSweep
from .protocol import Detection, TrackedRegion
from .pyramid import PairPyramids, PairRegions, region_of
from ..core.records import StereoPair
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_SAME_RATE = 0.01  # of a pair, by which stamps may scatter


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
        self.config = config
        self._search = FrontSearch(rig, lanes, config, config.least_symmetry)
        self._sweeps = {name: PlaneSweep(geometry, config)
                        for name, geometry in self._search.geometry.items()}
        self._regions = self._looked_at(list(self._sweeps))
        self._regions_of = {lane: self._looked_at([lane]) for lane in self._sweeps}
        self._past: deque[PairPyramids] = deque()
        self._due: deque[str] = deque()  # lanes that are still to be searched in this round
        self._last_ns: Optional[int] = None
        self._last_index: Optional[int] = None
        self._noise, self._searched = NoiseEstimate(), 0

    def _looked_at(self, lanes: Sequence[str]) -> PairRegions:
        """Return what of the images the sweeps of lanes look at."""
        rig, pixels = self._search.rig, [self._sweeps[lane].pixels for lane in lanes]
        return PairRegions(*(
            region_of([p[k] for p in pixels], (camera.width_px, camera.height_px))
            for k, camera in enumerate((rig.left, rig.right))))

    def reset(self) -> None:
        """Forget the earlier pairs, as after a jump back of time."""
        self._past.clear()
        self._due.clear()
        self._last_ns = self._last_index = None

    def update(self, pair: StereoPair, tracked: Sequence[TrackedRegion] = ()) -> list[Detection]:
        """
        Take in a pair and return the vehicles that no track holds.

        Each lane is searched once in ``interval_s``.  Where that takes several pairs, the lanes
        take turns, so that no pair takes much longer than the others.
        Where pairs were skipped because they came too fast, one lane a pair is searched: a pair
        that took longer would have the more of the next ones skipped.

        :param pair: in order of stamps; a gap in its numbers tells of those that were skipped.
        :param tracked: what the tracks hold, predicted for this pair.
        """
        if self._past and self._past[-1].age_s(pair.stamp_ns) > self.config.forget_after_s:
            self.reset()
        passed_s = math.inf if self._last_ns is None else (pair.stamp_ns - self._last_ns) * 1e-9
        self._last_ns = pair.stamp_ns
        begins = not (self._past
                      and self._past[-1].age_s(pair.stamp_ns) < self.config.interval_s)
        skipped = self._last_index is not None and pair.index - self._last_index > 1
        self._last_index = pair.index
        lanes = self._turn(begins, passed_s, skipped)
        if not (begins or lanes):
            return []
        regions = self._regions if begins or len(lanes) > 1 else self._regions_of[lanes[0]]
        now = PairPyramids.of(pair, regions, self._search.rig)
        if begins:
            if self._past:
                self._noise.learn(now, self._past[-1])
            self._searched += 1
        found = self._found(now, lanes, tracked)
        detections = [self._search.detection(f, pair, self._since(f.before))
                      for f in self._search.distinct(found)]
        if begins:
            self._remember(now)
        return [d for d in detections if d is not None]

    def _turn(self, begins: bool, passed_s: float, skipped: bool) -> list[str]:
        """
        Return the lanes whose turn it is.

        :param begins: whether a round does, in which each lane is searched.
        :param passed_s: since the last pair; it tells how many pairs share a round.
        :param skipped: whether pairs were, since the last one.
        """
        if begins:  # what a slower stream than expected has left over comes first
            self._due.extend(lane for lane in self._sweeps if lane not in self._due)
        pairs = max(math.ceil(self.config.interval_s / passed_s - _SAME_RATE), 1)
        count = 1 if skipped else math.ceil(len(self._sweeps) / pairs)
        return [self._due.popleft() for _ in range(min(count, len(self._due)))]

    def _found(self, now: PairPyramids, lanes: Sequence[str], tracked: Sequence[TrackedRegion]
               ) -> list[FoundFront]:
        """Return the fronts on some lanes, on no vehicle that is tracked."""
        past = self._references(now.pair.stamp_ns)
        found: list[FoundFront] = []
        if past:
            moment = Moment(now, past, self._noise.std)
            taken = self._search.spacing.tracked(tracked)
            for lane in lanes:
                proposals = self._sweeps[lane].proposals(now, past[-1], self._noise.std)
                found += self._search.search(lane, proposals, moment, taken,
                                             self.config.sweep.most_refined)
        return found

    def _references(self, stamp_ns: int) -> list[PairPyramids]:
        """Return the youngest pair that is old enough; at times, for the slow, an older too."""
        motion = self.config.motion
        ages_s = [motion.reference_s]
        if self._searched % self.config.long_every == 0:
            ages_s.append(motion.long_reference_s)
        out: list[PairPyramids] = []
        for age_s in ages_s if self._past else ():
            old = [v for v in self._past if v.age_s(stamp_ns) >= age_s]
            one = old[-1] if old else self._past[0]
            if one not in out:
                out.append(one)
        return out

    def _since(self, before: PairPyramids) -> tuple[StereoPair, ...]:
        return tuple(v.pair for v in self._past if v.age_s(before.pair.stamp_ns) <= 0)

    def _remember(self, now: PairPyramids) -> None:
        self._past.append(now)
        keep_s = self.config.motion.long_reference_s
        while len(self._past) > 2 and self._past[1].age_s(now.pair.stamp_ns) > keep_s:
            self._past.popleft()
