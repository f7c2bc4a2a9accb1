# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Random passes over the conditions of a roadside rig, for ``accuracy``.

Number and seed determine a pass, so that more passes do not change the earlier ones.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Mapping, Optional

import numpy as np

from .drivers import HEADING, with_driver
from .outdoors import draw_outdoors
from ..sim.config import RIGS, RoadConfig, SimConfig, VehicleConfig
from ..sim.ride import with_ride
from ..sim.scene import SimScene
from ..sim.sequence import picked_site
from ...core.errors import InputError
from ...core.units import MPH_MPS
from ...site.file import VIEWS

PATHS = ('straight', 'circle', 'clothoid')
# Greatest lateral acceleration that drivers and tyres tolerate.
MOST_ACROSS_MPS2 = 5.0
LEAST_MPH, MOST_MPH = 20.0, 90.0
# A line that is shorter in an image counts as out of view.
_LEAST_LINE_PX = 100.0
# A vehicle that is complete in fewer pairs counts as out of view.
_LEAST_PAIRS = 5
_MOST_ATTEMPTS = 50


@dataclass(frozen=True, kw_only=True)
class RandomPass:
    """
    A random pass.

    :param number: number of the pass.
    :param config: configuration of the simulation.
    :param kinds: groups that it belongs to: heading to kind.
    """

    number: int
    config: SimConfig
    kinds: dict[str, str]


def draw_pass(seed: int, number: int, *, pan_deg: float = 0.0, sway_deg: float = 0.0,
              outdoors: Optional[Mapping[str, str]] = None, braking: bool = False,
              ride: Optional[str] = None) -> RandomPass:
    """
    Draw a pass.

    Speed 20 to 90 mph (on curves up to 5 m/s^2 of lateral acceleration), straight, circular or
    clothoid road, to either side, 1 to 3 lanes, five kinds of rig, cameras 2 to 6 m high, noise of
    1 to 4 grey levels, grades up to 3 %, views of unequal brightness, fronts with a relief of up
    to 8 cm; picks with 0.3 px and annotations with 0.7 px of scatter. A camera is set up so that
    the road is in view: a pass in which a line is shorter than 100 px or the vehicle is in fewer
    than 5 pairs is drawn again.

    :param seed: seed of the whole set.
    :param number: number of the pass in the set, from 0; paths and rigs take turns.
    :param pan_deg: rotation of the right camera to either side since its calibration.
    :param sway_deg: 1-sigma of each angle of the rig in each pair.
    :param outdoors: also draw bodies, lamps, light and camera faults, except for the fixed kinds
        in it: heading to kind. None for fronts with relief in even light, as above.
    :param braking: whether each driver brakes or accelerates while in view.
    :param ride: class of the road over which vehicles move on their springs, as for
        :func:`with_ride`; None where they stay level with the road.
    """
    for attempt in range(_MOST_ATTEMPTS):
        drawn = _draw(np.random.default_rng([seed, number, attempt]), number, pan_deg)
        if outdoors is not None:
            # A separate generator keeps road, rig, speed and noise the same as without.
            config, kinds = draw_outdoors(drawn.config, number, outdoors, np.random.default_rng(
                [seed, number, attempt, 1]))
            drawn = replace(drawn, config=config, kinds={**kinds, **drawn.kinds})
        if braking:
            config, driver = with_driver(drawn.config, np.random.default_rng(
                [seed, number, attempt, 2]))
            drawn = replace(drawn, config=config, kinds={**drawn.kinds, HEADING: driver})
        if _is_in_view(drawn.config, seed):
            config = replace(drawn.config, sway_deg=sway_deg)
            if ride:
                profile = np.random.default_rng([seed, number, attempt, 3])
                config = with_ride(config, ride, int(profile.integers(2 ** 31)))
            return replace(drawn, config=config)
    raise InputError('accuracy', 'scene', number, 'a road that comes to lie in view')


