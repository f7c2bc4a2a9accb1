# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A track, and what the pipeline stores with it."""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from functools import cached_property
import math
from typing import Optional, Sequence

import numpy as np

from .solving import Fed, Turn
from ..classification.size import VehicleSize
from ..core.passes import TrackEnd
from ..core.records import Array, StereoPair, TrackState, TrackUpdate
from ..core.stamp_watch import Gap
from ..core.trace import PassTrace, TraceBuilder
from ..core.tracker_config import TrackerConfig, VisibilityConfig
from ..detection.protocol import Detection
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..second.estimate import SecondOpinion
from ..tracking.lane_assigner import LaneAssigner
from ..tracking.protocol import (
    CanHurry, CarriesOn, DoubtsStamps, SeesGaps, TellsAge, TellsEnd, Tracker, TrackStart)
from ..tracking.upright import Upright

_SURE_SIGMAS = 3.0  # deviations of a place that are taken for certain to hold it
MOST_RESTART_PAIRS = 12  # a track that was fed more pairs is not restarted


@dataclass(eq=False)
class Track:
    """
    A track and what the pipeline stores with it.

    :param tracker: follows the vehicle.
    :param lanes: assigns it to lanes.
    :param detection: the detection that started it; None where a person annotated the front.
    :param found_ns: stamp of the pair that it was detected in.
    :param trace: records how the pass came about.
    :param size: measures the vehicle's size.
    :param upright: decides whether the front stands on the road or lies on it.
    :param second: second estimate of the speed; None where it is disabled.
    :param last: its newest update.
    :param confirmed: whether it has ever been confirmed.
    :param doubted: whether it is doubted: its speed contradicts the detector's, it lies, it may be
        an edge of a vehicle, or it has not moved since it was hidden.
    :param hidden: whether its vehicle has been hidden and not been seen moving since.
    :param lag_changes_s: sum of the changes of the time between the views when it began, s.
    :param clock_stepped: whether the clock of the stamps has stepped since it began.
    :param stamp_std_s: 1-sigma assumed for its stamps, s; None for the configured one.
    :param unaware: whether its tracker could not be told that stamps have become uneven.
    :param hurried: whether its tracker was told to do little with the newest pair.
    :param unhurried_ns: stamp of the last pair in which it was not hurried; None if there is none.
    :param turn: the pair that its tracker is solving for beside the others; None if there is none.
    :param restart_pairs: all pairs that it was fed, as long as it can be restarted with corrected
        right stamps; None if it cannot.
    :param drift_rad: (3,) estimated rotation of the right camera in its first pair.
    :param drift_change_rad: (3,) largest absolute change of that rotation in its pairs so far.
    """

    tracker: Tracker
    lanes: LaneAssigner
    detection: Optional[Detection]
    found_ns: int
    trace: TraceBuilder
    size: VehicleSize
    upright: Upright
    second: Optional[SecondOpinion] = None
    last: Optional[TrackUpdate] = None
    confirmed: bool = False
    doubted: bool = False
    hidden: bool = False
    lag_changes_s: float = 0.0
    clock_stepped: bool = False
    stamp_std_s: Optional[float] = None
    unaware: bool = False
    hurried: bool = False
    unhurried_ns: Optional[int] = None
    turn: Optional[Turn] = None
    restart_pairs: Optional[list[StereoPair]] = None
    drift_rad: Array = field(default_factory=lambda: np.zeros(3))
    drift_change_rad: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def first_ns(self) -> int:
        """Return the stamp of its first pair, ns."""
        first_ns = self.trace.first_ns
        return self.found_ns if first_ns is None else first_ns

    @property
    def lies(self) -> bool:
        """Return whether a detected front lies on the road; annotated ones are not questioned."""
        return self.detection is not None and self.upright.lies

    @property
    def ended(self) -> bool:
        """Return whether its pass is known to be over."""
        return self.turn is None and self.tracker.ended

    def feed(self, pair: StereoPair) -> Optional[TrackUpdate]:
        """Feed a pair to the tracker and the other estimators; return the tracker's update."""
        if self.restart_pairs is not None:
            self.restart_pairs = [*self.restart_pairs, pair] if len(
                self.restart_pairs) < MOST_RESTART_PAIRS else None
        return self.gather(pair, self.tracker.update(pair))

    def gather(self, pair: StereoPair, update: Optional[TrackUpdate]) -> Optional[TrackUpdate]:
        """Feed a pair to the other estimators, with the tracker's update, and return that."""
        if update is not None and holds(update):
            self.size.take(pair, update)
            self.upright.take(pair, update)
            if self.second is not None:
                self.second.take(pair, update.quad_left_px, update.quad_right_px)
        return update

    def solve(self, pair: StereoPair, later: deque[StereoPair]) -> Fed:
        """
        Have its tracker solve for a pair, then feed it the later pairs that need no solution.

        :return: the pairs that it was fed, each with its update.
        """
        fed = [(pair, self.feed(pair))]
        while later and isinstance(self.tracker, CarriesOn):
            pair, last = later.popleft(), fed[-1][1]
            if last is not None and last.state is TrackState.COASTING:
                fed.append((pair, self.feed(pair)))  # cheap: most pairs are not searched for it
                continue
            update = self.tracker.carry(pair)
            if update is None:
                break
            fed.append((pair, self.gather(pair, update)))
        return fed

    def add_others(self, stamp_ns: int, updates: Sequence[TrackUpdate]) -> None:
        """Add the updates of other tracks for a pair to the trace."""
        turn = self.turn
        if turn is None or stamp_ns < turn.pair.stamp_ns:
            self.trace.add_others(stamp_ns, updates)
        else:
            turn.others.setdefault(stamp_ns, []).extend(updates)

    def see_stamps(self, stamp_std_s: float) -> None:
        """
        Take in that stamps are less even than assumed.

        A turn under way keeps the 1-sigma that it began with, so that no pair has to wait until
        the tracker can be told.
        """
        self.unaware |= not isinstance(self.tracker, DoubtsStamps)
        if self.turn is not None:
            self.turn.stamp_std_s = stamp_std_s
            return
        self.stamp_std_s = stamp_std_s
        if isinstance(self.tracker, DoubtsStamps):
            self.tracker.doubt_stamps(stamp_std_s)
        if self.second is not None:
            self.second.config = replace(self.second.config, stamp_std_s=stamp_std_s)

    def see_gaps(self, gaps: Sequence[Gap]) -> None:
        """Take in the latest gaps of the stream."""
        if isinstance(self.tracker, SeesGaps):
            self.tracker.see_gaps(gaps)

    @property
    def clock_step(self) -> Optional[Gap]:
        """Return a gap in which its images show that the clock was set; None if there is none."""
        return self.tracker.clock_step if isinstance(self.tracker, SeesGaps) else None

    def see_drift(self, drift_rad: Array) -> None:
        """Record the largest change of the right camera's estimated rotation."""
        self.drift_change_rad = np.maximum(
            self.drift_change_rad, np.abs(drift_rad - self.drift_rad))

    def waited_s(self, stamp_ns: int) -> float:
        """
        Return the time since it was last solved for, s; infinite if it must be solved for now.

        :param stamp_ns: stamp of the current pair.
        """
        if isinstance(self.tracker, TellsAge):
            return self.tracker.unsolved_s(stamp_ns)
        if not isinstance(self.tracker, CanHurry):
            return 0.0
        if not self.confirmed or self.unhurried_ns is None:
            return math.inf
        return (stamp_ns - self.unhurried_ns) * 1e-9

    @property
    def has_left(self) -> bool:
        """Return whether this track, once ended, has left the view, seen or hidden to the last."""
        if isinstance(self.tracker, TellsEnd):
            return self.tracker.end is TrackEnd.LEFT_VIEW
        return holds(self.last)

    @cached_property
    def is_vehicle(self) -> bool:
        """
        Return whether this track, once ended, counts as a vehicle and gives a pass.

        It does if it was confirmed, was annotated by a person, or left the view before it could be
        confirmed.  One that was lost unconfirmed, as in a gap of the stream, does not.
        """
        return self.confirmed or self.detection is None or (
            holds(self.last) and self._end() is TrackEnd.LEFT_VIEW)

    def _end(self) -> Optional[TrackEnd]:
        """Return how its pass ended, where necessary by measuring it."""
        tracker = self.tracker
        return tracker.end if isinstance(tracker, TellsEnd) else tracker.result().end


