# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The plane-sweep detector: finds upright, symmetric fronts that move along a lane.

Proposals come from a plane sweep along each lane (``plane_sweep``).  ``front_search`` defines what
both views and an earlier pair must show of them.  A front must also be symmetric, as the lower
part of a vehicle is; that of a two-wheeler need not be, as it is outlined by motion.  Vehicles are
thus found from the second pair on, in any light, and without training.
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Mapping, Optional, Sequence

from .config import DetectorConfig
from .front_search import FIRST_NOISE, FrontSearch, Moment, NoiseEstimate
from .plane_sweep import PlaneSweep, Proposal
from .protocol import Detection, TrackedRegion
from .pyramid import PairPyramids, PairRegions, region_of
from .spacing import Held
from ..core.records import StereoPair
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

_SAME_RATE = 0.01  # tolerance for uneven stamps, as a share of a pair
_MANY_PAIRS = 3  # pairs per round that count as many: above 22 a second, faster than most cameras


@dataclass(frozen=True, eq=False)
class Look:
    """
    The part of a search that does not depend on the tracks.

    :param moment: the pair and those that it is compared with.
    :param past: earlier pairs that are kept.
    :param proposals: lane to its proposals, the best first, for the lanes that are searched.
    """

    moment: Moment
    past: tuple[PairPyramids, ...]
    proposals: Mapping[str, Sequence[Proposal]]

    def since(self, before: PairPyramids) -> tuple[StereoPair, ...]:
        """Return an earlier pair and the kept pairs since."""
        return tuple(v.pair for v in self.past if v.age_s(before.pair.stamp_ns) <= 0)


@dataclass(frozen=True)
class Memory:
    """
    The state of a detector, without the images of the pairs that it keeps.

    :param past_ns: stamps of the earlier pairs that vehicles may be found in.
    :param due: lanes that are still to be searched in this round.
    :param last_ns: stamp of the last pair, ns; None before the first.
    :param last_index: number of the last pair; None before the first.
    :param noise: 1-sigma of a grey value.
    :param searched: number of rounds so far.
    """

    past_ns: tuple[int, ...] = ()
    due: tuple[str, ...] = ()
    last_ns: Optional[int] = None
    last_index: Optional[int] = None
    noise: float = FIRST_NOISE
    searched: int = 0

    def forgotten(self) -> Memory:
        """Return the state after a jump back in time."""
        return Memory(noise=self.noise, searched=self.searched)

    def begins(self, stamp_ns: int, config: DetectorConfig) -> bool:
        """
        Return whether a round, in which each lane is searched, begins with the next pair.

        Rounds begin ``interval_s`` apart, and compare with pairs of ``reference_s`` ago.  At high
        rates they begin ``reference_s`` apart: an earlier round would show little that the last
        one did not, and detections are followed back to that time anyway.

        :param stamp_ns: stamp of the next pair.
        """
        if not self.past_ns:
            return True
        passed_s = math.inf if self.last_ns is None else (stamp_ns - self.last_ns) * 1e-9
        many = pairs_a_round(passed_s, config) >= _MANY_PAIRS
        round_s = max(config.interval_s, config.motion.reference_s if many else 0.0)
        age_s = (stamp_ns - self.past_ns[-1]) * 1e-9
        return age_s >= round_s or age_s > config.forget_after_s

    def passing(self, pair: StereoPair, config: DetectorConfig) -> Optional[Memory]:
        """Return the state after the next pair if that is not searched; None if it is."""
        if self.due or self.begins(pair.stamp_ns, config):
            return None
        return replace(self, last_ns=pair.stamp_ns, last_index=pair.index)


