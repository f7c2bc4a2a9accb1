# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The one pipeline: pairs in, track updates and pass results out.

The live nodes, ``replay`` and the tests all run this object, so the same pairs and seed give the
same speeds everywhere.
"""
from __future__ import annotations

from typing import Mapping, Sequence

import numpy as np

from .config import TrackerConfig
from .errors import InputError
from .geometry.rig import StereoRig
from .records import PassResult, StereoPair, TrackUpdate
from .site import InitMark, LanePath
from .tracking.acquire import check_mark
from .tracking.base import Tracker
from .tracking.constrained import ConstrainedTracker

TRACKERS = {'constrained': ConstrainedTracker}


class SpeedPipeline:
    """
    Start a track at each mark, feed it the pairs, collect its result.

    :param rig: the cameras.
    :param lanes: lane name to lane path.
    :param config: tracker parameters.
    :param marks: fronts as marked by a person.
    :param seed: seed of all randomness; each track draws from its own stream, so that tracks do
        not disturb one another.
    :param tracker: name of the tracker.
    :param where: where the marks come from, for errors.
    :raises InputError: a mark outside the images, an unknown tracker, no lane.
    """

    def __init__(self, rig: StereoRig, lanes: Mapping[str, LanePath], config: TrackerConfig,
                 marks: Sequence[InitMark], *, seed: int = 0, tracker: str = 'constrained',
                 where: str = 'init file') -> None:
        if tracker not in TRACKERS:
            raise InputError('configuration', 'tracker', tracker, ', '.join(TRACKERS))
        if not lanes:
            raise InputError('site', 'lanes', 'none', 'at least one lane')
        for mark in marks:
            check_mark(rig, mark, where)
        self.rig, self.lanes, self.config = rig, dict(lanes), config
        self.marks, self.seed, self.tracker = tuple(marks), seed, tracker
        self._tracks: list[Tracker] = []
        self._ended: list[PassResult] = []
        self._next_track = 0
        self._last_ns: int | None = None
        self._started: set[int] = set()

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
                self._tracks.append(self._start(mark, pair))
        updates = [track.update(pair) for track in self._tracks]
        self._collect(everything=False)
        return [update for update in updates if update is not None]

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
        self._tracks, self._ended, self._last_ns = [], [], None
        self._started = set()

    def missing_marks(self) -> list[int]:
        """Pair indices of marks whose pair has not come."""
        return [m.frame for k, m in enumerate(self.marks) if k not in self._started]

    def _start(self, mark: InitMark, pair: StereoPair) -> Tracker:
        track = self._next_track
        self._next_track += 1
        return TRACKERS[self.tracker](
            rig=self.rig, lane=self._lane_of(mark), config=self.config, mark=mark, pair=pair,
            track=track, rng=np.random.default_rng([self.seed, track]))

    def _lane_of(self, mark: InitMark) -> LanePath:
        """Find the lane whose path the marked front is nearest to, across the road."""
        centre = self.rig.triangulate(mark.left_px, mark.right_px).mean(axis=0)

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
        for track in [t for t in self._tracks if everything or t.ended]:
            self._tracks.remove(track)
            self._ended.append(track.result())
