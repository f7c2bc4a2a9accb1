# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Every number one can set, once: default, unit, bounds and meaning.

A config record is a frozen dataclass of :func:`parameter` and :func:`section` fields.  The YAML
files of ``config/``, the command line and the ROS parameters all derive from such records.
"""
from __future__ import annotations

import dataclasses
from dataclasses import dataclass
import math
import operator
from pathlib import Path
from typing import Any, ClassVar, Iterator, Mapping, Optional, Protocol, TypeVar, Union

from .errors import InputError
from .strict_yaml import read_yaml
from .units import is_finite

Value = Union[bool, int, float, str]
_Value = TypeVar('_Value', bool, int, float, str)
_UNBOUNDED = 1e308  # of numbers that have no bound of their own


class ConfigRecord(Protocol):
    """Any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


Record = TypeVar('Record', bound=ConfigRecord)


def parameter(default: _Value, low: float = -_UNBOUNDED, high: float = _UNBOUNDED, unit: str = '',
              doc: str = '', *, choices: tuple[Value, ...] = (), below: str = '',
              at_least: str = '') -> _Value:
    """
    Return a field of a config record that carries its unit, bounds and meaning.

    :param default: its value where nobody sets it; its type is that of the parameter.
    :param low: least legal value, of numbers.
    :param high: greatest legal value, of numbers.
    :param unit: of numbers.
    :param doc: what it means.
    :param choices: the only legal values, where there are few.
    :param below: name of a parameter of the same record that must be greater.
    :param at_least: name of one that must not be greater.
    """
    meta = {'low': low, 'high': high, 'unit': unit, 'doc': doc, 'choices': choices,
            'below': below, 'at_least': at_least}
    field: _Value = dataclasses.field(default=default, metadata=meta)
    return field


def section(kind: type[Record], doc: str) -> Record:
    """
    Return a field of a config record that is a config record itself, with its defaults.

    :param kind: the record.
    :param doc: what its parameters have in common.
    """
    field: Record = dataclasses.field(default_factory=kind, metadata={'section': kind, 'doc': doc})
    return field


@dataclass(frozen=True)
class CheckedRecord:
    """A config record that is within its bounds from the moment it is made."""

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True)
class NoParameters:
    """The parameters of what has none."""


@dataclass(frozen=True)
class NoiseConfig(CheckedRecord):
    """How precisely images tell where a front is; these decide every sigma of matching."""

    independent_share: float = parameter(
        0.35, 0.01, 1.0, '', 'share of the samples of a low-passed patch that are independent')
    match_floor_px: float = parameter(
        0.0125, 0.0, 1.0, 'px', 'systematic error of matching one observation between the views, '
        'which no number of samples averages away')
    match_floor_pairs: float = parameter(
        4.0, 0.0, 1e6, 'pairs', 'observations that the error above is worth, beside those of the '
        'pass that show a greater scatter: as many as the shortest pass that is measured has')
    scatter_levels: int = parameter(
        5, 1, 10, '', 'scatters of disparities that are weighed against each other in each pass, '
        'each twice the one before; 1 for the error above alone')
    texture_floor_px: float = parameter(
        0.025, 0.0, 1.0, 'px', 'systematic error of one observation against the texture of the '
        'front, by relief and light')
    tail_dof: float = parameter(
        2.0, 1.0, 1e6, '', 'degrees of freedom of the t distribution of the residuals: the fewer, '
        'the less count clipped lamps, sliding highlights and dirt; a million for none of them')
    clipped_share: float = parameter(
        0.98, 0.5, 1.0, '', 'share of the full scale of the images from which on a grey value '
        'counts as clipped: what it outlines keeps its size in pixels while the front grows')
    clipped_reach_px: float = parameter(
        3.0, 0.0, 20.0, 'px', 'how far around what is clipped the light of it spreads in the lens')
    relief_std_m: float = parameter(
        0.04, 0.0001, 0.5, 'm', 'scale of the relief of a front: bumper, grille and lamps lie '
        'centimetres apart in depth')
    relief_dof: float = parameter(
        2.0, 1.0, 1e6, '', 'degrees of freedom of the t distribution of the relief: the fewer, '
        'the freer are parts far behind the rest, as of a rider; from 1 to 4 speeds are the same, '
        'a million frees none')
    gauge_std_m: float = parameter(
        0.005, 0.0001, 0.5, 'm', '1-sigma of the place of the front across and above the path in '
        'its first observation, which defines its centre')
    sharpness_sigmas: float = parameter(
        3.0, 0.0, 1000.0, '', 'where one view is blurrier than the other by so many sigmas, the '
        'front is blurred in the other as well; 1000 for never')
    most_blur_px: float = parameter(
        2.5, 0.5, 10.0, 'px', 'greatest 1-sigma of a blur that one view has more than the other')
    blur_doubt: float = parameter(
        0.3, 0.0, 3.0, '', 'share of what such blurs change a pass by that counts as a 1-sigma, '
        'fitted to the errors of passes out of focus; 0 for none')
    start_std_px: float = parameter(
        0.15, 0.01, 5.0, 'px', '1-sigma of the first particles in depth, as disparity')