def pairs_a_round(passed_s: float, config: DetectorConfig) -> int:
    """Return how many pairs at this interval share a round of ``interval_s``."""
    return max(math.ceil(config.interval_s / passed_s - _SAME_RATE), 1)


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
        self.spacing = self._search.spacing
        self._sweeps = {name: PlaneSweep(geometry, config)
                        for name, geometry in self._search.geometry.items()}
        self._past: deque[PairPyramids] = deque()
        self._due: deque[str] = deque()  # lanes that are still to be searched in this round
        self._last_ns: Optional[int] = None
        self._last_index: Optional[int] = None
        self._noise, self._searched = NoiseEstimate(), 0

    @cached_property
    def _regions(self) -> PairRegions:
        """Return the regions that all sweeps use; unused where another process searches."""
        return self._looked_at(list(self._sweeps))

    @cached_property
    def _regions_of(self) -> dict[str, PairRegions]:
        """Return the regions that the sweep of each lane uses."""
        return {lane: self._looked_at([lane]) for lane in self._sweeps}

    def _looked_at(self, lanes: Sequence[str]) -> PairRegions:
        """Return the regions of the images that the sweeps of lanes use."""
        rig, pixels = self._search.rig, [self._sweeps[lane].pixels for lane in lanes]
        return PairRegions(*(
            region_of([p[k] for p in pixels], (camera.width_px, camera.height_px))
            for k, camera in enumerate((rig.left, rig.right))))

    @property
    def pairs(self) -> dict[int, StereoPair]:
        """Return the earlier pairs that vehicles may be found in, by stamp."""
        return {v.pair.stamp_ns: v.pair for v in self._past}

    @property
    def memory(self) -> Memory:
        """Return the state without the images of kept pairs."""
        return Memory(tuple(self.pairs), tuple(self._due), self._last_ns, self._last_index,
                      self._noise.std, self._searched)

    def recall(self, memory: Memory, pairs: Mapping[int, StereoPair]) -> None:
        """
        Continue from the state of another detector.

        :param memory: that state.
        :param pairs: stamp to pair, for the pairs that the state refers to.
        """
        self._past = deque(PairPyramids.of(pairs[ns], self._regions, self._search.rig)
                           for ns in memory.past_ns)
        self._due = deque(memory.due)
        self._last_ns, self._last_index = memory.last_ns, memory.last_index
        self._noise, self._searched = NoiseEstimate(memory.noise), memory.searched

    def pass_over(self, last_ns: Optional[int], last_index: Optional[int]) -> None:
        """
        Register pairs that were not to be searched.

        :param last_ns: stamp of the last pair before the next search.
        :param last_index: number of that pair.
        """
        self._last_ns, self._last_index = last_ns, last_index

    def reset(self) -> None:
        """Discard all earlier pairs, as after a jump back in time."""
        self._past.clear()
        self._due.clear()
        self._last_ns = self._last_index = None

    def update(self, pair: StereoPair, tracked: Sequence[TrackedRegion] = ()) -> list[Detection]:
        """
        Process a pair and return the vehicles that no track holds.

        :param pair: pairs in order of stamps; a gap in their numbers means that some were skipped.
        :param tracked: regions that tracks hold, predicted for this pair.
        """
        return self.detections(self.look(pair), self.held(tracked))

    def held(self, tracked: Sequence[TrackedRegion]) -> Held:
        """Return the places that tracks hold."""
        return Held(self.spacing, self.spacing.tracked(tracked))

    def look(self, pair: StereoPair) -> Optional[Look]:
        """
        Process a pair and return the part of the search that does not depend on the tracks.

        Each lane is searched once in ``interval_s``.  If several pairs come in it, the lanes
        take turns, so that no pair takes much longer than the others; if many come, once in
        ``motion.reference_s`` is enough.  If pairs were skipped because they came too fast, only
        one lane is searched per pair, as a longer search would cause more pairs to be skipped.

        :param pair: as for :meth:`update`.
        :return: None where nothing is searched in this pair.
        """
        if self._past and self._past[-1].age_s(pair.stamp_ns) > self.config.forget_after_s:
            self.reset()
        passed_s = math.inf if self._last_ns is None else (pair.stamp_ns - self._last_ns) * 1e-9
        begins, self._last_ns = self.memory.begins(pair.stamp_ns, self.config), pair.stamp_ns
        skipped = self._last_index is not None and pair.index - self._last_index > 1
        self._last_index = pair.index
        lanes = self._turn(begins, passed_s, skipped)
        if not (begins or lanes):
            return None
        regions = self._regions if begins or len(lanes) > 1 else self._regions_of[lanes[0]]
        now = PairPyramids.of(pair, regions, self._search.rig)
        if begins:
            if self._past:
                self._noise.learn(now, self._past[-1])
            self._searched += 1
        moment = Moment(now, self._references(pair.stamp_ns), self._noise.std)
        look = Look(moment, tuple(self._past), {
            lane: self._sweeps[lane].proposals(now, moment.past[-1], moment.noise)
            for lane in (lanes if moment.past else ())})
        if begins:
            self._remember(now)
        return look

    def detections(self, look: Optional[Look], held: Held) -> list[Detection]:
        """
        Return the vehicles that no track holds, without changing the state of the detector.

        :param look: result of :meth:`look` for a pair.
        :param held: places that tracks hold; it records the questions that it is asked.
        """
        if look is None:
            return []
        found = [front for lane, proposals in look.proposals.items()
                 for front in self._search.search(lane, proposals, look.moment, held,
                                                  self.config.sweep.most_refined)]
        detections = [self._search.detection(f, look.moment.now.pair, look.since(f.before))
                      for f in self._search.distinct(found)]
        return [d for d in detections if d is not None]

    def _turn(self, begins: bool, passed_s: float, skipped: bool) -> list[str]:
        """
        Return the lanes whose turn it is.

        :param begins: whether a round begins, in which each lane is searched.
        :param passed_s: time since the last pair, which decides how many pairs share a round, s.
        :param skipped: whether pairs were skipped since the last one.
        """
        if begins:  # lanes left over from a stream slower than expected come first
            self._due.extend(lane for lane in self._sweeps if lane not in self._due)
        pairs = pairs_a_round(passed_s, self.config)
        count = 1 if skipped else math.ceil(len(self._sweeps) / pairs)
        return [self._due.popleft() for _ in range(min(count, len(self._due)))]

    def _references(self, stamp_ns: int) -> list[PairPyramids]:
        """Return the newest pair that is old enough; in some rounds also an older one."""
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

    def _remember(self, now: PairPyramids) -> None:
        self._past.append(now)
        keep_s = self.config.motion.long_reference_s
        while len(self._past) > 2 and self._past[1].age_s(now.pair.stamp_ns) > keep_s:
            self._past.popleft()
