# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""How simulated vehicles move on their springs over a rough road, and how riders lean."""
from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from scipy.constants import g as GRAVITY_MPS2

from .bodies import BodyConfig
from .config import SimConfig

# Classes of ISO 8608: displacement densities at 0.1 cycles/m, m^3, the geometric mean of each.
ROUGHNESS_M3 = {'A': 16e-6, 'B': 64e-6, 'C': 256e-6, 'D': 1024e-6}
_REFERENCE_PER_M = 0.1  # spatial frequency of the densities above
# Longer waves belong to the shape of the road; tyres roll over shorter ones.
_WAVES_PER_M = np.geomspace(0.02, 3.0, 300)
# A body on its springs, as of a quarter car whose wheels follow the road.
_NATURAL_HZ, _DAMPING = 1.3, 0.3
# Places of wheels: shares of a vehicle's length and width, m for a two-wheeler.
_OVERHANG_SHARE, _BASE_SHARE, _TRACK_SHARE, _LEAST_BASE_M = 0.2, 0.6, 0.85, 1.0
_MOTORCYCLE_OVERHANG_M, _MOTORCYCLE_BASE_M = -0.2, 1.4  # its axle is ahead of its front plane


def with_ride(config: SimConfig, road_class: str, seed: int) -> SimConfig:
    """
    Return a pass on a rough road, whose riders lean into bends.

    :param config: a pass whose vehicles stay level with the road.
    :param road_class: one of ``ROUGHNESS_M3``.
    :param seed: seed of the road's profile.
    """
    road = replace(config.road, roughness_m3=ROUGHNESS_M3[road_class], roughness_seed=seed)
    return replace(config, road=road, vehicles=tuple(
        replace(v, leans=v.leans or v.kind == 'motorcycle') for v in config.vehicles))


@dataclass(frozen=True)
class Attitude:
    """
    Attitude of a body relative to the road below its tracked front.

    :param rise_m: rise of the front.
    :param pitch_rad: rise along the direction of increasing stations.
    :param roll_rad: rise towards increasing offsets.
    """

    rise_m: float = 0.0
    pitch_rad: float = 0.0
    roll_rad: float = 0.0


LEVEL = Attitude()


class Springs:
    """
    Motion of a body over a rough road at an even speed.

    Each of four corners follows the road as a quarter car: waves that are longer than the car
    travels in a natural period pass, shorter ones are filtered. Left and right wheels roll over
    the same long waves and over different short ones. Bodies do not dive when they brake.

    :param roughness_m3: displacement density at 0.1 cycles/m, m^3 (ISO 8608, which has it fall
        with the square of the spatial frequency).
    :param body: size of the vehicle; both wheels of a two-wheeler are in one track.
    :param speed_mps: speed that determines what the springs filter.
    :param rng: source of the road's profile.
    """

    def __init__(self, roughness_m3: float, body: BodyConfig, speed_mps: float,
                 rng: np.random.Generator) -> None:
        single_track = body.kind == 'motorcycle'
        self.overhang_m = _OVERHANG_SHARE * body.length_m
        self.base_m = max(_BASE_SHARE * body.length_m, _LEAST_BASE_M)
        if single_track:
            self.overhang_m, self.base_m = _MOTORCYCLE_OVERHANG_M, _MOTORCYCLE_BASE_M
        self.track_m = _TRACK_SHARE * body.width_m
        per_m = _WAVES_PER_M
        density = roughness_m3 * (per_m / _REFERENCE_PER_M) ** -2
        ratio = per_m * speed_mps / _NATURAL_HZ
        damped = 2j * _DAMPING * ratio
        phases = np.exp(2j * math.pi * rng.uniform(size=len(per_m)))
        self._waves_m = (np.sqrt(2 * density * np.gradient(per_m)) * phases
                         * (1 + damped) / (1 - ratio ** 2 + damped))
        # Waves of less than twice the track are independent on both sides.
        apart = 0.0 if single_track else np.clip(2 * per_m * self.track_m, 0.0, 1.0)
        self._side_rad = math.pi * apart * rng.uniform(-1, 1, len(per_m))

    def _rise_m(self, station_m: float, side: float) -> float:
        """Return the rise of a corner; ``side`` is 1 on the left of the road, -1 on the right."""
        phase = 2 * math.pi * _WAVES_PER_M * station_m + side * self._side_rad
        return float(np.sum(self._waves_m * np.exp(1j * phase)).real)

    def attitude(self, station_m: float) -> Attitude:
        """Return the attitude of a vehicle whose tracked front is at a station."""
        near_m = station_m - self.overhang_m
        (near_left, near_right), (far_left, far_right) = (
            (self._rise_m(at_m, 1.0), self._rise_m(at_m, -1.0))
            for at_m in (near_m, near_m - self.base_m))
        pitch = (near_left + near_right - far_left - far_right) / 2 / self.base_m
        roll = (near_left + far_left - near_right - far_right) / 2 / self.track_m
        return Attitude((near_left + near_right) / 2 + pitch * self.overhang_m, pitch, roll)


def lean_rad(curvature: float, speed_mps: float, crossfall: float) -> float:
    """
    Return the roll of a single-track vehicle in a bend relative to the road's surface.

    Its weight and the lateral acceleration add up to a force through the line of its tyres.

    :param curvature: curvature of its path, 1/m, positive to the left.
    :param speed_mps: its speed.
    :param crossfall: rise to the left over plan distance.
    :return: rise towards the left, so that it is negative in a bend to the left.
    """
    return -math.atan(curvature * speed_mps ** 2 / GRAVITY_MPS2) - math.atan(crossfall)
