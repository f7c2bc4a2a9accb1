# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The result of a vehicle's whole pass: its speed, the budget of its 1-sigma, and the verdict.

Time is integer nanoseconds of the header stamp; speeds are in m/s over ground.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Optional, Sequence

import numpy as np

from .records import Array, Word
from .trace import PassTrace


class Verdict(Word):
    """Outcome of a pass; the values are those of ``passes.csv``."""

    MEASURED = 'measured'
    REJECTED = 'rejected'


class TrackEnd(Word):
    """How a track ended; the values are those of ``passes.csv``."""

    LEFT_VIEW = 'left_view'
    LOST = 'lost'
    STREAM_ENDED = 'stream_ended'


class Direction(Word):
    """Direction in which a vehicle drives, as seen from the cameras."""

    APPROACHING = 'approaching'
    RECEDING = 'receding'


class Reason(Word):
    """
    Why a pass is rejected; the values are those of ``passes.csv``.

    ``docs/method.md`` explains each of them.
    """

    NEVER_SEEN = 'never_seen'
    TOO_FEW_PAIRS = 'too_few_pairs'
    TOO_FEW_FEATURES = 'too_few_features'
    TOO_FAR = 'too_far'
    VIEWS_DISAGREE = 'views_disagree'
    OFF_PATH = 'off_path'
    IMPLAUSIBLE = 'implausible'
    RIG_UNCERTAIN = 'rig_uncertain'
    STAMPS_UNCERTAIN = 'stamps_uncertain'
    UNCERTAIN = 'uncertain'
    DUPLICATE = 'duplicate'
    SECOND_ESTIMATE = 'second_estimate'


class VehicleClass(Word):
    """
    Vehicle classes that can be told apart by size; the values are those of ``passes.csv``.

    A heavy vehicle is a lorry or a bus, which have the same size when seen from ahead.
    """

    MOTORCYCLE = 'motorcycle'
    CAR = 'car'
    VAN = 'van'
    HEAVY_VEHICLE = 'heavy_vehicle'
    UNKNOWN = 'unknown'


@dataclass(frozen=True)
class SpeedBudget:
    """
    The independent parts of the 1-sigma of a pass's speed, each in m/s.

    :param matching_mps: part of the images and of the vehicle's possible motion between them.
    :param path_mps: part of the direction of the lane's path.
    :param stamps_mps: part of the header stamps, relative to the true exposures.
    :param calibration_mps: part of focal length, baseline and the length of the path.
    """

    matching_mps: float
    path_mps: float
    stamps_mps: float
    calibration_mps: float

    @property
    def total_mps(self) -> float:
        """Return the root of the sum of squares of the parts."""
        return math.hypot(self.matching_mps, self.path_mps, self.stamps_mps,
                          self.calibration_mps)


@dataclass(frozen=True)
class SecondEstimate:
    """
    An estimate of a pass's speed from other evidence and by other code, for comparison only.

    :param speed_mps: mean ground speed over the pass, m/s; None if there is no estimate.
    :param speed_std_mps: its 1-sigma, m/s; None if there is no estimate.
    :param pairs: number of pairs that it is based on.
    """

    speed_mps: Optional[float]
    speed_std_mps: Optional[float]
    pairs: int


@dataclass(frozen=True)
class VehicleKind:
    """
    The size of a vehicle, and the class that follows from it.

    :param name: class of the vehicle; unknown if no class is probable enough.
    :param probability: probability of the most probable class, even if ``name`` is unknown.
    :param width_m: width of the tracked front or rear, m.
    :param width_std_m: its 1-sigma, m.
    :param height_m: greatest height above the road, above the middle of the front, at which
        something moves with the vehicle, m.  In the dark the vehicle may be higher.  None if it
        could not be measured.
    :param height_std_m: its 1-sigma, m; None if the height is.
    """

    name: VehicleClass
    probability: float
    width_m: float
    width_std_m: float
    height_m: Optional[float] = None
    height_std_m: Optional[float] = None


