# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters that all trackers share, in sections."""
from __future__ import annotations

from dataclasses import dataclass, replace

from .config import CheckedRecord, parameter, record_of, section
from .fronts import NARROW_M, TALL_HIGH_M, TALL_WIDTH_M

TOLERANCES = ('focal_std', 'baseline_std_m', 'stamp_std_s')  # that a site file may override


@dataclass(frozen=True)
class NoiseConfig(CheckedRecord):
    """How precisely the images locate a front; these parameters set every 1-sigma of matching."""

    independent_share: float = parameter(
        0.35, 0.01, 1.0, '', 'share of the samples of a low-pass filtered patch that are '
        'statistically independent')
    match_floor_px: float = parameter(
        0.0125, 0.0, 1.0, 'px', 'systematic error of the left-right match of one observation, '
        'which averaging over samples does not reduce')
    scatter_px: float = parameter(
        0.025, 0.0001, 10.0, 'px', 'median of the systematic scatter of disparities, which '
        'differs from pass to pass: 0.01 for painted fronts, 0.02 to 0.2 outdoors')
    scatter_factor: float = parameter(
        2.0, 1.01, 1000.0, '', 'factor by which the scatter of a pass differs from the median, as '
        'the 1-sigma of its logarithm')
    scatter_levels: int = parameter(
        5, 1, 10, '', 'number of scatters of disparities that are weighed by their evidence in '
        'each pass, each twice the previous one; 1 keeps match_floor_px alone')
    texture_floor_px: float = parameter(
        0.025, 0.0, 1.0, 'px', 'systematic error of matching one observation to the texture of '
        'the front, caused by relief and light')
    tail_dof: float = parameter(
        2.0, 1.0, 1e6, '', 'degrees of freedom of the t distribution of the residuals: fewer give '
        'clipped lamps, sliding highlights and dirt less weight; a million treats the residuals '
        'as Gaussian')
    gamma: float = parameter(
        2.2, 1.0, 4.0, '', 'grey levels are this root of the light: 2.2 for sRGB and most '
        'cameras, 1 for cameras that write the light itself')
    clipped_share: float = parameter(
        0.98, 0.5, 1.0, '', 'share of full scale from which a grey value counts as clipped: the '
        'outline of a clipped area keeps its size in pixels while the front grows')
    clipped_reach_px: float = parameter(
        3.0, 0.0, 20.0, 'px', 'distance by which light spreads in the lens around a clipped area')
    clipped_floor_px: float = parameter(
        0.05, 0.0, 1.0, 'px', 'texture_floor_px of a front with clipped pixels, if that is less: '
        'how much light is lost around lamps, and how it spreads, is not known')
    glare_level: float = parameter(
        0.45, 0.0, 10.0, '', 'share of full scale that three quarters of the places right beyond '
        'clipped_reach_px exceed where light spreads farther in the lens: glare; 10 for none')
    glare_floor_px: float = parameter(
        1.0, 0.0, 100.0, 'px', 'texture_floor_px of what lies in glare, which keeps its size in '
        'pixels while the front grows')
    relief_std_m: float = parameter(
        0.04, 0.0001, 0.5, 'm', 'scale of the relief of a front: bumper, grille and lamps lie '
        'centimetres apart in depth')
    relief_dof: float = parameter(
        2.0, 1.0, 1e6, '', 'degrees of freedom of the t distribution of the relief: fewer let '
        'parts lie farther behind the rest, such as a rider behind the fork; values from 1 to 4 '
        'give the same speeds, a million makes the distribution Gaussian')
    narrow_m: float = parameter(
        NARROW_M + 0.05, 0.0, 10.0, 'm', 'a front up to this width is that of a two-wheeler, '
        'which is not plane: the rider sits most of a metre behind the fork; a little more than '
        'the greatest width that detectors give it')
    narrow_relief_std_m: float = parameter(
        0.3, 0.0001, 0.5, 'm', 'relief_std_m of a front of a two-wheeler')
    narrow_texture_floor_px: float = parameter(
        0.1, 0.0, 1.0, 'px', 'texture_floor_px of a front of a two-wheeler, whose parts hide each '
        'other differently as it turns and comes nearer')
    gauge_std_m: float = parameter(
        0.005, 0.0001, 0.5, 'm', '1-sigma of the position of the front across and above the path '
        'in its first observation, which defines its centre')
    sharpness_sigmas: float = parameter(
        3.0, 0.0, 1000.0, '', 'significance, in sigmas, from which a difference of blur between '
        'the views is equalised by blurring the sharper view; 1000 never equalises')
    most_blur_px: float = parameter(
        2.5, 0.5, 10.0, 'px', 'largest difference of blur between the views, as the 1-sigma of a '
        'Gaussian')
    blur_doubt: float = parameter(
        0.3, 0.0, 3.0, '', 'share of the change of speed with blur that adds to the 1-sigma of a '
        'pass, fitted to the errors of passes out of focus; 0 adds nothing')
    band_share: float = parameter(
        0.5, 0.0, 1.0, '', 'share of the variance by which the bands of a front disagree on its '
        'speed, beyond what the fit explains, that adds to the 1-sigma of a pass; 0 adds nothing')
    start_std_px: float = parameter(
        0.15, 0.01, 5.0, 'px', '1-sigma of the depth of the first particles, as disparity')

    def of_front(self, width_m: float) -> NoiseConfig:
        """Return the precision for a front of a width: another one if it is a two-wheeler's."""
        return self if width_m > self.narrow_m else replace(
            self, relief_std_m=self.narrow_relief_std_m,
            texture_floor_px=self.narrow_texture_floor_px)


