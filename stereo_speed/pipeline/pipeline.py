# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The one pipeline: pairs in, track updates and pass results out.

The live nodes, ``replay`` and the tests all run this object, so the same pairs and seed give the
same speeds everywhere.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Callable, Mapping, Optional, Protocol, Sequence

import numpy as np

from ..core.config import TrackerConfig
from ..core.errors import InputError
from ..core.records import PassResult, StereoPair, TrackState, TrackUpdate
from ..detection.config import DetectorConfig
from ..detection.detector import PlaneSweepDetector
from ..detection.records import Detection, TrackedRegion
from ..geometry.rig import StereoRig
from ..lab.baselines.kalman import KalmanTracker
from ..lab.baselines.multimodal import MultimodalTracker
from ..lab.baselines.optical_flow import FlowTracker
from ..lab.baselines.triangulation import TriangulationTracker
from ..lab.baselines.unconstrained import UnconstrainedTracker
from ..road.lanes import LanePath
from ..site.file import InitialFront
from ..tracking.constrained import ConstrainedTracker
from ..tracking.initialise import check_mark
from ..tracking.lane_assigner import LaneAssigner
from ..tracking.protocol import SharesParticles, Tracker

TRACKERS: dict[str, Callable[..., Tracker]] = {
    'constrained': ConstrainedTracker, 'unconstrained': UnconstrainedTracker,
    'triangulation': TriangulationTracker, 'kalman': KalmanTracker,
    'multimodal': MultimodalTracker, 'flow': FlowTracker}
FEWEST_PARTICLES = 100  # of a track, however many there are
CATCH_UP_PAIRS = 3  # earlier ones that a new track is fed, at most
FOUND_SPEED_STD = 0.05  # share: 1-sigma of the speed between the two pairs of a detection
SAME_SPEED_SIGMAS = 3.0
DOUBT_NS = 1_000_000_000  # for so long a track that saw another speed than its finder waits
BRAKING_MPS2 = 6.0  # as hard as vehicles brake
GONE_NS = 1_000_000_000  # for so long what left is not taken for another vehicle
SAME_VEHICLE_M = 1.5  # fronts nearer than this are of one vehicle


class Detector(Protocol):
    """Finds vehicles by itself; ``detection.PlaneSweepDetector`` is one."""

    def update(self, pair: StereoPair, occupied: Sequence[TrackedRegion]) -> Sequence[Detection]:
        """Give the fronts of vehicles that no track holds yet, and learn the background."""


@dataclass
class _Track:
    """A tracker, the lanes its vehicle was in, and what was last told of it."""

    tracker: Tracker
    keeper: LaneAssigner
    found: bool  # by itself: it is a vehicle only once confirmed
    last: Optional[TrackUpdate] = None
    confirmed: bool = False
    front: Optional[Detection] = None  # as it was found, and
    found_ns: int = 0  # when


