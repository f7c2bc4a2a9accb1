# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Position of a simulated vehicle along and beside its lane's path over time."""
from __future__ import annotations

import numpy as np

from .config import VehicleConfig
from ...core.records import Array

_LONG_S = 1e4  # longer than any pass


def _speed_knots(vehicle: VehicleConfig) -> tuple[Array, Array]:
    """Return times, s, and speeds, m/s, of the piecewise linear profile."""
    knots = vehicle.speed_knots
    if not knots:
        v, a = vehicle.speed_mps, vehicle.accel_mps2
        end_s = v / -a if a < 0 else _LONG_S
        knots = ((0.0, v), (end_s, v + a * end_s))
    t, v = np.asarray(knots, dtype=float).T
    return t, v


def path_speed_mps(vehicle: VehicleConfig, t_s: float) -> float:
    """Return the speed along the lane's path, m/s."""
    return float(np.interp(t_s, *_speed_knots(vehicle)))


def path_m(vehicle: VehicleConfig, t_s: float) -> float:
    """Return the arc length along the lane's path, m; exact integral of the speed from 0 s."""
    t, v = _speed_knots(vehicle)
    nodes = np.unique(np.concatenate([[0.0, t_s], t[(t > min(0.0, t_s)) & (t < max(0.0, t_s))]]))
    speeds = np.interp(nodes, t, v)
    length = float(np.sum((speeds[1:] + speeds[:-1]) / 2 * np.diff(nodes)))
    return vehicle.head_start_m + (length if t_s >= 0 else -length)


def smooth_step(share: float) -> tuple[float, float]:
    """
    Return a step from 0 to 1 without acceleration at both ends, as a driver steers.

    :param share: share of the duration; outside 0 to 1 the step is constant.
    :return: the step and its derivative by the share.
    """
    s = float(np.clip(share, 0.0, 1.0))
    return s ** 3 * (10 - 15 * s + 6 * s ** 2), 30 * (s * (1 - s)) ** 2


def lateral_m(vehicle: VehicleConfig, t_s: float) -> float:
    """Return the offset from the lane's path, m, positive to the left of travel."""
    return _lateral(vehicle, t_s)[0]


def lateral_mps(vehicle: VehicleConfig, t_s: float) -> float:
    """Return the rate of the offset from the lane's path, m/s."""
    return _lateral(vehicle, t_s)[1]


def _lateral(vehicle: VehicleConfig, t_s: float) -> tuple[float, float]:
    """Return the offset and its rate, with smooth steps between the knots."""
    knots = vehicle.lateral_knots
    for (from_s, before_m), (to_s, after_m) in zip(knots, knots[1:]):
        if t_s < to_s:
            share, rate = smooth_step((t_s - from_s) / (to_s - from_s))
            step_m = after_m - before_m
            return before_m + step_m * share, step_m * rate / (to_s - from_s)
    return (knots[-1][1] if knots else 0.0), 0.0
