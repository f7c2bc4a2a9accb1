# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the detectors: default, unit, bounds and meaning."""
from __future__ import annotations

from dataclasses import dataclass

from ..core.config import check_bounds, parameter, section
from ..core.errors import InputError


def check_order(low: str, low_value: float, high: str, high_value: float) -> None:
    """
    Check that one parameter is below another one.

    :raises InputError: names the first.
    """
    if not low_value < high_value:
        raise InputError('configuration', low, low_value, f'less than {high}, {high_value}')


@dataclass(frozen=True)
class FrontConfig:
    """What a front is, and how surely both views must show one."""

    low_m: float = parameter(
        0.27, 0.05, 1.0, 'm', 'height above the road of the lower edge of the quad')
    high_m: float = parameter(
        0.78, 0.2, 2.5, 'm', 'height above the road of its upper edge')
    tall_low_m: float = parameter(
        0.40, 0.05, 2.0, 'm', 'height of the lower edge of the quad on lorries')
    tall_high_m: float = parameter(1.25, 0.3, 3.0, 'm', 'height of its upper edge there')
    tall_width_m: float = parameter(2.14, 1.5, 2.5, 'm', 'what is narrower is no lorry')
    least_width_m: float = parameter(
        1.0, 0.5, 2.0, 'm', 'what is narrower is no vehicle')
    reach_m: float = parameter(
        1.9, 0.3, 6.0, 'm', 'how far beside the path of a lane the middle of a vehicle may be')
    least_cross_ncc: float = parameter(
        0.75, 0.0, 1.0, '', 'left-right correlation of a front at its depth')
    upright_factor: float = parameter(
        2.0, 0.0, 100.0, '', 'what the correlation lacks must be so many times more where the '
        'front is taken to lie on the road')
    hopeless_ncc: float = parameter(
        0.3, -1.0, 1.0, '', 'a proposal whose correlation is lower is given up, not refined')
    axis_std_m: float = parameter(
        0.03, 0.001, 1.0, 'm', '1-sigma of the middle of a front that is found, which a track '
        'takes for that of its first corners')

    def __post_init__(self) -> None:
        check_bounds(self)
        check_order('low_m', self.low_m, 'high_m', self.high_m)
        check_order('tall_low_m', self.tall_low_m, 'tall_high_m', self.tall_high_m)


@dataclass(frozen=True)
class MotionConfig:
    """When a front has come along its lane since an earlier pair."""

    reference_s: float = parameter(
        0.19, 0.01, 2.0, 's', 'a vehicle must have moved since the pair that is at least so old, '
        'or since the oldest there is')
    long_reference_s: float = parameter(
        0.75, 0.1, 5.0, 's', 'the same for slow vehicles')
    least_speed_mps: float = parameter(
        1.5, 0.1, 20.0, 'm/s', 'what moves slower along its lane is not reported')
    greatest_speed_mps: float = parameter(
        70.0, 5.0, 150.0, 'm/s', 'nor what moves faster')
    aside_mps: float = parameter(
        3.5, 0.0, 20.0, 'm/s', 'speed across the lane, at most, of a vehicle that changes lanes')
    aside_m: float = parameter(
        0.15, 0.0, 2.0, 'm', 'error of the path across, for vehicles that keep to their lane')
    least_ncc: float = parameter(
        0.70, 0.0, 1.0, '', 'correlation of a front with itself in the earlier pair')
    still_margin: float = parameter(
        0.05, 0.0, 1.0, '', 'by so much that correlation exceeds the one with what was then where '
        'the front is now')
    least_px: float = parameter(
        2.0, 0.0, 100.0, 'px', 'what has moved less in the left image has not moved')
    change_factor: float = parameter(
        3.0, 0.1, 100.0, '', 'a column of a front looks other than before when it changes by so '
        'many times more than noise and sampling explain, as squares')
    occluded_share: float = parameter(
        0.2, 0.0, 1.0, '', 'a front that looks other in more of its middle was occluded in part')
    speed_std_share: float = parameter(
        0.05, 0.0, 1.0, '', '1-sigma of the speed between the two pairs a vehicle is found in, as '
        'a share of it')

    def __post_init__(self) -> None:
        check_bounds(self)
        check_order('reference_s', self.reference_s, 'long_reference_s', self.long_reference_s)
        check_order('least_speed_mps', self.least_speed_mps,
                    'greatest_speed_mps', self.greatest_speed_mps)


@dataclass(frozen=True)
class SpacingConfig:
    """How near to each other two vehicles can be."""

    along_m: float = parameter(
        4.5, 1.0, 30.0, 'm', 'least distance between two fronts in one lane at rest')
    headway_s: float = parameter(
        0.3, 0.0, 2.0, 's', 'and more by the way driven in this time: what moves nearer behind '
        'a front is the side of its vehicle')
    across_m: float = parameter(
        1.2, 0.0, 10.0, 'm', 'fronts whose middles are nearer across the lane are in one lane, as '
        'are those that overlap')
    least_half_m: float = parameter(
        0.8, 0.0, 3.0, 'm', 'half the width of a tracked vehicle, where its track follows less')

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True)
class SweepConfig:
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
        1.2, 0.0, 20.0, '', 'nor does one whose standard deviation is below so many times the '
        'noise of the images')
    least_votes: float = parameter(
        1.5, 0.1, 100.0, '', 'votes of windows that make a proposal; each counts as much as its '
        'views correlate')
    most_proposals: int = parameter(
        6, 1, 100, '', 'proposals of a lane in a pair, the best first')
    most_refined: int = parameter(
        4, 1, 100, '', 'of those on no tracked vehicle so many are refined')

    def __post_init__(self) -> None:
        check_bounds(self)


TRIGGER_TOLERANCE_DOC = (
    'pairs whose stamps differ by less were exposed at once; beyond it each view is taken at its '
    'own time, as by the trackers')


@dataclass(frozen=True)
class DetectorConfig:
    """Parameters of the detector that sweeps planes; see ``detector`` for how they are used."""

    interval_s: float = parameter(
        0.09, 0.0, 2.0, 's', 'vehicles are looked for at most this often')
    long_every: int = parameter(
        3, 1, 1000, '', 'slow vehicles are looked for in one of so many of these pairs')
    forget_after_s: float = parameter(
        3.0, 0.1, 60.0, 's', 'after so long a gap whatever was in view has left')
    trigger_tolerance_s: float = parameter(5e-4, 0.0, 1.0, 's', TRIGGER_TOLERANCE_DOC)
    least_symmetry: float = parameter(
        0.60, 0.0, 1.0, '', 'correlation of a front with its mirror image')

    sweep: SweepConfig = section(SweepConfig, 'where fronts are proposed')
    front: FrontConfig = section(FrontConfig, 'what both views must show')
    motion: MotionConfig = section(MotionConfig, 'since an earlier pair')
    spacing: SpacingConfig = section(SpacingConfig, 'one vehicle or two')

    def __post_init__(self) -> None:
        check_bounds(self)
        check_order('interval_s', self.interval_s, 'forget_after_s', self.forget_after_s)