@dataclass(frozen=True)
class VisibilityConfig(CheckedRecord):
    """When a vehicle counts as seen, occluded, confirmed or lost."""

    least_ncc: float = parameter(
        0.5, 0.0, 1.0, '', 'an observation does not show the vehicle if its correlation with the '
        'other view or with the texture is below this')
    occlusion_deficit: float = parameter(
        0.03, 0.0, 1.0, '', 'an observation is occluded when its correlation falls short of 1 by '
        'more than this beyond what noise explains')
    occlusion_noise_factor: float = parameter(
        3.0, 0.0, 100.0, '', 'noise explains a shortfall of this many times that of the best '
        'observations')
    occlusion_best_share: float = parameter(
        0.1, 0.0, 1.0, '', 'share of the observations of a pass that count as its best')
    confirm_pairs: int = parameter(
        3, 1, 100, '', 'pairs in which a vehicle must be fully seen before its readings are '
        'confirmed and published')
    reading_std_mps: float = parameter(
        0.5, 0.0, 100.0, 'm/s', 'a reading is confirmed and published only if its 1-sigma is '
        'below this, or below reading_std_share of its speed')
    reading_std_share: float = parameter(
        0.02, 0.0, 10.0, '', 'see reading_std_mps')
    unnoticed_braking_mps2: float = parameter(
        6.0, 0.0, 20.0, 'm/s^2', 'the 1-sigma of a reading covers a driver who has begun to brake '
        'or accelerate as hard as this when the images cannot show it yet')
    unnoticed_sigmas: float = parameter(
        3.0, 0.1, 100.0, '', 'largest error of a reading by such unnoticed braking alone, in '
        '1-sigmas of the reading')
    unnoticed_std_mps: float = parameter(
        0.75, 0.0, 100.0, 'm/s', 'a reading whose 1-sigma, with unnoticed braking included, is '
        'above this is held back, unless it satisfies reading_std_mps or reading_std_share')
    lost_after_s: float = parameter(
        1.5, 0.0, 60.0, 's', 'a vehicle not seen at all for longer than this is lost; poles and '
        'missing images hide it for less')
    occluded_for_s: float = parameter(
        4.0, 0.0, 60.0, 's', 'a vehicle not fully seen for longer than this is lost, even if a '
        'part of it is visible, as behind one that overtakes')
    least_width_px: float = parameter(
        12.0, 1.0, 500.0, 'px', 'a receding vehicle whose front or rear is both narrower and '
        'lower than this has left the view')
    beyond_path_m: float = parameter(
        20.0, 0.0, 500.0, 'm', 'a vehicle farther than this beyond the end of its path has left '
        'the view')
    speed_change_sigmas: float = parameter(
        3.0, 0.0, 100.0, '', 'a reading is held back when its change since the last one exceeds '
        'what most_acceleration_mps2 allows by this many sigmas')


