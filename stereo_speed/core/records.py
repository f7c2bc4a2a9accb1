# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The records that all layers share.

Time is integer nanoseconds of the header stamp; geometry is in the left camera's optical frame
(x right, y down, z forward), in metres; pixels are those of the raw images.
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
    """A word of a fixed vocabulary, printed as its value."""

    __str__ = str.__str__


class TrackState(Word):
    """State of a track; the values are those of ``tracks.csv``."""

    TENTATIVE = 'tentative'
    CONFIRMED = 'confirmed'
    COASTING = 'coasting'


@dataclass(frozen=True, eq=False)
class InitialFront:
    """
    A vehicle's front in the first pair of its track, annotated by a person or detected.

    :param frame: index of the pair.
    :param left_px: (4, 2) corners in the raw left image, px, clockwise from the image's top-left
        corner.
    :param right_px: (4, 2) the same in the raw right image, px.
    :param std_px: 1-sigma of each corner, px.
    """

    frame: int
    left_px: Array
    right_px: Array
    std_px: float = 0.7


@dataclass(frozen=True)
class RigMotion:
    """
    Rotation of a rig when it took a pair, relative to how it stood when the site was learnt.

    Angles are pan to the right, tilt upwards and roll clockwise, rad: components of one rotation
    vector about the camera's y, x and z axis.

    :param sway_rad: rotation of the whole rig about the left camera.
    :param drift_rad: rotation of the right camera relative to the left one.
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
    :param stamp_error_s: difference of the header stamps, s, if it was found to be an error.
    :param motion: rotation of the rig; None if it stood as when the site was learnt.
    :param right_came_ns: original header stamp of the right image, if ``right_stamp_ns`` was
        replaced; None otherwise.
    :param blur_px2: squared blur (1-sigma) of the right view less that of the left one, px^2; 0
        if not known.
    """

    index: int
    stamp_ns: int
    right_stamp_ns: int
    left: NDArray[Any]
    right: NDArray[Any]
    stamp_error_s: float = 0.0
    motion: Optional[RigMotion] = None
    right_came_ns: Optional[int] = None
    blur_px2: float = 0.0

    @property
    def right_lag_s(self) -> float:
        """Return the time from the left to the right exposure, s."""
        return (self.right_stamp_ns - self.stamp_ns) * 1e-9

    def triggered(self, tolerance_s: float) -> StereoPair:
        """
        Return the pair with one stamp for both views if its stamps differ only by an error.

        :param tolerance_s: largest difference of stamps that counts as an error of one exposure.
        """
        if not 0 < abs(self.right_lag_s) <= tolerance_s:
            return self
        return replace(self, right_stamp_ns=self.stamp_ns, stamp_error_s=self.right_lag_s,
                       right_came_ns=self.right_stamp_ns)


@dataclass(frozen=True, eq=False)
class TrackUpdate:
    """
    A tracker's estimate of one vehicle after one pair, from this pair and earlier ones only.

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
    :param axes: (3, 3) unit vectors of heading, left and up as columns, left optical frame.
    :param quad_left_px: (4, 2) corners of the front in the raw left image, px, clockwise from
        the image's top-left corner.
    :param quad_right_px: (4, 2) the same in the raw right image, px.
    :param unnoticed_mps: largest error of the speed by hard braking that the images cannot show
        yet, m/s.
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
        """Return the update as tentative if it was confirmed, else as it is."""
        return replace(self, state=TrackState.TENTATIVE) \
            if self.state is TrackState.CONFIRMED else self

    def doubted(self, share: float) -> TrackUpdate:
        """Return the update with another independent 1-sigma, given as a share of the speed."""
        return replace(self, speed_std_mps=math.hypot(self.speed_std_mps, share * self.speed_mps))