@dataclass(frozen=True)
class VisibilityConfig(CheckedRecord):
    """When a vehicle counts as seen, occluded, confirmed or lost."""

    least_ncc: float = parameter(
        0.5, 0.0, 1.0, '', 'an observation that agrees less with the other view, or with the '
        'texture, does not show the vehicle')
    occlusion_deficit: float = parameter(
        0.03, 0.0, 1.0, '', 'an observation is occluded when its correlation lacks more than this '
        'beyond what noise explains')
    occlusion_noise_factor: float = parameter(
        3.0, 0.0, 100.0, '', 'noise explains this many times what the best observations lack')
    occlusion_best_share: float = parameter(
        0.1, 0.0, 1.0, '', 'share of the observations of a pass that are taken as its best')
    confirm_pairs: int = parameter(
        3, 1, 100, '', 'pairs in which a vehicle is wholly seen before its readings are '
        'confirmed, and so published')
    reading_std_mps: float = parameter(
        0.5, 0.0, 100.0, 'm/s', 'a reading is confirmed, and so published, only where its 1-sigma '
        'is below this')
    reading_std_share: float = parameter(
        0.02, 0.0, 10.0, '', 'or below this share of its speed')
    unnoticed_braking_mps2: float = parameter(
        6.0, 0.0, 20.0, 'm/s^2', 'the 1-sigma of a reading allows for drivers who have begun to '
        'brake as hard as this, or to accelerate, before the images can show it')
    unnoticed_sigmas: float = parameter(
        3.0, 0.1, 100.0, '', 'by how many of these such a reading is off for that alone, at most')
    unnoticed_std_mps: float = parameter(
        0.75, 0.0, 100.0, 'm/s', 'a reading whose 1-sigma is above this for it is held '
        'back, unless it would be one by reading_std_mps or reading_std_share')
    lost_after_s: float = parameter(
        1.5, 0.0, 60.0, 's', 'a vehicle not seen for longer is lost; behind a pole or in missing '
        'images it is gone for less')
    occluded_for_s: float = parameter(
        4.0, 0.0, 60.0, 's', 'a vehicle not wholly seen for longer is lost, even while a part of '
        'it is seen, as behind one that overtakes')
    least_width_px: float = parameter(
        12.0, 1.0, 500.0, 'px', 'a front or rear neither as wide nor as high as this has left '
        'the view')
    beyond_path_m: float = parameter(
        20.0, 0.0, 500.0, 'm', 'a vehicle further beyond the end of its path has left the view')
    speed_change_sigmas: float = parameter(
        3.0, 0.0, 100.0, '', 'a reading is held back when it differs from the last one by so '
        'many sigmas more than most_acceleration_mps2 allows')


@dataclass(frozen=True)
class StartConfig(CheckedRecord):
    """When two quads are one front, in the first pair of a track."""

    most_gap_px: float = parameter(
        5.0, 0.1, 100.0, 'px', 'quads whose centres are further off a common epipolar line show '
        'different things')
    search_sigmas: float = parameter(
        4.0, 0.5, 20.0, '', 'depths searched to either side of the one that the quads give, in '
        'its sigmas')
    least_ncc: float = parameter(
        0.5, 0.0, 1.0, '', 'left and right quads that correlate less are not of one front')
    any_speed_share: float = parameter(
        0.25, 0.0, 1.0, '', 'share of the first particles whose speeds are drawn evenly, for '
        'speeds that no limit foresees')
    any_speed_factor: float = parameter(
        2.5, 0.1, 20.0, '', 'greatest speed of these particles, as a multiple of the expected '
        'speed')


