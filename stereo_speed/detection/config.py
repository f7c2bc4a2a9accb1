# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the detectors: default, unit, bounds and meaning."""
from __future__ import annotations

from dataclasses import dataclass

from ..core.config import CheckedRecord, parameter, section


@dataclass(frozen=True)
class FrontConfig(CheckedRecord):
    """What a front is, and how surely both views must show one."""

    low_m: float = parameter(
        0.27, 0.05, 1.0, 'm', 'height above the road of the lower edge of the quad',
        below='high_m')
    high_m: float = parameter(
        0.78, 0.2, 2.5, 'm', 'height above the road of its upper edge')
    tall_low_m: float = parameter(
        0.40, 0.05, 2.0, 'm', 'height of the lower edge of the quad on lorries',
        below='tall_high_m')
    tall_high_m: float = parameter(1.25, 0.3, 3.0, 'm', 'height of its upper edge there')
    tall_width_m: float = parameter(2.14, 1.5, 2.5, 'm', 'what is narrower is no lorry')
    raised_low_m: float = parameter(
        0.45, 0.05, 2.0, 'm', 'height of the lower edge of the quad on cars and vans that show '
        'nothing but their lamps, as by night', below='raised_high_m')
    raised_high_m: float = parameter(
        1.0, 0.3, 3.0, 'm', 'height of its upper edge there')
    least_width_m: float = parameter(
        1.0, 0.5, 2.0, 'm', 'what is narrower is no vehicle')
    narrow_low_m: float = parameter(
        0.40, 0.05, 2.0, 'm', 'height of the lower edge of the quad on two-wheelers',
        below='narrow_high_m')
    narrow_high_m: float = parameter(
        1.25, 0.3, 3.0, 'm', 'height of its upper edge there: the handlebars')
    narrow_least_m: float = parameter(
        0.4, 0.2, 1.0, 'm', 'what is narrower is no two-wheeler', below='narrow_most_m')
    narrow_most_m: float = parameter(
        1.2, 0.6, 2.0, 'm', 'what is wider is no two-wheeler')
    narrow_length_m: float = parameter(
        1.5, 0.0, 4.0, 'm', 'how far behind the front of a two-wheeler its rider and luggage '
        'reach: seen aslant, they are beside it')
    narrow_behind_m: float = parameter(
        18.0, 0.0, 30.0, 'm', 'so far behind a front, as lorries are long, what is narrow and at '
        'the side of that vehicle is part of it')
    narrow_behind_car_m: float = parameter(
        6.0, 0.0, 30.0, 'm', 'the same behind the front of a car, which is shorter')
    narrow_car_width_m: float = parameter(
        1.95, 1.0, 3.0, 'm', 'what is as wide may be the front of a van or a lorry, of which the '
        'outermost may not show; what is narrower is a car')
    narrow_side_m: float = parameter(
        0.5, 0.0, 2.0, 'm', 'what is so near to the side of a vehicle, across the lane, is at it')
    reach_m: float = parameter(
        1.9, 0.3, 6.0, 'm', 'how far beside the path of a lane the middle of a vehicle may be')
    least_cross_ncc: float = parameter(
        0.75, 0.0, 1.0, '', 'views of a front correlate at least so well at its depth')
    upright_factor: float = parameter(
        2.0, 0.0, 100.0, '', 'taken to lie on the road, a front must lack so many times more of '
        'a perfect correlation than standing')
    hopeless_ncc: float = parameter(
        0.3, -1.0, 1.0, '', 'a proposal whose views, or mirror images, correlate no better is '
        'given up, not refined')
    axis_std_m: float = parameter(
        0.03, 0.001, 1.0, 'm', '1-sigma of the middle of a front that is found; a track takes it '
        'for that of the corners')


