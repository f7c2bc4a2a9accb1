# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What is said of a vehicle's whole pass: its speed, what that is made of, and the verdict.

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
    """Which way a vehicle drives, as the cameras see it."""

    APPROACHING = 'approaching'
    RECEDING = 'receding'


class Reason(Word):
    """
    Why a pass is rejected; the values are those of ``passes.csv``.

    ``docs/method.md`` says what each means.
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
    Classes of vehicles as far as their sizes tell them; the values are those of ``passes.csv``.

    A heavy vehicle is a lorry or a bus: from ahead these are of one size.
    """

    MOTORCYCLE = 'motorcycle'
    CAR = 'car'
    VAN = 'van'
    HEAVY_VEHICLE = 'heavy_vehicle'
    UNKNOWN = 'unknown'


@dataclass(frozen=True)
class SpeedBudget:
    """
    What the 1-sigma of a pass's speed is made of, each part in m/s.

    :param matching_mps: the images and how the vehicle may have moved between them.
    :param path_mps: the direction of the lane's path.
    :param stamps_mps: the header stamps against the true exposures.
    :param calibration_mps: focal length, baseline and the length of the path.
    """

    matching_mps: float
    path_mps: float
    stamps_mps: float
    calibration_mps: float

    @property
    def total_mps(self) -> float:
        """Root of the sum of squares: the parts are independent."""
        return math.hypot(self.matching_mps, self.path_mps, self.stamps_mps,
                          self.calibration_mps)


@dataclass(frozen=True)
class SecondEstimate:
    """
    What other evidence and other code say of a pass's speed, for comparison only.

    :param speed_mps: mean ground speed over the pass, m/s; None where it came to none.
    :param speed_std_mps: its 1-sigma, m/s; None likewise.
    :param pairs: number of pairs it rests on.
    """

    speed_mps: Optional[float]
    speed_std_mps: Optional[float]
    pairs: int


@dataclass(frozen=True)
class VehicleKind:
    """
    The size of a vehicle, and what it is by that.

    :param name: its class; unknown where no class is probable enough.
    :param probability: of its most probable class, be it named or not.
    :param width_m: width of what is tracked of it, its front or its rear, m.
    :param width_std_m: its 1-sigma, m.
    :param height_m: greatest height above the road that is seen to move along above the middle of
        the front, m: there may be more of it in the dark; None where it could not be measured.
    :param height_std_m: its 1-sigma, m; None likewise.
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
    One vehicle's whole pass: the final speed and the smoothed profile.

    :param track: track number.
    :param lane: name of the lane.
    :param first_ns: stamp of its first pair, ns.
    :param last_ns: stamp of its last pair, ns.
    :param pairs: number of pairs it was measured in.
    :param speed_mps: final ground speed, mean over the pass, m/s; None when rejected for want
        of a measurement.
    :param speed_std_mps: its 1-sigma, m/s.
    :param verdict: see :class:`Verdict`.
    :param reason: why it was rejected, a :class:`Reason` or, from trackers of other packages,
        another word in snake_case; empty when measured.
    :param smoothed: stamp in ns to the smoothed speed in m/s, from all pairs of the pass.
    :param smoothed_std: stamp in ns to the 1-sigma of the smoothed speed, m/s.
    :param budget: what the 1-sigma is made of; None where the tracker does not tell.
    :param end: how the track ended.
    :param lane_to: name of the lane it ended in; that of ``lane`` unless it changed lanes.
    :param second: the independent estimate beside it; None where none was asked for.
    :param direction: which way the lane leads; None where the pipeline did not say.
    :param vehicle: size and class of the vehicle; None where the pipeline did not say.
    :param trace: how it came about; None where nobody kept it.
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
        """Return the same pass without any speed: what is rejected is never guessed."""
        return replace(self, speed_mps=None, speed_std_mps=None, verdict=Verdict.REJECTED,
                       reason=reason, smoothed={}, smoothed_std={}, budget=None)

    def doubted(self, share: float, part: str) -> PassResult:
        """
        Return it with another independent doubt of its speeds; without a speed, as it is.

        :param share: 1-sigma of all speeds, as a share of them.
        :param part: the field of :class:`SpeedBudget` that it belongs to.
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
        """Smoothed speed in the first pair, in the last, and the greatest, m/s."""
        if not self.smoothed:
            return None, None, None
        speeds = [self.smoothed[ns] for ns in sorted(self.smoothed)]
        return speeds[0], speeds[-1], max(speeds)


def time_shares(stamps_ns: Sequence[int]) -> Array:
    """
    Return the shares (n,) of the time of a pass that its pairs stand for, by which it is averaged.

    Each stands for the time up to half way to its neighbours, the first and the last for as much
    beyond them as is usual: pairs in which a braking vehicle was hidden, or that were passed over
    before it was found, do not change its mean speed.

    :param stamps_ns: of the pairs, rising.
    """
    gaps = np.diff(np.asarray(stamps_ns, dtype=np.int64)).astype(float)
    if not len(gaps):
        return np.ones(len(stamps_ns))
    usual = float(np.median(gaps))
    stands_for = np.append(usual, gaps) + np.append(gaps, usual)
    return np.asarray(stands_for / stands_for.sum())