@dataclass(frozen=True)
class StartConfig(CheckedRecord):
    """When the quads in the first pair of a track show one front, and how a track starts."""

    most_gap_px: float = parameter(
        5.0, 0.1, 100.0, 'px', 'quads whose centres miss a common epipolar line by more than this '
        'show different objects')
    search_sigmas: float = parameter(
        4.0, 0.5, 20.0, '', 'half range of the search in depth around the depth that the quads '
        'give, in sigmas of that depth')
    least_ncc: float = parameter(
        0.5, 0.0, 1.0, '', 'left and right quads that correlate less do not show one front')
    any_speed_share: float = parameter(
        0.25, 0.0, 1.0, '', 'share of the first particles whose speeds are drawn from a uniform '
        'distribution, for vehicles far from the expected speed')
    any_speed_factor: float = parameter(
        2.5, 0.1, 20.0, '', 'largest speed of these particles, as a multiple of the expected '
        'speed')
    tall_width_m: float = parameter(
        TALL_WIDTH_M, 0.5, 10.0, 'm', 'an annotated front of at least this width is that of a '
        'lorry or bus, whose windscreen lies behind its bumper and mirrors its surroundings')
    tall_high_m: float = parameter(
        TALL_HIGH_M, 0.3, 5.0, 'm', 'height above the road up to which such a front is measured, '
        'if its lower edge is at least 0.3 m below that')


@dataclass(frozen=True)
class VerdictConfig(CheckedRecord):
    """Which passes are rejected, apart from those whose 1-sigma is too large."""

    least_pairs: int = parameter(
        4, 2, 1000, '', 'a pass fully seen in fewer pairs is rejected as too_few_pairs')
    least_width_px: float = parameter(
        20.0, 1.0, 1000.0, 'px', 'a pass whose front is never as wide or as high as this is '
        'rejected as too_far')
    far_width_px: float = parameter(
        40.0, 1.0, 1000.0, 'px', 'an uncertain pass whose front is never as wide or as high as '
        'this is rejected as too_far, any other as uncertain')
    least_median_ncc: float = parameter(
        0.6, 0.0, 1.0, '', 'a pass whose median correlation between the views is below this is '
        'rejected as views_disagree')
    most_scatter_px: float = parameter(
        0.15, 0.0, 10.0, 'px', 'a pass whose disparities scatter by more than this is rejected as '
        'views_disagree: more than lamps, reflections and compression explain')
    most_height_change_m: float = parameter(
        0.6, 0.01, 10.0, 'm', 'a pass whose front climbs or sinks by more relative to the path is '
        'rejected as off_path')
    most_speed_mps: float = parameter(
        90.0, 1.0, 300.0, 'm/s', 'a faster pass is rejected as implausible')
    most_acceleration_mps2: float = parameter(
        12.0, 0.1, 100.0, 'm/s^2', 'a pass with a greater acceleration is rejected as '
        'implausible, a live reading that implies one is held back; tyres cannot provide this')
    off_road_m: float = parameter(
        3.0, 0.1, 50.0, 'm', 'a vehicle farther than this from the middle of every lane is off '
        'the road')
    off_road_share: float = parameter(
        0.5, 0.0, 1.0, '', 'a pass off the road in more than this share of its pairs is rejected '
        'as off_path')
    lane_hysteresis_m: float = parameter(
        0.3, 0.0, 5.0, 'm', 'a vehicle has changed lanes when the path of another lane is nearer '
        'by more than this')


