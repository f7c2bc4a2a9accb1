# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The parameters of each baseline; those that all trackers share are in ``TrackerConfig``.

The random walk of the speed, the number of particles, the weights of the likelihood and the limits
of the verdict are shared, so that all trackers are treated alike.
"""
from __future__ import annotations

from dataclasses import dataclass

from ...core.config import CheckedRecord, parameter


@dataclass(frozen=True)
class MotionSettings(CheckedRecord):
    """Process noise of the velocity in the filter and the smoother of all baselines."""

    along_rate_std: float = parameter(
        1.0, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the velocity along travel: braking')
    across_rate_std: float = parameter(
        3.0, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the velocity across travel: bends')
    climb_rate_std: float = parameter(
        0.3, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the vertical velocity')


@dataclass(frozen=True)
class PointSettings(MotionSettings):
    """Baselines that measure the position of the front from triangulated points."""

    match_std_px: float = parameter(
        0.5, 0.01, 10.0, 'px', 'matching error of a point in each view (2012, Section V-A)')
    common_std_px: float = parameter(
        0.05, 0.0, 10.0, 'px', 'matching error in each view common to all points of a '
        'pair, which does not average out')
    centre_std_px: float = parameter(
        0.3, 0.01, 10.0, 'px', 'error of the centre of the front as moved with its points')
    bounce_std_m: float = parameter(
        0.03, 0.0, 0.5, 'm', '1-sigma of the bouncing of the front on its springs')
    jolt_std_m: float = parameter(
        0.2, 0.0, 5.0, 'm', 'jolts of vehicle or cameras, not covered by the motion model, in the '
        'check of a position against the prediction')
    most_distance2: float = parameter(
        16.3, 0.0, 1e4, '', 'squared Mahalanobis distance from the prediction beyond which a '
        'position is an outlier; 16.3 is exceeded by one in a thousand Gaussian errors')
    outlier_sigmas: float = parameter(
        3.0, 0.5, 100.0, '', 'robust standard deviations from the plane of the front beyond '
        'which points are outliers')
    least_points: int = parameter(
        3, 3, 1000, '', 'least number of points that must agree on a position or a motion; '
        'with fewer, agreement may be by chance')
    most_epipolar_px: float = parameter(
        1.5, 0.01, 50.0, 'px', 'distance from the epipolar line beyond which a match is wrong')
    most_motion_error_px: float = parameter(
        1.5, 0.01, 50.0, 'px', 'deviation from the motion of the front beyond which a point is '
        'not on it')
    first_side_share: float = parameter(
        0.1, 0.001, 1.0, '', '1-sigma of the initial velocity across the lane, as a share of the '
        'expected speed')
    first_climb_share: float = parameter(
        0.02, 0.001, 1.0, '', 'vertical 1-sigma of the initial velocity, likewise')


@dataclass(frozen=True)
class SiftSettings(PointSettings):
    """Trackers of SIFT points: ``kalman`` and ``triangulation``."""

    least_contrast: float = parameter(
        0.015, 0.002, 0.5, '', 'contrast of a keypoint; on small fronts, the 0.04 of Lowe would '
        'leave only a few')
    most_ratio: float = parameter(
        0.85, 0.05, 1.0, '', 'distance of a match as a share of that of the second best: '
        'ratio test of Lowe')
    most_offset_px: float = parameter(
        4.0, 0.1, 200.0, 'px', 'greatest distance of a match from the prediction, beyond its '
        'uncertainty')


@dataclass(frozen=True)
class FlowSettings(PointSettings):
    """``flow``: points tracked by optical flow, which is more precise than SIFT."""

    match_std_px: float = parameter(
        0.1, 0.01, 10.0, 'px', 'matching error of a point in each view')
    most_epipolar_px: float = parameter(
        1.0, 0.01, 50.0, 'px', 'distance from the epipolar line beyond which a match is wrong')
    most_round_trip_px: float = parameter(
        0.3, 0.001, 10.0, 'px', 'forward-backward error beyond which a point is lost')
    most_points: int = parameter(
        60, 3, 1000, '', 'number of points tracked at once; more take longer and gain little')
    least_quality: float = parameter(
        0.02, 0.0001, 1.0, '', 'strength of a corner as a share of that of the strongest')


@dataclass(frozen=True)
class UnconstrainedSettings(MotionSettings):
    """``unconstrained``: particles with six degrees of freedom."""

    rotation_rate_std: float = parameter(
        0.2, 0.0, 10.0, 'rad/s/sqrt(s)', 'random walk of the yaw rate')
    tilt_share: float = parameter(
        0.1, 0.0, 1.0, '', 'random walk of pitch and roll rates, as a share of that of the yaw')
    first_side_share: float = parameter(
        0.05, 0.0, 1.0, '', '1-sigma of the initial velocity across the lane, as a share of the '
        'expected speed')
    first_climb_share: float = parameter(
        0.02, 0.0, 1.0, '', 'vertical 1-sigma of the initial velocity, likewise')


@dataclass(frozen=True)
class MultimodalSettings(MotionSettings):
    """``multimodal``: particles weighted by disparity, grey levels and gradients."""

    disparity_std_px: float = parameter(
        0.2, 0.01, 10.0, 'px', 'error of the median disparity of a front in a disparity map')
    least_disparity_share: float = parameter(
        0.1, 0.0, 1.0, '', 'least share of a front with disparities for this cue to be used; '
        '1 disables it')
    lambda_colour: float = parameter(
        20.0, 0.0, 1e4, '', 'weight of the squared Bhattacharyya distance of the histograms')
    lambda_gradient: float = parameter(
        2.0, 0.0, 1e4, '', 'weight of the missing gradient along the outline')
    least_similarity: float = parameter(
        0.7, 0.0, 1.0, '', 'Bhattacharyya coefficient with the reference below which the vehicle '
        'is not seen')
    reference_rate: float = parameter(
        0.1, 0.0, 1.0, '', 'weight of a new pair in the reference histograms, which do not '
        'depend on the scale')
