# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The few numbers that only the baselines have; what they share with ours is ``TrackerConfig``."""
from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from ..config import check_bounds, Number


def _p(default: Number, low: Number, high: Number, unit: str, doc: str) -> Any:
    """Make a dataclass field that carries its unit, bounds and meaning."""
    meta = {'low': low, 'high': high, 'unit': unit, 'doc': doc}
    return dataclasses.field(default=default, metadata=meta)


@dataclass(frozen=True)
class BaselineSettings:
    """
    Parameters of the baselines.

    The random walk of the speed, the number of particles, the weights of the likelihood and the
    limits of the verdict are those of :class:`TrackerConfig`, so that all trackers are given the
    same.
    """

    feature_std_px: float = _p(
        0.5, 0.01, 10.0, 'px', 'matching error of a feature in each view (2012, Section V-A)')
    flow_std_px: float = _p(
        0.1, 0.01, 10.0, 'px', 'matching error of a point followed by optical flow in each view')
    along_rate_std: float = _p(
        1.0, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the velocity along itself: braking')
    turn_rate_std: float = _p(
        3.0, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the velocity across itself, level: bends')
    climb_rate_std: float = _p(
        0.3, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the velocity across itself, up and down')
    bounce_std_m: float = _p(
        0.03, 0.0, 0.5, 'm', 'bouncing of the front on its springs')
    rotation_rate_std: float = _p(
        0.2, 0.0, 10.0, 'rad/s/sqrt(s)', 'random walk of the yaw rate of the free particle filter')
    tilt_share: float = _p(
        0.1, 0.0, 1.0, '', 'the same of its pitch and roll rates, as a share of that of the yaw')
    disparity_std_px: float = _p(
        0.2, 0.01, 10.0, 'px', 'error of the mean disparity of a front in a disparity map')
    lambda_colour: float = _p(
        20.0, 0.0, 1e4, '', 'weight of the squared Bhattacharyya distance of the histograms')
    lambda_gradient: float = _p(
        2.0, 0.0, 1e4, '', 'weight of the lacking gradient along the outline')

    def __post_init__(self) -> None:
        check_bounds(self)
