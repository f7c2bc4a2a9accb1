# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the detectors: default, unit, bounds and meaning."""
from __future__ import annotations

from dataclasses import dataclass

from ..core.config import CheckedRecord, parameter, section
from ..core.fronts import NARROW_M, TALL_HIGH_M, TALL_WIDTH_M


@dataclass(frozen=True)
class FrontConfig(CheckedRecord):
    """
    What counts as a front, and how clearly both views must show it.

    Edges of quads have these heights unless they would cut through lamps that clip (``lamps``).
    """

    low_m: float = parameter(
        0.27, 0.05, 1.0, 'm', 'height above the road of the lower edge of the quad',
        below='high_m')
    high_m: float = parameter(
        0.78, 0.2, 2.5, 'm', 'height above the road of the upper edge of the quad')
    tall_low_m: float = parameter(
        0.40, 0.05, 2.0, 'm', 'height above the road of the lower edge of the quad on lorries',
        below='tall_high_m')
    tall_high_m: float = parameter(
        TALL_HIGH_M, 0.3, 3.0, 'm', 'height above the road of the upper edge of the quad on '
        'lorries')
    tall_width_m: float = parameter(
        TALL_WIDTH_M, 1.5, 2.5, 'm', 'least width of a lorry')
    raised_low_m: float = parameter(
        0.45, 0.05, 2.0, 'm', 'height above the road of the lower edge of the quad on cars and '
        'vans of which only the lamps are visible, as at night', below='raised_high_m')
    raised_high_m: float = parameter(
        1.0, 0.3, 3.0, 'm', 'height above the road of the upper edge of that quad')
    least_width_m: float = parameter(
        1.0, 0.5, 2.0, 'm', 'least width of a vehicle other than a two-wheeler')
    narrow_low_m: float = parameter(
        0.40, 0.05, 2.0, 'm', 'height above the road of the lower edge of the quad on '
        'two-wheelers', below='narrow_high_m')
    narrow_high_m: float = parameter(
        1.25, 0.3, 3.0, 'm', 'height above the road of the upper edge of the quad on '
        'two-wheelers, that of the handlebars')
    narrow_least_m: float = parameter(
        0.4, 0.2, 1.0, 'm', 'least width of a two-wheeler', below='narrow_most_m')
    narrow_most_m: float = parameter(
        NARROW_M, 0.6, 2.0, 'm', 'greatest width of a two-wheeler')
    narrow_length_m: float = parameter(
        1.5, 0.0, 4.0, 'm', 'distance to which rider and luggage extend behind the front of a '
        'two-wheeler; seen at an angle, they appear beside it')
    narrow_behind_m: float = parameter(
        18.0, 0.0, 30.0, 'm', 'distance behind a front, the length of a lorry, over which a '
        'narrow front at the side of that vehicle counts as part of it')
    narrow_behind_car_m: float = parameter(
        6.0, 0.0, 30.0, 'm', 'the same distance behind the front of a car')
    narrow_car_width_m: float = parameter(
        1.95, 1.0, 3.0, 'm', 'width from which on a front may be that of a van or lorry whose '
        'outer edges are not visible; narrower ones are cars')
    narrow_side_m: float = parameter(
        0.5, 0.0, 2.0, 'm', 'distance from the side of a vehicle, across the lane, within which a '
        'narrow front counts as at that side')
    reach_m: float = parameter(
        1.9, 0.3, 6.0, 'm', 'greatest distance of the middle of a vehicle from the path of its '
        'lane')
    least_cross_ncc: float = parameter(
        0.75, 0.0, 1.0, '', 'least correlation of the views of a front at its depth')
    upright_factor: float = parameter(
        2.0, 0.0, 100.0, '', 'least ratio of 1 - correlation of a front taken to lie on the road '
        'to that of the same front taken to stand')
    apart_m: float = parameter(
        3.0, 0.1, 100.0, 'm', 'least distance along the lane from which on the halves of a front, '
        'or a two-wheeler and what moves beside it, are two vehicles; their disparities must '
        'differ by apart_px as well')
    apart_px: float = parameter(
        0.8, 0.0, 100.0, 'px', 'least difference of these disparities; between the halves of one '
        'vehicle it is 0.2 px (1-sigma)')
    hopeless_ncc: float = parameter(
        0.3, -1.0, 1.0, '', 'correlation of the views, or with the mirror image, up to which a '
        'proposal is given up without further refinement')
    axis_std_m: float = parameter(
        0.03, 0.001, 1.0, 'm', '1-sigma of the middle of a detected front; a track uses it for '
        'the corners')