@dataclass(frozen=True, eq=False)
class PassResult:
    """
    The result of one vehicle's whole pass: its speed and the smoothed profile.

    :param track: track number.
    :param lane: name of the lane.
    :param first_ns: stamp of its first pair, ns.
    :param last_ns: stamp of its last pair, ns.
    :param pairs: number of pairs it was measured in.
    :param speed_mps: mean ground speed over the pass, m/s; None if rejected without a measurement.
    :param speed_std_mps: its 1-sigma, m/s; None if the speed is.
    :param verdict: see :class:`Verdict`.
    :param reason: why it was rejected, a :class:`Reason` or, from trackers of other packages,
        another word in snake_case; empty if measured.
    :param smoothed: maps stamps in ns to the smoothed speed in m/s, from all pairs of the pass.
    :param smoothed_std: maps stamps in ns to the 1-sigma of the smoothed speed, m/s.
    :param budget: parts of the 1-sigma; None if the tracker does not provide them.
    :param end: how the track ended.
    :param lane_to: name of the lane it ended in, equal to ``lane`` unless it changed lanes.
    :param second: the independent second estimate; None if none was made.
    :param direction: direction of the lane as seen from the cameras; None if not set by the
        pipeline.
    :param vehicle: size and class of the vehicle; None if not set by the pipeline.
    :param trace: how the pass came about; None if it was not kept.
    """

    track: int
    lane: str
    first_ns: int
    last_ns: int
    pairs: int
    speed_mps: Optional[float]
    speed_std_mps: Optional[float]
    verdict: Verdict
    reason: str
    smoothed: dict[int, float]
    smoothed_std: dict[int, float]
    budget: Optional[SpeedBudget] = None
    end: TrackEnd = TrackEnd.STREAM_ENDED
    lane_to: str = ''
    second: Optional[SecondEstimate] = None
    direction: Optional[Direction] = None
    vehicle: Optional[VehicleKind] = None
    trace: Optional[PassTrace] = None

    def __post_init__(self) -> None:
        if not self.lane_to:
            object.__setattr__(self, 'lane_to', self.lane)

    def rejected(self, reason: str) -> PassResult:
        """Return the pass as rejected: without any speed."""
        return replace(self, speed_mps=None, speed_std_mps=None, verdict=Verdict.REJECTED,
                       reason=reason, smoothed={}, smoothed_std={}, budget=None)

    def doubted(self, share: float, part: str) -> PassResult:
        """
        Return the pass with another independent 1-sigma added to those of its speeds.

        A pass without a speed is returned as it is.

        :param share: 1-sigma to add, as a share of each speed.
        :param part: field of :class:`SpeedBudget` that it belongs to.
        """
        if self.speed_mps is None or self.speed_std_mps is None or not share:
            return self
        doubt_mps, budget = share * self.speed_mps, self.budget
        if budget is not None:
            budget = replace(budget, **{part: math.hypot(getattr(budget, part), doubt_mps)})
        return replace(
            self, budget=budget, speed_std_mps=math.hypot(self.speed_std_mps, doubt_mps),
            smoothed_std={ns: math.hypot(std, share * self.smoothed[ns])
                          for ns, std in self.smoothed_std.items()})

    @property
    def profile_mps(self) -> tuple[Optional[float], Optional[float], Optional[float]]:
        """Return the smoothed speed in the first pair, in the last one, and the largest, m/s."""
        if not self.smoothed:
            return None, None, None
        speeds = [self.smoothed[ns] for ns in sorted(self.smoothed)]
        return speeds[0], speeds[-1], max(speeds)


def time_shares(stamps_ns: Sequence[int]) -> Array:
    """
    Return the weights (n,) of the pairs of a pass in its mean speed: the share of time of each.

    Each pair stands for the time up to halfway to its neighbours, and the first and the last pair
    for half a median interval beyond them.  Pairs that are missing because the vehicle was hidden
    or not yet found therefore do not bias the mean speed of a braking vehicle.

    :param stamps_ns: stamps of the pairs, rising, ns.
    """
    gaps = np.diff(np.asarray(stamps_ns, dtype=np.int64)).astype(float)
    if not len(gaps):
        return np.ones(len(stamps_ns))
    median_gap = float(np.median(gaps))
    duration = np.append(median_gap, gaps) + np.append(gaps, median_gap)
    return np.asarray(duration / duration.sum())