class SpeedPipeline:
    """
    Start a track at each mark or found front, feed it the pairs, collect its result.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: tracker parameters.
    :param marks: fronts as marked by a person; None has them found automatically.
    :param seed: seed of all randomness; each track draws from its own stream, so that tracks do
        not disturb one another.
    :param tracker: name of the tracker.
    :param where: where the marks come from, for errors.
    :param finder: makes the finder of vehicles where there are no marks.
    :raises InputError: a mark outside the images, an unknown tracker, no lane.
    """

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath], config: TrackerConfig,
                 marks: Optional[Sequence[InitialFront]], *, seed: int = 0,
                 tracker: str = 'constrained', where: str = 'init file',
                 finder: Callable[..., Detector] = PlaneSweepDetector) -> None:
        if tracker not in TRACKERS:
            raise InputError('configuration', 'tracker', tracker, ', '.join(TRACKERS))
        if not lanes:
            raise InputError('site', 'lanes', 'none', 'at least one lane')
        for mark in marks or ():
            check_mark(rig, mark, where)
        self.rig, self.lanes, self.config = rig, dict(lanes), config
        self.marks, self.seed, self.tracker = tuple(marks or ()), seed, tracker
        self._make_finder = None if marks is not None else finder
        self._next_track = 0
        self.reset()

    def process(self, pair: StereoPair) -> list[TrackUpdate]:
        """
        Take in the next pair.

        :raises InputError: its stamp is not after the one before.
        """
        if self._last_ns is not None and pair.stamp_ns <= self._last_ns:
            raise InputError('pairs', f'stamp of pair {pair.index}', pair.stamp_ns,
                             f'later than {self._last_ns}')
        self._last_ns = pair.stamp_ns
        self._check_size(pair)
        for number, mark in enumerate(self.marks):
            if mark.frame == pair.index and number not in self._started:
                self._started.add(number)
                self._start(mark, pair, self._lane_of(mark), found=False)
        for track in self._tracks:
            if isinstance(track.tracker, SharesParticles):
                track.tracker.share(self._share(len(self._tracks)))
        updates = [self._update(track, pair) for track in self._tracks]
        self._drop_missing()
        self._drop_doubles()
        updates += self._find(pair)
        self._collect(everything=False)
        kept = {track.tracker.track for track in self._tracks}
        return [u for u in updates if u is not None and u.track in kept]

    def ended(self) -> list[PassResult]:
        """Give the passes that ended since this was last asked."""
        out, self._ended = self._ended, []
        return out

    def finish(self) -> list[PassResult]:
        """End all tracks: the stream is over."""
        self._collect(everything=True)
        return self.ended()

    def reset(self) -> None:
        """Forget all tracks and the time, as after a jump back; numbers are not reused."""
        self._tracks: list[_Track] = []
        self._ended: list[PassResult] = []
        self._gone: list[TrackUpdate] = []
        self._last_ns: Optional[int] = None
        self._started: set[int] = set()
        self._finder = self._make_finder and self._make_finder(
            self.rig, self.lanes, DetectorConfig())

    def missing_marks(self) -> list[int]:
        """Pair indices of marks whose pair has not come."""
        return [m.frame for k, m in enumerate(self.marks) if k not in self._started]

    def _start(self, mark: InitialFront, pair: StereoPair, lane: LanePath, *, found: bool) -> _Track:
        """
        Begin a track; tracks share the particles there are.

        :raises InputError: no front is there, or not one that both views agree on.
        """
        config = replace(self.config, particles=self._share(len(self._tracks) + 1))
        number = self._next_track
        tracker: Tracker = TRACKERS[self.tracker](
            rig=self.rig, lane=lane, config=config, mark=mark, pair=pair, track=number,
            rng=np.random.default_rng([self.seed, number]))
        self._next_track += 1
        self._tracks.append(_Track(tracker, LaneAssigner(self.lanes), found))
        return self._tracks[-1]

    def _share(self, tracks: int) -> int:
        """Particles of each of so many tracks."""
        wanted = self.config.particles
        if tracks == 1:
            return wanted
        return min(wanted, max(self.config.particle_budget // tracks, FEWEST_PARTICLES))

    def _update(self, track: _Track, pair: StereoPair) -> Optional[TrackUpdate]:
        """Feed a track, and tell in which lane its vehicle is."""
        update = track.tracker.update(pair)
        if update is None:
            return None
        if not track.confirmed and self._is_doubtful(track, update):
            update = replace(update, state=TrackState.TENTATIVE)
        track.last = track.keeper.place(update)
        track.confirmed |= update.state is TrackState.CONFIRMED
        return track.last

    def _is_doubtful(self, track: _Track, update: TrackUpdate) -> bool:
        """
        Say whether a young track sees another speed than the one it was found by.

        After a while the vehicle may have changed its speed, but by no more than it can brake.
        """
        if track.front is None or update.state is not TrackState.CONFIRMED:
            return False
        age_ns = update.stamp_ns - track.found_ns
        change_mps = 0.0 if age_ns < DOUBT_NS else BRAKING_MPS2 * age_ns * 1e-9
        return not _same_speed(update, track.front, change_mps)

    def _find(self, pair: StereoPair) -> list[Optional[TrackUpdate]]:
        """Start tracks at fronts that are found, and feed them their first pair."""
        if self._finder is None:
            return []
        # A lost one, which coasted before it ended, may be found again; one that left may not.
        self._gone = [u for u in self._gone if pair.stamp_ns - u.stamp_ns < GONE_NS] + [
            t.last for t in self._tracks if t.last is not None and t.tracker.ended
            and t.confirmed and _holds(t.last)]
        occupied = [self._occupied(t.last) for t in self._tracks
                    if t.last is not None and not t.tracker.ended]
        occupied += [self._occupied(_moved_on(u, pair.stamp_ns)) for u in self._gone]
        updates = []
        for front in self._finder.update(pair, occupied):
            updates.append(self._begin(front, pair))
        return updates

    def _begin(self, front: Detection, pair: StereoPair) -> Optional[TrackUpdate]:
        """Start a track where a front was first seen; where that fails, where it is now."""
        starts = [((pair,), front.left_px, front.right_px)]
        if front.earlier is not None:
            seen = front.earlier.pairs
            some = seen[::math.ceil(len(seen) / CATCH_UP_PAIRS)]
            starts.insert(0, ((*some, pair), front.earlier.left_px, front.earlier.right_px))
        for pairs, left_px, right_px in starts:
            mark = InitialFront(pairs[0].index, left_px, right_px, front.std_px)
            try:
                track = self._start(mark, pairs[0], self.lanes[front.lane], found=True)
            except InputError:  # what looked like a front is none: the views disagree
                continue
            track.front, track.found_ns = front, pair.stamp_ns
            told = [self._update(track, one) for one in pairs]
            if all(map(_holds, told)) and (
                    len(pairs) == 1 or _same_speed(told[-1], front)):
                return told[-1]
            self._tracks.remove(track)
        return None

    def _occupied(self, update: TrackUpdate) -> TrackedRegion:
        """Tell the finder what a track holds in this pair."""
        across, up = np.ptp(update.quad_left_px, axis=0)
        scale = float(update.position_m[2]) / self.rig.left.K[[0, 1], [0, 1]]
        return TrackedRegion(
            lane=update.lane, s_m=update.s_m, lateral_m=update.lateral_m,
            width_m=float(across * scale[0]), height_m=float(up * scale[1]),
            left_px=update.quad_left_px, right_px=update.quad_right_px)

    def _drop_missing(self) -> None:
        """End tracks that miss a pair before they were confirmed; a vehicle is found again."""
        self._tracks = [t for t in self._tracks
                        if t.confirmed or not t.found or t.tracker.ended or _holds(t.last)]

    def _drop_doubles(self) -> None:
        """
        End one of two tracks that hold the same vehicle.

        That which does not see it ends, and the younger if both do.
        """
        held: list[TrackUpdate] = []
        for track in sorted(self._tracks, key=lambda t: not _holds(t.last)):
            if track.last is None or track.tracker.ended:
                continue
            at = track.last.position_m
            if any(np.linalg.norm(at - other.position_m) < SAME_VEHICLE_M for other in held) \
                    and track.found:
                self._tracks.remove(track)
                if track.confirmed:
                    self._ended.append(self._result(track).rejected('duplicate'))
            else:
                held.append(track.last)

    def _lane_of(self, mark: InitialFront) -> LanePath:
        """Find the lane whose path the marked front is nearest to, across the road."""
        centre = self.rig.triangulate(mark.left_px.mean(axis=0), mark.right_px.mean(axis=0))

        def across(lane: LanePath) -> float:
            s_m = lane.path.arc_length(centre)
            return abs(float((centre - lane.path.position(s_m)) @ lane.path.frame(s_m)[:, 1]))
        return min(self.lanes.values(), key=across)

    def _check_size(self, pair: StereoPair) -> None:
        for side, image, camera in (('left', pair.left, self.rig.left),
                                    ('right', pair.right, self.rig.right)):
            if image.shape != (camera.height_px, camera.width_px):
                raise InputError(
                    f'pair {pair.index}', f'{side} image size',
                    f'{image.shape[1]}x{image.shape[0]}',
                    f'{camera.width_px}x{camera.height_px} as calibrated')

    def _collect(self, *, everything: bool) -> None:
        """Measure the passes that are over; what was never confirmed was no vehicle."""
        for track in [t for t in self._tracks if everything or t.tracker.ended]:
            self._tracks.remove(track)
            if track.confirmed or not track.found:
                self._ended.append(self._result(track))

    def _result(self, track: _Track) -> PassResult:
        return track.keeper.conclude(track.tracker.result())


def _moved_on(update: TrackUpdate, stamp_ns: int) -> TrackUpdate:
    """Say where a vehicle is along its lane some time after it left."""
    ahead_m = update.speed_mps * (stamp_ns - update.stamp_ns) * 1e-9
    return replace(update, s_m=update.s_m + ahead_m)


def _holds(update: Optional[TrackUpdate]) -> bool:
    """Say whether a track saw its vehicle in a pair."""
    return update is not None and update.state is not TrackState.COASTING


def _same_speed(update: TrackUpdate, front: Detection, change_mps: float = 0.0) -> bool:
    """
    Say whether track and finder, each by itself, saw one speed; a front half hidden has two.

    :param change_mps: by which the speed may have changed since.
    """
    std = math.hypot(update.speed_std_mps, FOUND_SPEED_STD * front.speed_mps)
    return abs(update.speed_mps - front.speed_mps) < SAME_SPEED_SIGMAS * std + change_mps
