# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""How far a simulated vehicle is along and beside its lane's path at a time."""
from __future__ import annotations

import numpy as np

from .config import VehicleConfig

_LONG_S = 1e4  # longer than any pass


def _speed_knots(vehicle: VehicleConfig) -> tuple[np.ndarray, np.ndarray]:
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
    Go from 0 to 1 as a driver steers: without acceleration at both ends.

    :param share: of the time; outside 0 to 1 it rests.
    :return: the step and its rate per share of the time.
    """
    s = float(np.clip(share, 0.0, 1.0))
    return s ** 3 * (10 - 15 * s + 6 * s ** 2), 30 * (s * (1 - s)) ** 2


def lateral_m(vehicle: VehicleConfig, t_s: float) -> float:
    """Return the offset from the lane's path, m, positive to the left of travel."""
    if not vehicle.lateral_knots:
        return 0.0
    t, n = np.asarray(vehicle.lateral_knots, dtype=float).T
    i = int(np.clip(np.searchsorted(t, t_s, side='right') - 1, 0, max(len(t) - 2, 0)))
    if len(t) == 1:
        return float(n[0])
    share = float(np.clip((t_s - t[i]) / (t[i + 1] - t[i]), 0.0, 1.0))
    # As smooth_step, but rounded as it always was: the same seed gives the same images.
    return float(n[i] + (n[i + 1] - n[i]) * share ** 3 * (10 - 15 * share + 6 * share ** 2))


def heading_rad(vehicle: VehicleConfig, t_s: float) -> float:
    """Return the heading against the path, positive to the left: it goes where it points."""
    if not vehicle.lateral_knots:
        return 0.0
    h = 1e-4
    rate = (lateral_m(vehicle, t_s + h) - lateral_m(vehicle, t_s - h)) / (2 * h)
    return float(np.arctan2(rate, max(path_speed_mps(vehicle, t_s), 1.0)))