@dataclass(frozen=True)
class EffortConfig(CheckedRecord):
    """How much computation is spent on a pass; more takes longer and gains little."""

    live_observations: int = parameter(
        24, 4, 1000, '', 'observations in the solution of a live reading; older ones become '
        'inactive keyframes')
    pass_observations: int = parameter(
        60, 4, 1000, '', 'evenly spaced observations that a finished pass is measured from; at '
        'least live_observations', at_least='live_observations')
    fewest_particles: int = parameter(
        100, 20, 20000, '', 'particles that a track keeps even if many tracks share the budget; '
        'never more than particles')
    solve_interval_s: float = parameter(
        0.06, 0.0, 1.0, 's', 'least time between two solutions of a track, as closer readings '
        'rest on nearly the same pairs; the pairs in between are kept and enter the next '
        'solution; 0 solves in every pair. A track that has only a share of the particles, by '
        'particle_budget, waits longer in proportion')


@dataclass(frozen=True)
class AssociationConfig(CheckedRecord):
    """How detections become tracks, one for each vehicle."""

    catch_up_pairs: int = parameter(
        3, 1, 50, '', 'largest number of earlier pairs that a new track is fed')
    same_speed_sigmas: float = parameter(
        3.0, 0.1, 100.0, '', 'a new track whose speed differs from that of its detection by more '
        'sigmas is doubtful: a partly occluded front misleads one of the two')
    moving_sigmas: float = parameter(
        3.0, 0.0, 100.0, '', 'a new track whose speed exceeds zero by fewer sigmas stays '
        'tentative: road that a vehicle uncovers can look like a moving object to a detector')
    doubt_s: float = parameter(
        1.0, 0.0, 60.0, 's', 'time for which a doubtful track stays tentative')
    braking_mps2: float = parameter(
        6.0, 0.0, 20.0, 'm/s^2', 'hardest braking that may explain the difference of speeds '
        'after doubt_s; a larger difference keeps the track tentative')
    gone_s: float = parameter(
        1.0, 0.0, 60.0, 's', 'time for which a vehicle that has left the view is not detected '
        'again')
    same_vehicle_m: float = parameter(
        1.5, 0.1, 20.0, 'm', 'fronts closer to each other than this belong to one vehicle')


@dataclass(frozen=True)
class SecondConfig(CheckedRecord):
    """A second, independent estimate of each pass, with which the first one has to agree."""

    enabled: bool = parameter(
        True, doc='estimate each pass a second time, from corners triangulated in its pairs, and '
        'reject it as second_estimate if the two disagree')
    most_sigmas: float = parameter(
        4.0, 0.0, 100.0, '', 'the estimates disagree when they differ by more than this many of '
        'their combined 1-sigmas, or by more than most_difference_mps')
    most_difference_mps: float = parameter(
        0.5555555555555556, 0.0, 100.0, 'm/s', 'largest difference of estimates that agree; the '
        'default is 2 km/h')
    least_sigmas: float = parameter(
        3.0, 0.0, 100.0, '', 'a difference above most_difference_mps that is smaller than this '
        'many combined 1-sigmas is no evidence against the first estimate: the second one is '
        'then discarded')
    most_std_share: float = parameter(
        0.009, 0.0, 1.0, '', 'a second estimate whose 1-sigma is a larger share of its speed is '
        'discarded')
    least_pairs: int = parameter(
        4, 3, 1000, '', 'smallest number of pairs in a second estimate')
    most_pairs: int = parameter(
        40, 4, 1000, '', 'largest number of pairs in a second estimate, evenly spaced; at least '
        'least_pairs', at_least='least_pairs')
    least_points: int = parameter(
        5, 3, 1000, '', 'smallest number of corners that a pair shares with other pairs')
    most_points: int = parameter(
        40, 3, 1000, '', 'largest number of corners in a pair; at least least_points',
        at_least='least_points')
    least_quality: float = parameter(
        0.001, 0.0001, 1.0, '', 'least strength of a corner, as a share of that of the strongest '
        'one, which may be a lamp')
    most_round_trip_px: float = parameter(
        0.5, 0.01, 10.0, 'px', 'a match of a corner is dropped if matching back misses the '
        'corner by more than this')
    match_std_px: float = parameter(
        0.1, 0.001, 5.0, 'px', 'least 1-sigma of the position of one corner in one view')
    match_floor_px: float = parameter(
        0.04, 0.0, 5.0, 'px', '1-sigma of the disparity error that all corners of a pair share, '
        'as interpolation biases all of them alike')
    tail_dof: float = parameter(
        3.0, 1.0, 1e6, '', 'degrees of freedom of the t distribution of the residuals: fewer give '
        'corners that do not move with the vehicle less weight')
    interval_s: float = parameter(
        0.06, 0.0, 1.0, 's', 'least time between two of these pairs: corners are followed from '
        'pair to pair, and each step adds its error')


