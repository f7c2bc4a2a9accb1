# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What the detector gives, and what it must be told."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np

from ..core.records import Array, StereoPair


@dataclass(frozen=True, eq=False, kw_only=True)
class Earlier:
    """
    Where the face of a detection was in an earlier pair.

    :param pairs: that pair, and those since that were looked at, without the detection's own.
    :param left_px: (4, 2) corners in its raw left image, as in the detection.
    :param right_px: (4, 2) the same in its raw right image.
    """

    pairs: tuple[StereoPair, ...]
    left_px: Array
    right_px: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Detection:
    """
    A vehicle's front (its rear, where it drives away) found in one pair.

    The quad lies on the face's lower, nearly upright part: bumper, lamps, grille and plate.

    :param lane: name of the lane whose path is nearest.
    :param left_px: (4, 2) corners in the raw left image, clockwise from the top left.
    :param right_px: (4, 2) the same in the raw right image.
    :param std_px: 1-sigma of the quad's place against the vehicle, px.
    :param s_m: arc length of the face along the lane's path, m.
    :param s_std_m: its 1-sigma, m.
    :param lateral_m: offset of the face's middle to the left of the path, m.
    :param width_m: width of the quad, m.
    :param height_m: height of the quad, m.
    :param speed_mps: speed along the path between the two pairs it was verified in, m/s.
    :param earlier: where it was in the earlier one of them; None where a corner was out of view.
    :param confidence: between 0 and 1: the least of the correlations that confirm it.
    """

    lane: str
    left_px: Array
    right_px: Array
    std_px: float
    s_m: float
    s_std_m: float
    lateral_m: float
    width_m: float
    height_m: float
    speed_mps: float
    earlier: Optional[Earlier]
    confidence: float


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackedRegion:
    """
    A place that a track already holds, predicted for the pair.

    :param lane: name of the lane.
    :param s_m: arc length of the tracked face along the lane's path, m.
    :param lateral_m: offset of its middle to the left of the path, m.
    :param width_m: its width, m.
    :param height_m: its height, m.
    :param left_px: (4, 2) its corners in the raw left image, px.
    :param right_px: (4, 2) the same in the raw right image, px.
    """

    lane: str
    s_m: float
    lateral_m: float
    width_m: float
    height_m: float
    left_px: Array
    right_px: Array

    @property
    def finite(self) -> bool:
        """Whether the place is known at all."""
        return bool(np.isfinite([self.s_m, self.lateral_m]).all())