def _draw(rng: np.random.Generator, number: int, pan_deg: float) -> RandomPass:
    """Draw a pass without checking that it is in view."""
    path, rig = PATHS[number % len(PATHS)], list(RIGS)[(number // len(PATHS)) % len(RIGS)]
    config, speed_mps = _road(path, rng)
    vehicle = VehicleConfig(
        speed_mps=speed_mps, lane=int(rng.integers(config.road.lanes)),
        front_width_m=float(rng.uniform(1.6, 2.0)), front_height_m=float(rng.uniform(0.6, 1.0)),
        clearance_m=float(rng.uniform(0.2, 0.35)),
        texture_contrast=float(rng.uniform(0.7, 1.2)),
        relief_m=float(rng.uniform(0.0, 0.08)))
    height_m, noise = float(rng.uniform(2.0, 6.0)), float(rng.uniform(1.0, 4.0))
    config = replace(
        config, vehicles=(vehicle,), rig=RIGS[rig], camera_height_m=height_m,
        noise_grey=noise, right_gain=float(rng.uniform(0.96, 1.04)),
        right_offset_grey=float(rng.uniform(-3.0, 3.0)), exposure=float(rng.uniform(0.6, 1.0)),
        speed_limit=f'{5 * round(speed_mps / MPH_MPS * rng.uniform(0.75, 1.1) / 5):.0f} mph',
        rig_moved_deg=(float(rng.choice([-1.0, 1.0])) * pan_deg, 0.0, 0.0),
        name=f'pass {number}')
    return RandomPass(number=number, config=config, kinds=_kinds(path, rig, config))


def _is_in_view(config: SimConfig, seed: int) -> bool:
    """Return whether lines and vehicle are in view, as for a properly set up camera."""
    scene = SimScene(config)
    for line in picked_site(scene, np.random.default_rng(seed))['lines'].values():
        for view in VIEWS:
            picks = np.array(line[view])
            if len(picks) < 2 or np.ptp(picks, axis=0).max() < _LEAST_LINE_PX:
                return False
    seen = [scene.visible(scene.vehicles[0], i / config.fps) for i in range(_LEAST_PAIRS)]
    return all(seen)


def _road(path: str, rng: np.random.Generator) -> tuple[SimConfig, float]:
    """Draw a road with start and end of the pass, and a speed suited to it, m/s."""
    curvature, start_curvature, most_mps = 0.0, 0.0, MOST_MPH * MPH_MPS
    if path == 'straight':
        config = SimConfig(start_m=float(rng.uniform(60.0, 80.0)),
                           near_m=float(rng.uniform(16.0, 20.0)),
                           camera_side_m=float(rng.uniform(3.0, 7.0)))
    else:
        # Log-uniform, from the bend of a junction to that of a highway.
        radius_m = float(np.exp(rng.uniform(math.log(35.0), math.log(400.0))))
        curvature = float(rng.choice([-1.0, 1.0])) / radius_m
        start_curvature = curvature * (
            1.0 if path == 'circle' else float(rng.uniform(0.0, 0.3)))
        most_mps = min(most_mps, math.sqrt(MOST_ACROSS_MPS2 * radius_m))
        config = SimConfig(start_m=float(rng.uniform(44.0, 52.0)),
                           near_m=float(rng.uniform(15.0, 18.0)))
    road = RoadConfig(lanes=int(rng.integers(1, 4)), grade=float(rng.uniform(-0.03, 0.03)),
                      lane_width_m=float(rng.uniform(3.2, 3.8)), curvature_end=curvature,
                      curvature_start=start_curvature)
    return replace(config, road=road), float(rng.uniform(LEAST_MPH * MPH_MPS, most_mps))


def _kinds(path: str, rig: str, config: SimConfig) -> dict[str, str]:
    """Return the groups of a pass: heading to kind."""
    mph = config.vehicles[0].speed_mps / MPH_MPS
    return {
        'path': path, 'rig': rig, 'lanes': str(config.road.lanes),
        'speed': '20-40 mph' if mph < 40 else '40-65 mph' if mph < 65 else '65-90 mph',
        'camera height': '2-4 m' if config.camera_height_m < 4 else '4-6 m',
        'noise': '1-2.5 grey levels' if config.noise_grey < 2.5 else '2.5-4 grey levels'}