def start_of(trace: PassTrace, rig: StereoRig, lane: LanePath, config: TrackerConfig,
             pair: StereoPair) -> TrackStart:
    """
    Return the start of a tracker, either of a new one or, by its trace, of an earlier one.

    :param trace: record of how the pass began.
    :param rig: the cameras.
    :param lane: the lane of its first front.
    :param config: parameters that all trackers share.
    :param pair: the pair of its first front.
    """
    if trace.rest_std_rad is not None:
        lane = lane.with_heading_std(np.array(trace.rest_std_rad))
    return TrackStart(
        rig=rig, lane=lane, front=trace.front, pair=pair, track=trace.track,
        config=replace(with_stamps(config, trace), particles=trace.particles),
        rng=np.random.default_rng([trace.seed, trace.track]), seen_mps=trace.seen_mps,
        particles_alone=config.particles, nominal_stamp_std_s=config.stamp_std_s)


def with_stamps(config: TrackerConfig, trace: PassTrace) -> TrackerConfig:
    """Return the parameters with the stamp 1-sigma of a trace, where it has one."""
    return config if trace.stamp_std_s is None else replace(
        config, stamp_std_s=trace.stamp_std_s)


def holds(update: Optional[TrackUpdate]) -> bool:
    """Return whether a track saw its vehicle in the pair of an update."""
    return update is not None and update.state is not TrackState.COASTING