@dataclass(frozen=True)
class MotionConfig(CheckedRecord):
    """When a front counts as having moved along its lane since an earlier pair."""

    reference_s: float = parameter(
        0.19, 0.01, 2.0, 's', 'a vehicle must have moved since the newest earlier pair of at '
        'least this age, or else since the oldest one kept', below='long_reference_s')
    long_reference_s: float = parameter(
        0.75, 0.1, 5.0, 's', 'a slow vehicle must have moved since the newest earlier pair of at '
        'least this age; older pairs are not kept')
    least_speed_mps: float = parameter(
        1.5, 0.1, 20.0, 'm/s', 'least speed along the lane of a vehicle that is reported',
        below='greatest_speed_mps')
    greatest_speed_mps: float = parameter(
        70.0, 5.0, 150.0, 'm/s', 'greatest speed along the lane of a vehicle that is reported')
    aside_mps: float = parameter(
        3.5, 0.0, 20.0, 'm/s', 'greatest speed across the lane, for vehicles that change lanes')
    aside_m: float = parameter(
        0.15, 0.0, 2.0, 'm', 'error of the path across the lane, added to the distance that a '
        'vehicle may have moved across')
    least_ncc: float = parameter(
        0.70, 0.0, 1.0, '', 'least correlation of a front with itself in the earlier pair')
    still_margin: float = parameter(
        0.05, 0.0, 1.0, '', 'least margin of that correlation over the one with the unmoved place '
        'in the earlier pair')
    least_px: float = parameter(
        2.0, 0.0, 100.0, 'px', 'least motion of a front in the left image')
    change_factor: float = parameter(
        3.0, 0.1, 100.0, '', 'a column of a front counts as changed when its squared change is '
        'more than this many times what noise and sampling explain')
    occluded_share: float = parameter(
        0.2, 0.0, 1.0, '', 'share of changed columns in the middle of a front above which the '
        'front counts as partly occluded')
    speed_std_share: float = parameter(
        0.05, 0.0, 1.0, '', '1-sigma of the speed between the two pairs that a vehicle is '
        'detected in, as a share of it')


@dataclass(frozen=True)
class SpacingConfig(CheckedRecord):
    """How close to each other two vehicles can be."""

    along_m: float = parameter(
        4.5, 1.0, 30.0, 'm', 'least distance between two fronts in one lane at rest')
    headway_s: float = parameter(
        0.3, 0.0, 2.0, 's', 'the distance driven in this time is added to along_m; a closer front '
        'behind another one is the side of the same vehicle')
    across_m: float = parameter(
        1.2, 0.0, 10.0, 'm', 'distance across the lane below which two fronts count as in one '
        'lane, as do fronts that overlap or are less than beside_m apart')
    beside_m: float = parameter(
        0.2, 0.0, 2.0, 'm', 'least distance between the fronts of two vehicles beside each other; '
        'their mirrors are between them')
    least_half_m: float = parameter(
        0.8, 0.0, 3.0, 'm', 'least half width of the place that a track holds')


@dataclass(frozen=True)
class SweepConfig(CheckedRecord):
    """When the plane sweep along a lane proposes a front."""

    least_px_per_m: float = parameter(
        20.0, 5.0, 500.0, 'px/m', 'image scale below which a vehicle is too far away to be '
        'detected; at 20 a front of 1.8 m is 36 px wide')
    still_ncc: float = parameter(
        0.75, -1.0, 1.0, '', 'correlation of a window with the earlier pair from which on it '
        'shows no motion')
    least_ncc: float = parameter(
        0.6, -1.0, 1.0, '', 'least correlation of the views of a window that shows something '
        'upright')
    least_contrast: float = parameter(
        2.0, 0.0, 100.0, '', 'least standard deviation of a window in grey levels; windows with '
        'less are ignored')
    noise_factor: float = parameter(
        1.2, 0.0, 20.0, '', 'least standard deviation of a window as a multiple of the image '
        'noise; windows with less are ignored')
    least_votes: float = parameter(
        1.5, 0.1, 100.0, '', 'least sum of the votes of windows for a proposal; a vote is '
        'weighted by the correlation of its views')
    most_proposals: int = parameter(
        6, 1, 100, '', 'greatest number of proposals per lane and pair, the best first')
    most_refined: int = parameter(
        4, 1, 100, '', 'greatest number of proposals away from tracked vehicles that are refined, '
        'for each kind of front')


@dataclass(frozen=True)
class DetectorConfig(CheckedRecord):
    """Parameters of the plane-sweep detector; see ``detector`` for how they are used."""

    interval_s: float = parameter(
        0.09, 0.0, 2.0, 's', 'least time between two searches of a lane; at least '
        'motion.reference_s where three or more pairs come in this time',
        below='forget_after_s')
    long_every: int = parameter(
        3, 1, 1000, '', 'number of searches of which one includes slow vehicles')
    forget_after_s: float = parameter(
        3.0, 0.1, 60.0, 's', 'gap between pairs after which earlier pairs are discarded, because '
        'all vehicles have left the view')
    least_symmetry: float = parameter(
        0.60, 0.0, 1.0, '', 'least correlation of a front with its mirror image')

    sweep: SweepConfig = section(SweepConfig, 'plane sweep, which proposes fronts')
    front: FrontConfig = section(FrontConfig, 'what both views must show of a front')
    motion: MotionConfig = section(MotionConfig, 'how a front must have moved')
    spacing: SpacingConfig = section(SpacingConfig, 'least distances between vehicles')