@dataclass(frozen=True)
class VerdictConfig(CheckedRecord):
    """Which passes are rejected, beside those whose 1-sigma is too great."""

    least_pairs: int = parameter(
        4, 2, 1000, '', 'a pass wholly seen in fewer pairs is rejected as too_few_pairs')
    least_width_px: float = parameter(
        20.0, 1.0, 1000.0, 'px', 'a front never as wide or as high as this is rejected as too_far')
    far_width_px: float = parameter(
        40.0, 1.0, 1000.0, 'px', 'an uncertain pass of a front never as wide or as high as this '
        'is rejected as too_far, others as uncertain')
    least_median_ncc: float = parameter(
        0.6, 0.0, 1.0, '', 'a pass whose views agree less in half of its observations is rejected '
        'as views_disagree')
    most_height_change_m: float = parameter(
        0.6, 0.01, 10.0, 'm', 'a pass whose front climbs or sinks more against the path is '
        'rejected as off_path')
    most_speed_mps: float = parameter(
        90.0, 1.0, 300.0, 'm/s', 'a faster pass is rejected as implausible')
    most_acceleration_mps2: float = parameter(
        12.0, 0.1, 100.0, 'm/s^2', 'more than tyres can do: a pass with a greater acceleration '
        'is rejected as implausible, a live reading that needs one is held back')
    off_road_m: float = parameter(
        3.0, 0.1, 50.0, 'm', 'a vehicle further from the middle of every lane is off the road')
    off_road_share: float = parameter(
        0.5, 0.0, 1.0, '', 'a pass off the road in more than this share of its pairs is rejected '
        'as off_path')
    lane_hysteresis_m: float = parameter(
        0.3, 0.0, 5.0, 'm', 'a vehicle has changed lanes when the path of another lane is nearer '
        'by more than this')


@dataclass(frozen=True)
class EffortConfig(CheckedRecord):
    """How much is spent on a pass: more takes longer and gains little."""

    live_observations: int = parameter(
        24, 4, 1000, '', 'observations that a live reading is solved from; older ones become '
        'inactive keyframes')
    pass_observations: int = parameter(
        60, 4, 1000, '', 'observations that the pass is measured from, evenly spaced; at least '
        'live_observations', at_least='live_observations')
    fewest_particles: int = parameter(
        100, 20, 20000, '', 'particles that a track keeps however many tracks share the budget; '
        'never more than particles')
    solve_interval_s: float = parameter(
        0.06, 0.0, 1.0, 's', 'a reading is solved for when so much time has passed since the last '
        'one that was: nearer ones rest on nearly the same pairs, and pairs between are kept and '
        'solved for with the next one; 0 solves for every reading. Who has a share of '
        'particle_budget waits as many times longer')


@dataclass(frozen=True)
class AssociationConfig(CheckedRecord):
    """How what the detector finds becomes tracks, one for each vehicle."""

    catch_up_pairs: int = parameter(
        3, 1, 50, '', 'earlier pairs, at most, that a new track is fed')
    same_speed_sigmas: float = parameter(
        3.0, 0.1, 100.0, '', 'a new track whose speed differs by more sigmas from what its '
        'detector saw is doubted: a front occluded in part misleads one of them')
    moving_sigmas: float = parameter(
        3.0, 0.0, 100.0, '', 'a new track whose speed is off zero by fewer sigmas stays '
        'tentative: a detector may take road that a vehicle has uncovered for what moves')
    doubt_s: float = parameter(
        1.0, 0.0, 60.0, 's', 'time for which a doubted track stays tentative, whatever it does')
    braking_mps2: float = parameter(
        6.0, 0.0, 20.0, 'm/s^2', 'greatest braking that may explain the difference of speeds '
        'after that time; a greater difference keeps the track tentative')
    gone_s: float = parameter(
        1.0, 0.0, 60.0, 's', 'time for which a vehicle that has left the view is not detected '
        'again')
    same_vehicle_m: float = parameter(
        1.5, 0.1, 20.0, 'm', 'fronts nearer to each other are of one vehicle')


