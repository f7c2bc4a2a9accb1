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
    :param right_came_ns: header stamp of the right image as it came, where ``right_stamp_ns`` is
        another one that the images speak for; None where it is none.
    """

    index: int
    stamp_ns: int
    right_stamp_ns: int
    left: NDArray[Any]
    right: NDArray[Any]
    stamp_error_s: float = 0.0
    motion: Optional[RigMotion] = None
    right_came_ns: Optional[int] = None

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
        return replace(self, right_stamp_ns=self.stamp_ns, stamp_error_s=self.right_lag_s,
                       right_came_ns=self.right_stamp_ns)


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
    :param unnoticed_mps: by how much the speed may be wrong while hard braking does not show, m/s.
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
    unnoticed_mps: float = 0.0

    def unconfirmed(self) -> TrackUpdate:
        """Return it as one that is no reading; one that was none stays what it is."""
        return replace(self, state=TrackState.TENTATIVE) \
            if self.state is TrackState.CONFIRMED else self

    def doubted(self, share: float) -> TrackUpdate:
        """Return it with another independent doubt of the speed, a 1-sigma as a share of it."""
        return replace(self, speed_std_mps=math.hypot(self.speed_std_mps, share * self.speed_mps))
