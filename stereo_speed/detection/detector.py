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

_SAME_RATE = 0.01  # of a pair, by which stamps may scatter
_MANY_PAIRS = 3  # in a round: more than 22 a second, faster than most cameras


@dataclass(frozen=True, eq=False)
class Look:
    """
    What is seen of a pair whatever the tracks hold.

    :param moment: the pair and those that it is compared with.
    :param past: earlier pairs that are remembered.
    :param proposals: by the lanes whose turn it is, the best first.
    """

    moment: Moment
    past: tuple[PairPyramids, ...]
    proposals: Mapping[str, Sequence[Proposal]]

    def since(self, before: PairPyramids) -> tuple[StereoPair, ...]:
        """Return an earlier pair and those since that are remembered."""
        return tuple(v.pair for v in self.past if v.age_s(before.pair.stamp_ns) <= 0)


@dataclass(frozen=True)
class Memory:
    """
    What a detector remembers of the pairs so far, but for their images.

    :param past_ns: stamps of the earlier pairs that vehicles may be found in.
    :param due: lanes that are still to be searched in this round.
    :param last_ns: stamp of the last pair, and
    :param last_index: its number; None before there was one.
    :param noise: 1-sigma of a grey value.
    :param searched: rounds so far.
    """

    past_ns: tuple[int, ...] = ()
    due: tuple[str, ...] = ()
    last_ns: Optional[int] = None
    last_index: Optional[int] = None
    noise: float = FIRST_NOISE
    searched: int = 0

    def forgotten(self) -> Memory:
        """Return what is left after a jump back of time."""
        return Memory(noise=self.noise, searched=self.searched)

    def begins(self, stamp_ns: int, config: DetectorConfig) -> bool:
        """
        Return whether a round, in which each lane is searched, begins with the next pair.

        Rounds begin ``interval_s`` after each other.  They compare with pairs of ``reference_s``
        ago: where there are many pairs, a round that begins before that sees little that the last
        one did not, and what it finds the sooner is followed back to that time anyway.

        :param stamp_ns: of the pair.
        """
        if not self.past_ns:
            return True
        passed_s = math.inf if self.last_ns is None else (stamp_ns - self.last_ns) * 1e-9
        many = pairs_a_round(passed_s, config) >= _MANY_PAIRS
        round_s = max(config.interval_s, config.motion.reference_s if many else 0.0)
        age_s = (stamp_ns - self.past_ns[-1]) * 1e-9
        return age_s >= round_s or age_s > config.forget_after_s

    def passing(self, pair: StereoPair, config: DetectorConfig) -> Optional[Memory]:
        """Return what is remembered if nothing is searched in the next pair; None if it is."""
        if self.due or self.begins(pair.stamp_ns, config):
            return None
        return replace(self, last_ns=pair.stamp_ns, last_index=pair.index)


def pairs_a_round(passed_s: float, config: DetectorConfig) -> int:
    """Return how many pairs, so far apart, share a round of ``interval_s``."""
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
        """Return what of the images all sweeps look at; where another process searches none do."""
        return self._looked_at(list(self._sweeps))

    @cached_property
    def _regions_of(self) -> dict[str, PairRegions]:
        """Return what of the images the sweep of each lane looks at."""
        return {lane: self._looked_at([lane]) for lane in self._sweeps}

    def _looked_at(self, lanes: Sequence[str]) -> PairRegions:
        """Return what of the images the sweeps of lanes look at."""
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
        """Return what it remembers, but for the images of these pairs."""
        return Memory(tuple(self.pairs), tuple(self._due), self._last_ns, self._last_index,
                      self._noise.std, self._searched)

    def recall(self, memory: Memory, pairs: Mapping[int, StereoPair]) -> None:
        """
        Go on from what another one remembers, as that would.

        :param pairs: those that it names, by stamp.
        """
        self._past = deque(PairPyramids.of(pairs[ns], self._regions, self._search.rig)
                           for ns in memory.past_ns)
        self._due = deque(memory.due)
        self._last_ns, self._last_index = memory.last_ns, memory.last_index
        self._noise, self._searched = NoiseEstimate(memory.noise), memory.searched

    def pass_over(self, last_ns: Optional[int], last_index: Optional[int]) -> None:
        """
        Be told of pairs in which nothing was to be searched.

        :param last_ns: stamp of the last of them, or of what was searched last.
        :param last_index: its number.
        """
        self._last_ns, self._last_index = last_ns, last_index

    def reset(self) -> None:
        """Forget the earlier pairs, as after a jump back of time."""
        self._past.clear()
        self._due.clear()
        self._last_ns = self._last_index = None

    def update(self, pair: StereoPair, tracked: Sequence[TrackedRegion] = ()) -> list[Detection]:
        """
        Take in a pair and return the vehicles that no track holds.

        :param pair: in order of stamps; a gap in its numbers tells of those that were skipped.
        :param tracked: what the tracks hold, predicted for this pair.
        """
        return self.detections(self.look(pair), self.held(tracked))

    def held(self, tracked: Sequence[TrackedRegion]) -> Held:
        """Return the places that tracks hold."""
        return Held(self.spacing, self.spacing.tracked(tracked))

    def look(self, pair: StereoPair) -> Optional[Look]:
        """
        Take in a pair and return what of the search does not depend on the tracks.

        Each lane is searched once in ``interval_s``.  Where that takes several pairs, the lanes
        take turns, so that no pair takes much longer than the others; where it takes many, once
        in ``motion.reference_s`` will do.
        Where pairs were skipped because they came too fast, one lane a pair is searched: a pair
        that took longer would have the more of the next ones skipped.

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
        Return the vehicles that no track holds; nothing of the detector changes.

        :param look: at a pair; None where there was none.
        :param held: places of the tracks, which keeps what it was asked.
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

        :param begins: whether a round does, in which each lane is searched.
        :param passed_s: since the last pair; it tells how many pairs share a round.
        :param skipped: whether pairs were, since the last one.
        """
        if begins:  # what a slower stream than expected has left over comes first
            self._due.extend(lane for lane in self._sweeps if lane not in self._due)
        pairs = pairs_a_round(passed_s, self.config)
        count = 1 if skipped else math.ceil(len(self._sweeps) / pairs)
        return [self._due.popleft() for _ in range(min(count, len(self._due)))]

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

    def _remember(self, now: PairPyramids) -> None:
        self._past.append(now)
        keep_s = self.config.motion.long_reference_s
        while len(self._past) > 2 and self._past[1].age_s(now.pair.stamp_ns) > keep_s:
            self._past.popleft()