@dataclass(frozen=True)
class SecondConfig(CheckedRecord):
    """A second, independent estimate of each pass, which the first has to agree with."""

    enabled: bool = parameter(
        True, doc='estimate each pass a second time, by corners triangulated in its pairs, and '
        'reject it as second_estimate where the two disagree')
    most_sigmas: float = parameter(
        4.0, 0.0, 100.0, '', 'the estimates disagree when they differ by more of their combined '
        '1-sigmas')
    most_difference_mps: float = parameter(
        0.5555555555555556, 0.0, 100.0, 'm/s', 'or by more than this, which is 2 km/h')
    least_sigmas: float = parameter(
        3.0, 0.0, 100.0, '', 'a difference above most_difference_mps of fewer of their combined '
        '1-sigmas tells nothing of the first one: there is no second estimate')
    most_std_share: float = parameter(
        0.009, 0.0, 1.0, '', 'a second estimate whose 1-sigma is a greater share of its speed is '
        'none')
    least_pairs: int = parameter(
        4, 3, 1000, '', 'pairs that it rests on, at least')
    most_pairs: int = parameter(
        40, 4, 1000, '', 'and at most, evenly spaced; at least least_pairs',
        at_least='least_pairs')
    least_points: int = parameter(
        5, 3, 1000, '', 'corners of a pair that are seen in other pairs too, at least')
    most_points: int = parameter(
        40, 3, 1000, '', 'corners of a pair, at most; at least least_points',
        at_least='least_points')
    least_quality: float = parameter(
        0.001, 0.0001, 1.0, '', 'strength of a corner, as a share of that of the strongest, '
        'which may be a lamp')
    most_round_trip_px: float = parameter(
        0.5, 0.01, 10.0, 'px', 'a corner that is found elsewhere, and from there not back to '
        'where it was by more, is not matched')
    match_std_px: float = parameter(
        0.1, 0.001, 5.0, 'px', 'least 1-sigma of the place of one corner in one view')
    match_floor_px: float = parameter(
        0.04, 0.0, 5.0, 'px', '1-sigma of the disparity that all corners of a pair share: '
        'interpolation errs alike for all of them')
    tail_dof: float = parameter(
        3.0, 1.0, 1e6, '', 'degrees of freedom of the t distribution of the residuals: the '
        'fewer, the less count corners that do not move along')
    interval_s: float = parameter(
        0.06, 0.0, 1.0, 's', 'time from one of these pairs to the next, at least: corners are '
        'followed from pair to pair, and each step adds its error')


@dataclass(frozen=True)
class ClassConfig(CheckedRecord):
    """The sizes of the classes of vehicles, and when a vehicle is of one."""

    least_probability: float = parameter(
        0.9, 0.5, 1.0, '', 'a vehicle whose most probable class is less probable is unknown')
    width_std_m: float = parameter(
        0.08, 0.001, 1.0, 'm', '1-sigma of the width of a front that was detected')
    height_std_m: float = parameter(
        0.12, 0.001, 1.0, 'm', '1-sigma of the height that is seen to move along')
    odd_width_share: float = parameter(
        0.02, 0.0, 0.5, '', 'share of vehicles whose measured width tells nothing')
    odd_width_m: float = parameter(
        3.0, 0.5, 10.0, 'm', 'such a width is anything up to this')
    odd_height_share: float = parameter(
        0.02, 0.0, 0.5, '', 'share of vehicles whose measured height tells nothing, as where what '
        'stands or drives behind them is taken for part of them')
    odd_height_m: float = parameter(
        4.5, 0.5, 10.0, 'm', 'such a height is anything up to this')
    hidden_top_share: float = parameter(
        0.1, 0.0, 0.9, '', 'share of vehicles whose top is not seen, as in the dark: the height '
        'that is measured is anything below their own')
    least_ncc: float = parameter(
        0.6, 0.0, 1.0, '', 'what moves along correlates at least so well between the views and '
        'between the pairs')
    still_margin: float = parameter(
        0.15, 0.0, 1.0, '', 'and by so much better than if it stood still')
    edge_width_m: float = parameter(
        1.2, 0.1, 4.0, 'm', 'what was found by itself, is narrower than this')
    edge_height_m: float = parameter(
        2.2, 0.5, 10.0, 'm', 'and higher than this is no two-wheeler with a rider, but an edge of '
        'another vehicle')
    motorcycle_width_m: float = parameter(
        0.65, 0.1, 4.0, 'm', 'mean width of the fronts of motorcycles')
    motorcycle_width_std_m: float = parameter(0.2, 0.01, 1.0, 'm', 'its 1-sigma among them')
    motorcycle_height_m: float = parameter(
        1.45, 0.1, 5.0, 'm', 'mean height of motorcycles with their riders')
    motorcycle_height_std_m: float = parameter(0.2, 0.01, 1.0, 'm', 'its 1-sigma among them')
    car_width_m: float = parameter(1.82, 0.1, 4.0, 'm', 'mean width of cars, without mirrors')
    car_width_std_m: float = parameter(0.1, 0.01, 1.0, 'm', 'its 1-sigma among them')
    car_height_m: float = parameter(1.57, 0.1, 5.0, 'm', 'mean height of cars')
    car_height_std_m: float = parameter(0.15, 0.01, 1.0, 'm', 'its 1-sigma among them')
    van_width_m: float = parameter(2.0, 0.1, 4.0, 'm', 'mean width of vans')
    van_width_std_m: float = parameter(0.07, 0.01, 1.0, 'm', 'its 1-sigma among them')
    van_height_m: float = parameter(2.35, 0.1, 5.0, 'm', 'mean height of vans')
    van_height_std_m: float = parameter(0.25, 0.01, 1.0, 'm', 'its 1-sigma among them')
    heavy_width_m: float = parameter(
        2.5, 0.1, 4.0, 'm', 'mean width of lorries and buses; in Europe 2.55 m are allowed')
    heavy_width_std_m: float = parameter(0.06, 0.01, 1.0, 'm', 'its 1-sigma among them')
    heavy_height_m: float = parameter(
        3.2, 0.1, 5.0, 'm', 'mean height of their fronts: the load may be higher')
    heavy_height_std_m: float = parameter(0.35, 0.01, 1.0, 'm', 'its 1-sigma among them')


