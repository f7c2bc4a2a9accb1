# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Drivers of random passes who brake or accelerate while they are in view."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..sim.config import Knots, SimConfig

HEADING = 'driver'
HARD_MPS2 = 5.0  # braking at more counts as hard
_BRAKING_SHARE = 0.75  # of the drivers; the others accelerate
_BRAKING_MPS2, _ACCELERATING_MPS2 = (2.0, 8.0), (1.0, 3.0)
_ONSET = (0.1, 0.7)  # share of the way in view, at the speed of the start
_BUILD_UP_S, _BUILD_UP_KNOTS = 0.25, 5
_LASTS_S = (0.8, 4.0)
_LEAST_MPS = 2.0  # nobody stops, as a pass would never end


def with_driver(config: SimConfig, rng: np.random.Generator) -> tuple[SimConfig, str]:
    """
    Return a pass whose vehicle changes its speed, and the kind of its driver.

    It begins at a random moment in view. The acceleration builds up linearly over 0.25 s, is
    constant for 0.8 to 4 s, and ends at once.  Speeds may so leave the range of ``draw_pass``.
    """
    vehicle = config.vehicles[0]
    seen_s = (config.start_m - config.near_m) / vehicle.speed_mps
    if rng.uniform() < _BRAKING_SHARE:
        accel_mps2 = -float(rng.uniform(*_BRAKING_MPS2))
        kind = 'brakes hard' if accel_mps2 < -HARD_MPS2 else 'brakes'
    else:
        accel_mps2, kind = float(rng.uniform(*_ACCELERATING_MPS2)), 'accelerates'
    knots = _profile(vehicle.speed_mps, accel_mps2, float(rng.uniform(*_ONSET)) * seen_s,
                     float(rng.uniform(*_LASTS_S)))
    return replace(config, vehicles=(replace(vehicle, speed_knots=knots),)), kind


def _profile(speed_mps: float, accel_mps2: float, onset_s: float, lasts_s: float) -> Knots:
    """Return (time s, speed m/s) pairs."""
    share = np.linspace(0.0, 1.0, _BUILD_UP_KNOTS + 1)
    times_s = onset_s + _BUILD_UP_S * share
    speeds_mps = speed_mps + accel_mps2 * _BUILD_UP_S * share ** 2 / 2
    if accel_mps2 < 0:
        lasts_s = min(lasts_s, (speeds_mps[-1] - _LEAST_MPS) / -accel_mps2)
    end = times_s[-1] + lasts_s, speeds_mps[-1] + accel_mps2 * lasts_s
    return tuple((float(t), float(v)) for t, v in (
        (0.0, speed_mps), *zip(times_s, speeds_mps), end))