@dataclass(frozen=True)
class ClassConfig(CheckedRecord):
    """The sizes of the vehicle classes, and when a vehicle is assigned to one."""

    least_probability: float = parameter(
        0.9, 0.5, 1.0, '', 'a vehicle whose most probable class has a lower probability is '
        'unknown')
    width_std_m: float = parameter(
        0.08, 0.001, 1.0, 'm', '1-sigma of the width of a detected front')
    height_std_m: float = parameter(
        0.12, 0.001, 1.0, 'm', '1-sigma of the measured height')
    odd_width_share: float = parameter(
        0.02, 0.0, 0.5, '', 'share of vehicles whose measured width is an outlier')
    odd_width_m: float = parameter(
        3.0, 0.5, 10.0, 'm', 'outliers of the width are uniform up to this')
    odd_height_share: float = parameter(
        0.02, 0.0, 0.5, '', 'share of vehicles whose measured height is an outlier, for example '
        'because it includes an object behind them')
    odd_height_m: float = parameter(
        4.5, 0.5, 10.0, 'm', 'outliers of the height are uniform up to this')
    hidden_top_share: float = parameter(
        0.1, 0.0, 0.9, '', 'share of vehicles whose top is not visible, as in the dark: their '
        'measured height is uniform below the true one')
    least_ncc: float = parameter(
        0.6, 0.0, 1.0, '', 'least correlation, between the views and between the pairs, of a '
        'strip that moves with the vehicle')
    still_margin: float = parameter(
        0.15, 0.0, 1.0, '', 'least margin of that correlation over the one of a strip that stands '
        'still')
    edge_width_m: float = parameter(
        1.35, 0.1, 4.0, 'm', 'a detected front that is narrower than this and higher than '
        'edge_height_m is an edge of another vehicle, not a two-wheeler with a rider')
    edge_height_m: float = parameter(
        2.2, 0.5, 10.0, 'm', 'see edge_width_m')
    least_height_m: float = parameter(
        0.5, 0.0, 2.0, 'm', 'a detected front of which nothing is seen to move above this, by two '
        '1-sigmas of the height, is no vehicle; headlamps are at least 0.5 m above the road (UN '
        'Regulation 48); 0 disables it')
    motorcycle_width_m: float = parameter(
        0.65, 0.1, 4.0, 'm', 'mean width of the fronts of motorcycles')
    motorcycle_width_std_m: float = parameter(0.15, 0.01, 1.0, 'm', 'its 1-sigma among them')
    motorcycle_height_m: float = parameter(
        1.45, 0.1, 5.0, 'm', 'mean height of motorcycles with their riders')
    motorcycle_height_std_m: float = parameter(0.2, 0.01, 1.0, 'm', 'its 1-sigma among them')
    car_width_m: float = parameter(1.8, 0.1, 4.0, 'm', 'mean width of cars, without mirrors')
    car_width_std_m: float = parameter(
        0.15, 0.01, 1.0, 'm', 'its 1-sigma among them; kei cars are 1.48 m wide')
    car_height_m: float = parameter(1.57, 0.1, 5.0, 'm', 'mean height of cars')
    car_height_std_m: float = parameter(0.15, 0.01, 1.0, 'm', 'its 1-sigma among them')
    van_width_m: float = parameter(2.0, 0.1, 4.0, 'm', 'mean width of vans')
    van_width_std_m: float = parameter(0.07, 0.01, 1.0, 'm', 'its 1-sigma among them')
    van_height_m: float = parameter(2.35, 0.1, 5.0, 'm', 'mean height of vans')
    van_height_std_m: float = parameter(0.25, 0.01, 1.0, 'm', 'its 1-sigma among them')
    heavy_width_m: float = parameter(
        2.5, 0.1, 4.0, 'm', 'mean width of lorries and buses; Europe allows 2.55 m')
    heavy_width_std_m: float = parameter(0.06, 0.01, 1.0, 'm', 'its 1-sigma among them')
    heavy_height_m: float = parameter(
        3.2, 0.1, 5.0, 'm', 'mean height of their fronts; the load may be higher')
    heavy_height_std_m: float = parameter(0.35, 0.01, 1.0, 'm', 'its 1-sigma among them')