def is_sure(update: TrackUpdate, limits: VisibilityConfig) -> bool:
    """Return whether the speed is certain enough to be published as a reading."""
    return update.speed_std_mps <= max(
        limits.reading_std_mps, limits.reading_std_share * abs(update.speed_mps))


def with_unnoticed(update: TrackUpdate, limits: VisibilityConfig) -> TrackUpdate:
    """
    Return an update whose 1-sigma allows for braking that the images do not show yet.

    Few drivers brake at any moment, but the 1-sigma must hold for this one.
    """
    wider = replace(update, speed_std_mps=math.hypot(
        update.speed_std_mps, update.unnoticed_mps / limits.unnoticed_sigmas))
    enough = wider.speed_std_mps <= limits.unnoticed_std_mps or is_sure(wider, limits)
    return wider if enough else wider.unconfirmed()


def may_be_at(update: TrackUpdate, centre_m: Array, near_m: float) -> bool:
    """
    Return whether a front may be near a place, given the uncertainty of its own place.

    The range of a far front is uncertain by a metre or more in its first pairs.

    :param centre_m: (3,) the place, left optical frame, m.
    :param near_m: distance that counts as near, m.
    """
    variances, axes = np.linalg.eigh(update.position_cov_m2)
    away_m = np.abs((centre_m - update.position_m) @ axes)
    surely_m = np.maximum(away_m - _SURE_SIGMAS * np.sqrt(np.maximum(variances, 0.0)), 0.0)
    return float(np.linalg.norm(surely_m)) < near_m


def ahead_m(update: TrackUpdate, stamp_ns: int) -> float:
    """Return how far a vehicle travels until another stamp at its current speed, m."""
    return update.speed_mps * (stamp_ns - update.stamp_ns) * 1e-9


def place_m(update: TrackUpdate, stamp_ns: int) -> Array:
    """Return the position (3,) predicted for another stamp, left optical frame, m."""
    return update.position_m + ahead_m(update, stamp_ns) * update.axes[:, 0]
