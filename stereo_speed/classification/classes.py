# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The class of a vehicle by its width and height, from Bayes' rule over the sizes of the classes.

All classes have the same prior probability, because the instrument makes no assumption about the
traffic of a road.
"""
from __future__ import annotations

import math
from typing import NamedTuple, Optional

from ..core.passes import VehicleClass, VehicleKind
from ..core.tracker_config import ClassConfig

_SQRT_2 = math.sqrt(2.0)
_LOW_SIGMAS = 2.0  # of its height, by which an object must be lower than vehicles


class _Sizes(NamedTuple):
    """Mean and 1-sigma of the widths and heights of a class, m."""

    width_m: float
    width_std_m: float
    height_m: float
    height_std_m: float


def classified(width_m: float, width_std_m: float, height_m: Optional[float],
               config: ClassConfig) -> VehicleKind:
    """
    Return size and class of a vehicle.

    :param width_m: width of its front, m.
    :param width_std_m: its 1-sigma, m.
    :param height_m: height above the road up to which the vehicle is seen, m; None if unknown.
    :param config: sizes of the classes.
    """
    likelihood = {name: _of_width(width_m, width_std_m, sizes, config)
                  * (1.0 if height_m is None else _of_height(height_m, sizes, config))
                  for name, sizes in _classes(config).items()}
    best = max(likelihood, key=lambda name: likelihood[name])
    total = sum(likelihood.values())
    probability = likelihood[best] / total if total > 0 else 0.0
    return VehicleKind(
        best if probability >= config.least_probability else VehicleClass.UNKNOWN, probability,
        width_m, width_std_m, height_m, None if height_m is None else config.height_std_m)


def is_no_vehicle(vehicle: VehicleKind, config: ClassConfig) -> bool:
    """Return whether width and height of the measured object are those of no vehicle."""
    return is_edge(vehicle, config) or is_low(vehicle, config)


def is_edge(vehicle: VehicleKind, config: ClassConfig) -> bool:
    """
    Return whether the measured object is only an edge of a vehicle.

    An example is the edge of the rear of a lorry that has passed, or that another vehicle hid
    where the track began.
    """
    return (vehicle.width_m < config.edge_width_m and vehicle.height_m is not None
            and vehicle.height_m > config.edge_height_m)


def is_low(vehicle: VehicleKind, config: ClassConfig) -> bool:
    """
    Return whether the measured object is lower than any vehicle.

    An example is the edge of a shadow, which moves with its vehicle.
    """
    return (vehicle.height_m is not None and vehicle.height_std_m is not None
            and vehicle.height_m + _LOW_SIGMAS * vehicle.height_std_m < config.least_height_m)


def _classes(c: ClassConfig) -> dict[VehicleClass, _Sizes]:
    return {
        VehicleClass.MOTORCYCLE: _Sizes(c.motorcycle_width_m, c.motorcycle_width_std_m,
                                        c.motorcycle_height_m, c.motorcycle_height_std_m),
        VehicleClass.CAR: _Sizes(c.car_width_m, c.car_width_std_m, c.car_height_m,
                                 c.car_height_std_m),
        VehicleClass.VAN: _Sizes(c.van_width_m, c.van_width_std_m, c.van_height_m,
                                 c.van_height_std_m),
        VehicleClass.HEAVY_VEHICLE: _Sizes(c.heavy_width_m, c.heavy_width_std_m,
                                           c.heavy_height_m, c.heavy_height_std_m)}


def _of_width(width_m: float, std_m: float, sizes: _Sizes, config: ClassConfig) -> float:
    """Return the likelihood of a width, allowing for outliers, 1/m."""
    odd = config.odd_width_share / config.odd_width_m
    return odd + (1 - config.odd_width_share) * _normal(
        width_m - sizes.width_m, math.hypot(std_m, sizes.width_std_m))


def _of_height(height_m: float, sizes: _Sizes, config: ClassConfig) -> float:
    """
    Return the likelihood of the height up to which a vehicle is seen, 1/m.

    It allows for vehicles whose top is not visible, and for outliers.
    """
    std_m = math.hypot(config.height_std_m, sizes.height_std_m)
    above = 0.5 * math.erfc((height_m - sizes.height_m) / (_SQRT_2 * std_m))
    seen = config.hidden_top_share * above / sizes.height_m + (
        1 - config.hidden_top_share) * _normal(height_m - sizes.height_m, std_m)
    return config.odd_height_share / config.odd_height_m + (1 - config.odd_height_share) * seen


def _normal(off: float, std: float) -> float:
    return math.exp(-0.5 * (off / std) ** 2) / (std * math.sqrt(2 * math.pi))
