# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Finds vehicles by itself: upright, symmetric fronts that come along a lane.

Proposals come from a plane sweep along each lane (``plane_sweep``); what both views and an earlier
pair must show of them is in ``front_search``.  A front is symmetric besides: the lower part of a
vehicle is.  So vehicles are found from the second pair on, whatever the light, without anything to
be learned first.
"""
from __future__ import annotations

from collections import deque
from typing import Mapping, Sequence

from .config import DetectorConfig
from .front_search import FoundFront, FrontSearch, Moment, NoiseEstimate
from .plane_sweep import PlaneSweep
from .protocol import Detection, TrackedRegion
from .pyramid import PairPyramids, PairRegions, region_of
from ..core.records import StereoPair
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath


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
        pixels = [sweep.pixels for sweep in self._sweeps.values()]
        self._regions = PairRegions(*(
            region_of([p[k] for p in pixels], (camera.width_px, camera.height_px))
            for k, camera in enumerate((rig.left, rig.right))))
        self._past: deque[PairPyramids] = deque()
        self._noise, self._searched = NoiseEstimate(), 0

    def reset(self) -> None:
        """Forget the earlier pairs, as after a jump back of time."""
        self._past.clear()

    def update(self, pair: StereoPair, tracked: Sequence[TrackedRegion] = ()) -> list[Detection]:
        """
        Take in a pair and return the vehicles that no track holds.

        :param pair: in order of stamps.
        :param tracked: what the tracks hold, predicted for this pair.
        """
        if self._past and self._past[-1].age_s(pair.stamp_ns) > self.config.forget_after_s:
            self.reset()
        if self._past and self._past[-1].age_s(pair.stamp_ns) < self.config.interval_s:
            return []
        now = PairPyramids.of(pair, self._regions, self._search.rig)
        if self._past:
            self._noise.learn(now, self._past[-1])
        self._searched += 1
        past = self._references(pair.stamp_ns)
        found: list[FoundFront] = []
        if past:
            moment = Moment(now, past, self._noise.std)
            taken = self._search.spacing.tracked(tracked)
            for lane, sweep in self._sweeps.items():
                proposals = sweep.proposals(now, past[-1], self._noise.std)
                found += self._search.search(lane, proposals, moment, taken,
                                             self.config.sweep.most_refined)
        detections = [self._search.detection(f, pair, self._since(f.before))
                      for f in self._search.distinct(found)]
        self._remember(now)
        return [d for d in detections if d is not None]

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
