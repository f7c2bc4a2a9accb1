# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the detector: default, unit, bounds and meaning."""
from __future__ import annotations

from dataclasses import dataclass

from ..core.config import check_bounds, parameter


@dataclass(frozen=True)
class DetectorConfig:
    """Parameters of the vehicle detector; see ``detector`` for how they are used."""

    least_px_per_m: float = parameter(
        20.0, 5.0, 500.0, 'px/m', 'scale of the image below which a vehicle is too far to be '
        'found; 20 is a front of 1.8 m seen 36 px wide')
    interval_s: float = parameter(
        0.09, 0.0, 2.0, 's', 'vehicles are looked for at most this often')
    reference_s: float = parameter(
        0.19, 0.01, 2.0, 's', 'a vehicle must have moved since the pair that is at least so old, '
        'or since the oldest there is')
    long_reference_s: float = parameter(
        0.75, 0.1, 5.0, 's', 'the same for slow vehicles')
    least_speed_mps: float = parameter(
        1.5, 0.1, 20.0, 'm/s', 'what moves slower along its lane is not reported')
    greatest_speed_mps: float = parameter(
        70.0, 5.0, 150.0, 'm/s', 'nor what moves faster')
    reach_m: float = parameter(
        1.9, 0.3, 6.0, 'm', 'how far beside the path of a lane the middle of a vehicle may be')
    face_low_m: float = parameter(
        0.27, 0.05, 1.0, 'm', 'height above the road of the lower edge of the quad')
    face_high_m: float = parameter(
        0.78, 0.2, 2.5, 'm', 'height above the road of its upper edge')
    tall_low_m: float = parameter(
        0.40, 0.05, 2.0, 'm', 'height of the lower edge of the quad on lorries')
    tall_high_m: float = parameter(1.25, 0.3, 3.0, 'm', 'height of its upper edge there')
    tall_width_m: float = parameter(2.14, 1.5, 3.0, 'm', 'what is narrower is no lorry')
    least_width_m: float = parameter(
        1.0, 0.5, 2.0, 'm', 'what is narrower is no vehicle')
    least_cross_ncc: float = parameter(
        0.75, 0.0, 1.0, '', 'left-right correlation of a face at its depth')
    least_motion_ncc: float = parameter(
        0.70, 0.0, 1.0, '', 'correlation of a face with itself in the earlier pair')
    least_symmetry: float = parameter(
        0.60, 0.0, 1.0, '', 'correlation of a face with its mirror image')
    spacing_m: float = parameter(
        4.5, 1.0, 30.0, 'm', 'least distance between two fronts in one lane at rest')
    headway_s: float = parameter(
        0.3, 0.0, 2.0, 's', 'and more by the way driven in this time: what moves nearer behind '
        'a front is the side of its vehicle')
    speed_std_share: float = parameter(
        0.05, 0.0, 1.0, '', '1-sigma of the speed between the two pairs a vehicle is found in, as a '
        'share of it')

    def __post_init__(self) -> None:
        check_bounds(self)
