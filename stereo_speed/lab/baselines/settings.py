# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The few numbers that only the baselines have; what they share with ours is ``TrackerConfig``."""
from __future__ import annotations

from dataclasses import dataclass

from ...core.config import check_bounds, parameter


@dataclass(frozen=True)
class BaselineSettings:
    """
    Parameters of the baselines.

    The random walk of the speed, the number of particles, the weights of the likelihood and the
    limits of the verdict are those of :class:`TrackerConfig`, so that all trackers are given the
    same.
    """

    feature_std_px: float = parameter(
        0.5, 0.01, 10.0, 'px', 'matching error of a feature in each view (2012, Section V-A)')
    flow_std_px: float = parameter(
        0.1, 0.01, 10.0, 'px', 'matching error of a point followed by optical flow in each view')
    along_rate_std: float = parameter(
        1.0, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the velocity along itself: braking')
    turn_rate_std: float = parameter(
        3.0, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the velocity across itself, level: bends')
    climb_rate_std: float = parameter(
        0.3, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the velocity across itself, up and down')
    bounce_std_m: float = parameter(
        0.03, 0.0, 0.5, 'm', 'bouncing of the front on its springs')
    rotation_rate_std: float = parameter(
        0.2, 0.0, 10.0, 'rad/s/sqrt(s)', 'random walk of the yaw rate of the free particle filter')
    tilt_share: float = parameter(
        0.1, 0.0, 1.0, '', 'the same of its pitch and roll rates, as a share of that of the yaw')
    disparity_std_px: float = parameter(
        0.2, 0.01, 10.0, 'px', 'error of the mean disparity of a front in a disparity map')
    lambda_colour: float = parameter(
        20.0, 0.0, 1e4, '', 'weight of the squared Bhattacharyya distance of the histograms')
    lambda_gradient: float = parameter(
        2.0, 0.0, 1e4, '', 'weight of the lacking gradient along the outline')

    def __post_init__(self) -> None:
        check_bounds(self)