@dataclass(frozen=True)
class TrackerConfig(CheckedRecord):
    """
    Parameters of all trackers; the paper's values (2012, Section V) by default.

    The deviations of random walks are rates per square root of a second, so that the frame rate
    does not change the filter; each text gives the paper's value per frame at 5 frames/s.
    """

    particles: int = parameter(400, 20, 20000, '', 'number of particles N')
    speed_rate_std: float = parameter(
        0.335, 0.0, 20.0, 'm/s/sqrt(s)',
        'random walk of the speed; 0.335 is the 0.15 m/s per frame of the paper at 5 frames/s')
    cruise_rate_std: float = parameter(
        0.05, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the speed of a cruising vehicle')
    cruise_share: float = parameter(
        0.7, 0.0, 1.0, '', 'share of passes that cruise; 0 leaves the model out')
    acceleration_std_mps2: float = parameter(
        1.5, 0.0, 20.0, 'm/s^2', '1-sigma of the initial acceleration of a vehicle that changes '
        'its speed')
    jerk_rate_std: float = parameter(
        3.0, 0.0, 50.0, 'm/s^2/sqrt(s)', 'random walk of the acceleration of such a vehicle')
    onset_per_s: float = parameter(
        0.3, 0.0, 10.0, '1/s', 'rate at which a vehicle that keeps its speed begins to brake or '
        'accelerate, also before it is seen; 0 leaves such onsets out')
    onset_lasts_s: float = parameter(
        2.0, 0.1, 100.0, 's', 'mean duration of such a change before the vehicle keeps its speed '
        'again')
    onset_std_mps2: float = parameter(
        4.0, 0.0, 20.0, 'm/s^2', '1-sigma of the acceleration during such a change')
    manoeuvre_across_std_m: float = parameter(
        1.0, 0.0, 5.0, 'm/sqrt(s)', 'long-term drift across the path of a vehicle that changes '
        'lanes')
    manoeuvre_across_s: float = parameter(
        0.5, 0.01, 100.0, 's', 'time constant of the speed across the path of such a vehicle')
    manoeuvre_probability: float = parameter(
        0.05, 0.0, 0.49, '', 'share of passes that brake or accelerate, and also the share of '
        'passes that change lanes; 0 leaves these models out')
    drift_across_std_m: float = parameter(
        0.2236, 0.0, 5.0, 'm/sqrt(s)',
        'drift across the path, sigma_P of eq. 27; 0.10 m per frame at 5 frames/s')
    drift_up_std_m: float = parameter(
        0.0671, 0.0, 2.0, 'm/sqrt(s)',
        'drift above the path, sigma_B of eq. 27; 0.03 m per frame at 5 frames/s')
    crossfall_std: float = parameter(
        0.02, 0.0, 0.2, 'm/m', '1-sigma of the crossfall beside the path, which raises or lowers '
        'a vehicle that changes lanes')
    smooth_ride_std_m: float = parameter(
        0.003, 0.0005, 0.5, 'm', '1-sigma of the height of the front on a smooth ride, in each '
        'pair by itself, and of its rise above the path within a second on any ride')
    rough_ride_std_m: float = parameter(
        0.03, 0.0005, 0.5, 'm', '1-sigma of the height of the front on a rough ride; beyond '
        'smooth_ride_std_m it is a bounce on springs')
    ride_hz: float = parameter(
        1.3, 0.1, 20.0, 'Hz', 'natural frequency of vehicles that bounce on their springs')
    smooth_share: float = parameter(
        0.5, 0.0, 1.0, '', 'share of passes with a smooth ride')
    parts: int = parameter(
        10, doc='parts N_p of the front', choices=(4, 6, 8, 10, 12, 16))
    samples_per_part: int = parameter(
        8, doc='samples across and down each part in the refinement', choices=(4, 8, 12, 16))
    lambda_d: float = parameter(15.0, 0.0, 1e4, '', 'single-view weight lambda_D of eq. 13')
    lambda_c: float = parameter(20.0, 0.0, 1e4, '', 'cross-view weight lambda_c of eq. 18')
    reference_epsilon: float = parameter(
        0.3, 0.0, 1.0, '', 'share of the old reference kept in each update, epsilon of eq. 14')
    resample_ess: float = parameter(
        0.5, 0.0, 1.0, '', 'effective sample size, as a share of N, below which the particles are '
        'resampled')
    initial_speed_mps: float = parameter(
        20.0, 0.5, 100.0, 'm/s', 'expected speed on a lane without a speed limit')
    initial_speed_std: float = parameter(
        0.5, 0.01, 5.0, '', '1-sigma of the initial speeds, as a share of the expected speed')

    stamp_std_s: float = parameter(
        2e-4, 0.0, 0.1, 's', '1-sigma of each header stamp relative to the true exposure')
    uneven_stamp_sigmas: float = parameter(
        2.0, 1.0, 1e6, '', 'stamps that deviate from an even pace by more than this many '
        'stamp_std_s are taken to be wrong by the deviation; set it large if exposures are known '
        'to be uneven')
    exposure_odds: float = parameter(
        20.0, 0.0, 1e6, '', 'odds, by the images of a whole pass, above which its uneven stamps '
        'count as correct, with a 1-sigma of stamp_std_s; 0 for always')
    trigger_tolerance_s: float = parameter(
        5e-4, 0.0, 1.0, 's', 'views whose stamps differ by less were exposed simultaneously; '
        'otherwise each view counts at its own stamp')
    focal_std: float = parameter(
        5e-4, 0.0, 0.1, '', '1-sigma of the focal lengths, as a share of them')
    baseline_std_m: float = parameter(
        2e-4, 0.0, 0.1, 'm', '1-sigma of the baseline')
    max_speed_std_share: float = parameter(
        0.01, 0.0, 1.0, '', 'a pass whose 1-sigma is a larger share of its speed is rejected, '
        'unless it is below max_speed_std_mps')
    max_speed_std_mps: float = parameter(
        0.15, 0.0, 10.0, 'm/s', 'see max_speed_std_share')
    max_scale_std_share: float = parameter(
        0.0025, 0.0, 1.0, '', 'a pass is rejected if the 1-sigma of its scale, from focal length, '
        'baseline, path and extrinsic drift, is a larger share of the scale')
    particle_budget: int = parameter(
        800, 100, 100000, '', 'total number of particles that several tracks share')

    noise: NoiseConfig = section(NoiseConfig, 'precision of the images')
    visibility: VisibilityConfig = section(
        VisibilityConfig, 'when a vehicle is seen, occluded, confirmed or lost')
    start: StartConfig = section(StartConfig, 'first pair of a track')
    verdict: VerdictConfig = section(VerdictConfig, 'when a pass is rejected')
    effort: EffortConfig = section(EffortConfig, 'computation spent on a pass')
    association: AssociationConfig = section(AssociationConfig, 'from detections to tracks')
    second: SecondConfig = section(SecondConfig, 'second, independent estimate of each pass')
    classes: ClassConfig = section(ClassConfig, 'classes of vehicles, by their sizes')


def check_tolerance(name: str, value: object, where: object) -> float:
    """
    Return a tolerance of a site file after checking it against the bounds of its parameter.

    :raises InputError: an illegal value; names the file and the field.
    """
    config = record_of(TrackerConfig, {name: value}, where, 'tolerances.')
    return float(getattr(config, name))