@dataclass(frozen=True)
class TrackerConfig(CheckedRecord):
    """
    Parameters of all trackers; the paper's values (2012, Section V) by default.

    Deviations of random walks are rates, per square root of a second, so that the frame rate
    does not change the filter; the paper's per-frame values at 5 frames/s are given in each doc.
    """

    particles: int = parameter(400, 20, 20000, '', 'number of particles N')
    speed_rate_std: float = parameter(
        0.335, 0.0, 20.0, 'm/s/sqrt(s)',
        'random walk of the speed; 0.335 is the 0.15 m/s a frame of the paper at 5 frames/s')
    cruise_rate_std: float = parameter(
        0.05, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the speed of a vehicle that cruises')
    cruise_share: float = parameter(
        0.7, 0.0, 1.0, '', 'share of passes that cruise; 0 leaves the model out')
    acceleration_std_mps2: float = parameter(
        1.5, 0.0, 20.0, 'm/s^2', '1-sigma of the first acceleration of a vehicle that changes '
        'its speed')
    jerk_rate_std: float = parameter(
        3.0, 0.0, 50.0, 'm/s^2/sqrt(s)', 'random walk of the acceleration of such a vehicle')
    onset_per_s: float = parameter(
        0.3, 0.0, 10.0, '1/s', 'how often a vehicle that keeps its speed begins to brake or to '
        'accelerate; 0 leaves this out')
    onset_lasts_s: float = parameter(
        2.0, 0.1, 100.0, 's', 'time for which it does so, on average, before it keeps its speed '
        'again')
    onset_std_mps2: float = parameter(
        4.0, 0.0, 20.0, 'm/s^2', '1-sigma of its acceleration meanwhile')
    manoeuvre_across_std_m: float = parameter(
        1.0, 0.0, 5.0, 'm/sqrt(s)', 'drift across the path, over long times, of a vehicle that '
        'changes lanes')
    manoeuvre_across_s: float = parameter(
        0.5, 0.01, 100.0, 's', 'time for which its speed across the path persists')
    manoeuvre_probability: float = parameter(
        0.05, 0.0, 0.49, '', 'share of passes that brake or accelerate, and share of those that '
        'change lanes; 0 leaves these models out')
    drift_across_std_m: float = parameter(
        0.2236, 0.0, 5.0, 'm/sqrt(s)',
        'drift across the path, sigma_P of eq. 27; 0.10 m a frame at 5 frames/s')
    drift_up_std_m: float = parameter(
        0.0671, 0.0, 2.0, 'm/sqrt(s)',
        'drift above the path, sigma_B of eq. 27; 0.03 m a frame at 5 frames/s')
    crossfall_std: float = parameter(
        0.02, 0.0, 0.2, 'm/m', '1-sigma of the crossfall beside the path, which carries a '
        'vehicle up or down as it changes lanes')
    smooth_ride_std_m: float = parameter(
        0.003, 0.0005, 0.5, 'm', 'bouncing of the front on a smooth ride, and its climbing above '
        'the path in a second')
    rough_ride_std_m: float = parameter(
        0.03, 0.0005, 0.5, 'm', 'the same on a rough ride')
    smooth_share: float = parameter(
        0.5, 0.0, 1.0, '', 'share of passes that ride smoothly')
    parts: int = parameter(
        10, doc='parts N_p of the front', choices=(4, 6, 8, 10, 12, 16))
    samples_per_part: int = parameter(
        8, doc='samples across and down each part in the refinement', choices=(4, 8, 12, 16))
    lambda_d: float = parameter(15.0, 0.0, 1e4, '', 'single-view weight lambda_D of eq. 13')
    lambda_c: float = parameter(20.0, 0.0, 1e4, '', 'cross-view weight lambda_c of eq. 18')
    reference_epsilon: float = parameter(
        0.3, 0.0, 1.0, '', 'share of the old reference kept in each update, epsilon of eq. 14')
    resample_ess: float = parameter(
        0.5, 0.0, 1.0, '', 'resample when the effective sample size falls below this share of N')
    initial_speed_mps: float = parameter(
        20.0, 0.5, 100.0, 'm/s', 'expected speed on a lane without a speed limit')
    initial_speed_std: float = parameter(
        0.5, 0.01, 5.0, '', '1-sigma of the first speeds, as a share of the expected one')

    stamp_std_s: float = parameter(
        2e-4, 0.0, 0.1, 's', '1-sigma of each header stamp against the true exposure')
    uneven_stamp_sigmas: float = parameter(
        2.0, 1.0, 1e6, '', 'stamps that are off an even pace by more than so many stamp_std_s are '
        'taken to be wrong by that; a great number where uneven stamps are those of the exposures')
    exposure_odds: float = parameter(
        20.0, 0.0, 1e6, '', 'uneven stamps of a pass are those of the exposures after all where '
        'the images say so by greater odds; 0 takes all for that')
    trigger_tolerance_s: float = parameter(
        5e-4, 0.0, 1.0, 's', 'pairs whose stamps differ by less were exposed at once; beyond it '
        'each view counts at its own time')
    focal_std: float = parameter(
        5e-4, 0.0, 0.1, '', '1-sigma of the focal lengths, as a share')
    baseline_std_m: float = parameter(
        2e-4, 0.0, 0.1, 'm', '1-sigma of the baseline')
    max_speed_std_share: float = parameter(
        0.01, 0.0, 1.0, '', 'a pass whose 1-sigma is a greater share of its speed is rejected')
    max_speed_std_mps: float = parameter(
        0.15, 0.0, 10.0, 'm/s', 'unless its 1-sigma is smaller than this')
    max_scale_std_share: float = parameter(
        0.0025, 0.0, 1.0, '', 'a pass is rejected when focal length, baseline, path and '
        'extrinsic drift leave its scale uncertain by a greater share')
    particle_budget: int = parameter(
        800, 100, 100000, '', 'particles of all tracks together; while there are several, they '
        'share them')

    noise: NoiseConfig = section(NoiseConfig, 'precision of the images')
    visibility: VisibilityConfig = section(VisibilityConfig, 'seen, occluded, confirmed, lost')
    start: StartConfig = section(StartConfig, 'first pair of a track')
    verdict: VerdictConfig = section(VerdictConfig, 'passes that are rejected')
    effort: EffortConfig = section(EffortConfig, 'work spent on a pass')
    association: AssociationConfig = section(AssociationConfig, 'from detections to tracks')
    second: SecondConfig = section(SecondConfig, 'second, independent estimate of each pass')
    classes: ClassConfig = section(ClassConfig, 'classes of vehicles, by their sizes')


def check_bounds(config: ConfigRecord) -> None:
    """
    Check each parameter of a config record against its bounds or choices, and against others.

    :raises InputError: names the field, what was found and what was wanted.
    """
    for f in dataclasses.fields(config):
        value = getattr(config, f.name)
        if 'section' in f.metadata:
            if not isinstance(value, f.metadata['section']):
                raise InputError('configuration', f.name, repr(value), 'a mapping of parameters')
        elif not _is_legal(f, value):
            raise InputError('configuration', f.name, repr(value), wanted_of(f))
    for f in dataclasses.fields(config):
        for key, words, holds in (('below', 'less than', operator.lt),
                                  ('at_least', 'at least', operator.ge)):
            other = f.metadata.get(key)
            if other and not holds(getattr(config, f.name), getattr(config, other)):
                raise InputError('configuration', f.name, getattr(config, f.name),
                                 f'{words} {other}, {getattr(config, other)}')


def wanted_of(field: dataclasses.Field[Any]) -> str:
    """Return in words what a parameter may be."""
    meta, kind = field.metadata, type(field.default).__name__
    if meta['choices']:
        return 'one of ' + ', '.join(str(choice) for choice in meta['choices'])
    if isinstance(field.default, (bool, str)):
        return kind
    return f'{kind} in [{meta["low"]}, {meta["high"]}] {meta["unit"]}'.strip()


def _is_legal(field: dataclasses.Field[Any], value: object) -> bool:
    """Return whether a value is of the type of a parameter, and within its bounds."""
    meta, kind = field.metadata, type(field.default)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        # A whole number may be too large to be a float, and is out of any bounds then.
        value = float(value) if is_finite(value) else math.inf
    if type(value) is not kind:
        return False
    if meta['choices']:
        return value in meta['choices']
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return is_finite(value) and bool(meta['low'] <= value <= meta['high'])
    return True


def parameters_of(kind: type[ConfigRecord], prefix: str = ''
                  ) -> Iterator[tuple[str, dataclasses.Field[Any]]]:
    """
    Yield the dotted name and the field of every parameter of a record and of its sections.

    :param kind: the record.
    :param prefix: put before each name.
    """
    for f in dataclasses.fields(kind):
        if 'section' in f.metadata:
            yield from parameters_of(f.metadata['section'], f'{prefix}{f.name}.')
        else:
            yield prefix + f.name, f


def read_yaml_mapping(path: Union[str, Path]) -> Mapping[str, object]:
    """
    Read a YAML mapping of parameters.

    :raises InputError: an unreadable file, or one without a mapping at its top.
    """
    data = read_yaml(path, InputError)
    if not isinstance(data, Mapping):
        raise InputError(path, 'top level', type(data).__name__, 'a mapping of parameters')
    return data


def record_of(kind: type[Record], data: object, where: object, prefix: str = '') -> Record:
    """
    Make a config record of a mapping, with defaults for what it leaves out.

    :param kind: the record.
    :param data: parameter to value, section to mapping; dots of flat names are nested already.
    :param where: file, for errors.
    :param prefix: dotted name of the section, for errors.
    :raises InputError: an unknown key, or a value out of bounds.
    """
    if not isinstance(data, Mapping):
        raise InputError(where, prefix.rstrip('.') or 'top level', type(data).__name__,
                         'a mapping of parameters')
    fields = {f.name: f for f in dataclasses.fields(kind)}
    values = {}
    for key, value in data.items():
        if key not in fields:
            raise InputError(where, 'key', f'{prefix}{key}',
                             'one of ' + ', '.join(prefix + name for name in fields))
        inner = fields[key].metadata.get('section')
        values[key] = value if inner is None else record_of(inner, value, where, f'{prefix}{key}.')
    try:
        record = kind(**values)
        check_bounds(record)  # records of other packages need not do so themselves
    except InputError as error:
        raise InputError(where, prefix + error.what, error.found, error.wanted) from None
    return record


def load_config(path: Optional[Union[str, Path]], kind: type[Record]) -> Record:
    """
    Read a YAML mapping of parameters; the others keep their defaults.

    :param path: of the file; None gives the defaults.
    :param kind: the config record whose parameters they are.
    :raises InputError: unreadable file, unknown key or value out of bounds.
    """
    return kind() if path is None else record_of(kind, read_yaml_mapping(path), path)


TOLERANCES = ('focal_std', 'baseline_std_m', 'stamp_std_s')  # those that a site file may give


def check_tolerance(name: str, value: object, where: object) -> float:
    """
    Check a tolerance of a site file against the bounds of its parameter.

    :raises InputError: names the file and the field.
    """
    config = record_of(TrackerConfig, {name: value}, where, 'tolerances.')
    return float(getattr(config, name))
