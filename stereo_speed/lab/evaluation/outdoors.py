# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Random outdoor conditions for ``accuracy``, which a painted plane in even light lacks.

Bodies with depth, lamps that saturate, sun and sky reflected in the paint, wet nights, and faulty
cameras.
"""
from __future__ import annotations

from dataclasses import replace
import math
from typing import Mapping

import numpy as np

from ..sim.bodies import draw_body_size
from ..sim.config import SimConfig
from ..sim.optics import FaultConfig, LensConfig, USUAL_GAMMA
from ..sim.props import DUSK, LightConfig, OVERCAST, StreetLampConfig, WET_NIGHT
from ...core.errors import InputError
from ...core.passes import VehicleClass

OUTDOORS = {
    'vehicle': ('car', 'small', 'suv', 'van', 'truck', 'bus', 'motorcycle'),
    'lamps': ('off', 'dim', 'clipping'),
    'light': ('overcast', 'sun', 'dusk', 'wet_night'),
    'fault': ('none', 'exposure', 'gain', 'defocus', 'dirt')}
# The class of each kind of vehicle.
CLASS_OF = {'car': VehicleClass.CAR, 'small': VehicleClass.CAR, 'suv': VehicleClass.CAR,
            'van': VehicleClass.VAN, 'truck': VehicleClass.HEAVY_VEHICLE,
            'bus': VehicleClass.HEAVY_VEHICLE, 'motorcycle': VehicleClass.MOTORCYCLE}
# Half of the passes have cameras without faults.
FAULT_SHARES = (0.5, 0.125, 0.125, 0.125, 0.125)
# Ranges of the lamps' grey levels; 255 is full scale.
DIM_GREY, CLIPPING_GREY, NIGHT_GREY = (80.0, 250.0), (1500.0, 15000.0), (5000.0, 30000.0)


def check_held(held: Mapping[str, str]) -> None:
    """
    Refuse unknown headings and kinds.

    :param held: heading to kind.
    :raises InputError: an unknown heading or kind.
    """
    for heading, kind in held.items():
        if heading not in OUTDOORS:
            raise InputError('accuracy', '--outdoors', heading, 'one of ' + ', '.join(OUTDOORS))
        if kind not in OUTDOORS[heading]:
            raise InputError('accuracy', f'--outdoors {heading}', kind,
                             'one of ' + ', '.join(OUTDOORS[heading]))


def draw_outdoors(config: SimConfig, number: int, held: Mapping[str, str],
                  rng: np.random.Generator) -> tuple[SimConfig, dict[str, str]]:
    """
    Add outdoor conditions to a pass; its road, rig, speed and noise are unchanged.

    :param config: the pass.
    :param number: number of the pass; kinds of vehicles take turns.
    :param held: fixed kinds, which are not drawn: heading to kind.
    :param rng: source of randomness.
    :return: the new configuration, and the groups of the pass: heading to kind.
    """
    kinds = {'vehicle': OUTDOORS['vehicle'][number % len(OUTDOORS['vehicle'])],
             'lamps': str(rng.choice(OUTDOORS['lamps'])),
             'light': str(rng.choice(OUTDOORS['light'])),
             'fault': str(rng.choice(OUTDOORS['fault'], p=FAULT_SHARES)), **held}
    night = kinds['light'] == 'wet_night'
    if night:
        kinds['lamps'] = 'clipping'
    bounds = NIGHT_GREY if night else CLIPPING_GREY if kinds['lamps'] == 'clipping' else DIM_GREY
    grey = math.exp(rng.uniform(*np.log(bounds))) * (kinds['lamps'] != 'off')
    sun = DUSK if kinds['light'] == 'dusk' else OVERCAST
    if kinds['light'] == 'sun':
        sun = LightConfig(sun_elevation_deg=float(rng.uniform(20.0, 60.0)),
                          sun_azimuth_deg=float(rng.uniform(0.0, 360.0)))
    body = draw_body_size(kinds['vehicle'], rng)
    vehicle = replace(
        config.vehicles[0], kind=body.kind, solid=True, front_width_m=body.width_m,
        front_height_m=body.front_m, clearance_m=body.clearance_m, relief_m=0.01,
        lamp_grey=grey, gloss=float(rng.uniform(0.3, 1.0)))
    config = replace(
        config, vehicles=(vehicle,), light=WET_NIGHT if night else sun,
        lens=LensConfig(core_px=float(rng.uniform(0.4, 0.8)),
                        halo_share=float(rng.uniform(0.01, 0.05)),
                        halo_px=float(rng.uniform(4.0, 12.0)), gamma=USUAL_GAMMA),
        street_lamps=_street_lamps(rng) if night else (),
        exposure=0.35 if kinds['light'] == 'dusk' else config.exposure)
    return _with_fault(config, kinds['fault'], rng), kinds


def _street_lamps(rng: np.random.Generator) -> tuple[StreetLampConfig, ...]:
    """Draw two street lamps above the road, one on each side."""
    return tuple(StreetLampConfig(
        station_m=float(rng.uniform(-60.0, 30.0)), offset_m=float(side * rng.uniform(3.0, 6.0)),
        height_m=float(rng.uniform(6.0, 9.0)), grey=float(rng.uniform(3000.0, 8000.0)))
        for side in (-1.0, 2.0))


def _with_fault(config: SimConfig, fault: str, rng: np.random.Generator) -> SimConfig:
    """Give the cameras exactly one fault."""
    if fault == 'gain':
        return replace(config, right_gain=float(rng.choice([0.8, 1.2])),
                       right_offset_grey=float(rng.uniform(-8.0, 8.0)))
    faults = {'none': FaultConfig(), 'exposure': FaultConfig(exposure_step=0.15),
              'defocus': FaultConfig(right_defocus_px=float(rng.uniform(1.0, 2.0))),
              'dirt': FaultConfig(dirt=15, dirt_depth=0.6)}
    return replace(config, faults=faults[fault])