@dataclass(frozen=True)
class MotionConfig(CheckedRecord):
    """When a front has come along its lane since an earlier pair."""

    reference_s: float = parameter(
        0.19, 0.01, 2.0, 's', 'a vehicle must have moved since the newest earlier pair that is '
        'at least so old, or since the oldest one kept', below='long_reference_s')
    long_reference_s: float = parameter(
        0.75, 0.1, 5.0, 's', 'a slow vehicle must have moved since the newest earlier pair that '
        'is at least so old; still older ones are not kept')
    least_speed_mps: float = parameter(
        1.5, 0.1, 20.0, 'm/s', 'what moves slower along its lane is not reported',
        below='greatest_speed_mps')
    greatest_speed_mps: float = parameter(
        70.0, 5.0, 150.0, 'm/s', 'what moves faster along its lane is not reported')
    aside_mps: float = parameter(
        3.5, 0.0, 20.0, 'm/s', 'greatest speed across the lane, for vehicles that change lanes')
    aside_m: float = parameter(
        0.15, 0.0, 2.0, 'm', 'error of the path across, which adds to the way that a vehicle may '
        'have moved across')
    least_ncc: float = parameter(
        0.70, 0.0, 1.0, '', 'least correlation of a front with itself in the earlier pair')
    still_margin: float = parameter(
        0.05, 0.0, 1.0, '', 'by so much that correlation must exceed the one with what stood in '
        'the same place in the earlier pair')
    least_px: float = parameter(
        2.0, 0.0, 100.0, 'px', 'what has moved less in the left image has not moved')
    change_factor: float = parameter(
        3.0, 0.1, 100.0, '', 'a column of a front has changed when the square of its change is '
        'so many times what noise and sampling explain')
    occluded_share: float = parameter(
        0.2, 0.0, 1.0, '', 'a front is occluded in part when a greater share of its middle has '
        'changed')
    speed_std_share: float = parameter(
        0.05, 0.0, 1.0, '', '1-sigma of the speed between the two pairs a vehicle is found in, as '
        'a share of it')


@dataclass(frozen=True)
class SpacingConfig(CheckedRecord):
    """How near to each other two vehicles can be."""

    along_m: float = parameter(
        4.5, 1.0, 30.0, 'm', 'least distance between two fronts in one lane at rest')
    headway_s: float = parameter(
        0.3, 0.0, 2.0, 's', 'the way driven in this time is added to along_m: what moves nearer '
        'behind a front is the side of its vehicle')
    across_m: float = parameter(
        1.2, 0.0, 10.0, 'm', 'fronts whose middles are nearer across the lane are in one lane, '
        'as are those that overlap')
    least_half_m: float = parameter(
        0.8, 0.0, 3.0, 'm', 'least half width of the place that a track holds')


@dataclass(frozen=True)
class SweepConfig(CheckedRecord):
    """Where a front is proposed by the sweep of planes along a lane."""

    least_px_per_m: float = parameter(
        20.0, 5.0, 500.0, 'px/m', 'scale of the image below which a vehicle is too far to be '
        'found; 20 is a front of 1.8 m seen 36 px wide')
    still_ncc: float = parameter(
        0.75, -1.0, 1.0, '', 'a window that correlates better with the earlier pair shows nothing '
        'that has moved')
    least_ncc: float = parameter(
        0.6, -1.0, 1.0, '', 'a window whose views correlate less shows nothing upright')
    least_contrast: float = parameter(
        2.0, 0.0, 100.0, '', 'a window whose standard deviation in grey levels is lower shows '
        'nothing')
    noise_factor: float = parameter(
        1.2, 0.0, 20.0, '', 'a window whose standard deviation is below so many times the noise '
        'of the images shows nothing either')
    least_votes: float = parameter(
        1.5, 0.1, 100.0, '', 'least votes of windows for a proposal; each counts as much as its '
        'views correlate')
    most_proposals: int = parameter(
        6, 1, 100, '', 'greatest number of proposals of a lane in a pair, the best first')
    most_refined: int = parameter(
        4, 1, 100, '', 'greatest number of those, on no tracked vehicle, that are refined for '
        'cars, and for lorries')


@dataclass(frozen=True)
class DetectorConfig(CheckedRecord):
    """Parameters of the detector that sweeps planes; see ``detector`` for how they are used."""

    interval_s: float = parameter(
        0.09, 0.0, 2.0, 's', 'least time between two searches of a lane for vehicles; where three '
        'pairs or more come in it, it is reference_s at least',
        below='forget_after_s')
    long_every: int = parameter(
        3, 1, 1000, '', 'slow vehicles are looked for in one of so many searches')
    forget_after_s: float = parameter(
        3.0, 0.1, 60.0, 's', 'after a longer gap between pairs the earlier ones are forgotten: '
        'whatever was in view has left')
    least_symmetry: float = parameter(
        0.60, 0.0, 1.0, '', 'least correlation of a front with its mirror image')

    sweep: SweepConfig = section(SweepConfig, 'where fronts are proposed')
    front: FrontConfig = section(FrontConfig, 'what both views must show')
    motion: MotionConfig = section(MotionConfig, 'since an earlier pair')
    spacing: SpacingConfig = section(SpacingConfig, 'one vehicle or two')
