# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The records that every layer speaks.

Time is integer nanoseconds of the header stamp; everything geometric is in the left camera's
optical frame (x right, y down, z forward), in metres; pixels are of the raw images.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
import math
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Word(str, Enum):
    """A word of a fixed vocabulary; it prints as its value."""

    __str__ = str.__str__


class TrackState(Word):
    """Life of a track; the values are those of ``tracks.csv``."""

    TENTATIVE = 'tentative'
    CONFIRMED = 'confirmed'
    COASTING = 'coasting'


class Verdict(Word):
    """Outcome of a pass; the values are those of ``passes.csv``."""

    MEASURED = 'measured'
    REJECTED = 'rejected'


class TrackEnd(Word):
    """How a track ended; the values are those of ``passes.csv``."""

    LEFT_VIEW = 'left_view'
    LOST = 'lost'
    STREAM_ENDED = 'stream_ended'


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
    UNCERTAIN = 'uncertain'
    DUPLICATE = 'duplicate'


@dataclass(frozen=True, eq=False)
class InitialFront:
    """
    A vehicle's front in the first pair of its track, as a person annotated or a detector found it.

    :param frame: index of the pair.
    :param left_px: (4, 2) raw pixels, clockwise from the image's top-left corner.
    :param right_px: (4, 2) the same in the right view.
    :param std_px: 1-sigma of each corner.
    """

    frame: int
    left_px: Array
    right_px: Array
    std_px: float = 0.7


@dataclass(frozen=True)
class RigMotion:
    """
    How a rig stood when it took a pair, against how it stood when the site was learnt.

    Angles are pan to the right, tilt upwards and roll clockwise, rad: components of one rotation
    vector about the camera's y, x and z axis.

    :param sway_rad: of the whole rig, about the left camera.
    :param drift_rad: of the right camera against the left one.
    """

    sway_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drift_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class StereoPair:
    """
    One synchronized pair of raw grey images.

    :param index: number of the pair in its stream, from 0.
    :param stamp_ns: header stamp of the left image, ns.
    :param right_stamp_ns: header stamp of the right image, ns.
    :param left: (H, W) uint8 or uint16, raw (not rectified).
    :param right: (H, W), same type.
    :param stamp_error_s: difference of the stamps, s, that was found to be an error.
    :param motion: how the rig stood; None where it stood as when the site was learnt.
    """

    index: int
    stamp_ns: int
    right_stamp_ns: int
    left: NDArray[Any]
    right: NDArray[Any]
    stamp_error_s: float = 0.0
    motion: Optional[RigMotion] = None

    @property
    def right_lag_s(self) -> float:
        """Return the time from the left to the right exposure, s."""
        return (self.right_stamp_ns - self.stamp_ns) * 1e-9

    def triggered(self, tolerance_s: float) -> StereoPair:
        """
        Return it as exposed at once where its stamps tell no more than that.

        :param tolerance_s: stamps that differ by no more are of one exposure.
        """
        if not 0 < abs(self.right_lag_s) <= tolerance_s:
            return self
        return replace(self, right_stamp_ns=self.stamp_ns, stamp_error_s=self.right_lag_s)


@dataclass(frozen=True, eq=False)
class TrackUpdate:
    """
    What a tracker says of one vehicle after one pair, from this pair and earlier ones only.

    :param stamp_ns: header stamp of the pair, ns.
    :param track: track number, never reused.
    :param lane: name of the lane.
    :param state: see :class:`TrackState`.
    :param speed_mps: ground speed, m/s.
    :param speed_std_mps: its 1-sigma, m/s.
    :param s_m: arc length along the lane's path, m.
    :param lateral_m: offset from the path, positive to the left of travel, m.
    :param position_m: (3,) centre of the tracked front, left optical frame, m.
    :param position_cov_m2: (3, 3) its covariance, m^2.
    :param axes: (3, 3) columns are heading (unit), left and up, left optical frame.
    :param quad_left_px: (4, 2) corners of the front in the raw left image, px, clockwise from
        the image's top-left corner.
    :param quad_right_px: (4, 2) the same in the raw right image, px.
    """

    stamp_ns: int
    track: int
    lane: str
    state: TrackState
    speed_mps: float
    speed_std_mps: float
    s_m: float
    lateral_m: float
    position_m: Array
    position_cov_m2: Array
    axes: Array
    quad_left_px: Array
    quad_right_px: Array


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

    def __post_init__(self) -> None:
        if not self.lane_to:
            object.__setattr__(self, 'lane_to', self.lane)

    def rejected(self, reason: str) -> PassResult:
        """Return the same pass without any speed: what is rejected is never guessed."""
        return replace(self, speed_mps=None, speed_std_mps=None, verdict=Verdict.REJECTED,
                       reason=reason, smoothed={}, smoothed_std={}, budget=None)

    @property
    def profile_mps(self) -> tuple[Optional[float], Optional[float], Optional[float]]:
        """Smoothed speed in the first pair, in the last, and the greatest, m/s."""
        if not self.smoothed:
            return None, None, None
        speeds = [self.smoothed[ns] for ns in sorted(self.smoothed)]
        return speeds[0], speeds[-1], max(speeds)
