# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The sequences of the 2012 paper (Section V), simulated from its description.

From the paper: speeds, paths, 5 pairs/s, 1024x768 rendered and 1280x960 recorded images, a bar of
0.5 m that is not quite parallel, a tilted road and a busier background in recorded sequences, no
noise in rendered ones, the angular rate on the circle, the frames shown, lane width and drift of
the lane changes, and the error of the filter's first speed. Ours: focal length, positions of
camera and road, and all appearances. The images are not the paper's.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable

from ..sim.config import (
    circle_config, RigConfig, RoadConfig, SimConfig, straight_config, VehicleConfig)
from ...core.errors import InputError
from ...core.units import MPH_MPS

FPS = 5.0
LANE_M = 3.7
_NEAR_M = 17.5
_RENDERED = RigConfig()
_RECORDED = RigConfig(
    width_px=1280, height_px=960, f_px=2250.0, right_f_px=2241.0, baseline_m=0.5,
    left_rotation_deg=(0.3, 0.8, -0.4), right_rotation_deg=(-0.2, -0.7, 0.5),
    left_coefficients=(-0.12, 0.08, 3e-4, -2e-4, 0.0),
    right_coefficients=(-0.11, 0.07, -2e-4, 3e-4, 0.0))


@dataclass(frozen=True, kw_only=True)
class PaperSequence:
    """
    A sequence and the paper's settings of the filters on it.

    :param title: title of the sequence.
    :param config: returns the configuration of the simulation.
    :param particles: number of particles of the particle filters.
    :param speed_step_mps: 1-sigma of the speed's change from pair to pair, m/s.
    :param vehicles: name of each vehicle.
    """

    title: str
    config: Callable[[], SimConfig]
    particles: int
    speed_step_mps: float
    vehicles: tuple[str, ...] = ('',)


def _car(mph: float, **changes: object) -> VehicleConfig:
    """Return a car as a camera records it: fully textured, with a front with relief."""
    plain = VehicleConfig(speed_mps=mph * MPH_MPS, kind='car', relief_m=0.04)
    return replace(plain, **changes)  # type: ignore[arg-type]


def _straight55() -> SimConfig:
    """Return the rendered pass from 72 m to 17.5 m in 12 pairs; the filter starts at 45 mph."""
    return straight_config('55 mph', rig=_RENDERED, noise_grey=0.0, speed_limit='45 mph',
                           name='straight55')


def _circle36() -> SimConfig:
    """Return the rendered circle at 22.5 degrees/s: at 36 mph a radius of 41 m."""
    return circle_config('36 mph', 36 * MPH_MPS / 0.392699, rig=_RENDERED, noise_grey=0.0,
                         speed_limit='30 mph', name='circle36')


def _straight36() -> SimConfig:
    """Return the recorded pass on a tilted road; the filter starts more than 10 % off."""
    return straight_config(vehicles=(_car(36.0),), rig=_RECORDED, start_m=62.0, near_m=_NEAR_M,
                           road=RoadConfig(grade=-0.02), speed_limit='40 mph', name='straight36')


def _curve28() -> SimConfig:
    """Return the recorded pass into a tightening bend; the filter starts much too low."""
    road = RoadConfig(curvature_start=1 / 250, curvature_end=1 / 40, clothoid_m=45.0, grade=0.01)
    return circle_config(vehicles=(_car(28.0, kind='suv'),), rig=_RECORDED, road=road,
                         start_m=50.0, near_m=16.0, speed_limit='20 mph', name='curve28')


def _two_vehicles() -> SimConfig:
    """Return the recorded pair of vehicles, the left at 50 mph; the filters start at 55 mph."""
    vehicles = (_car(50.0, lane=1), _car(53.0, lane=0, kind='van', head_start_m=-9.0))
    return straight_config(vehicles=vehicles, rig=_RECORDED, road=RoadConfig(lanes=3),
                           start_m=75.0, speed_limit='55 mph', name='two_vehicles')


def _lane_change(mph: float, last_s: float) -> SimConfig:
    """Return the recorded lane change in the middle of a pass of 30 pairs, with smooth ends."""
    pairs = 30
    begin_s = ((pairs - 1) / FPS - last_s) / 2
    vehicle = _car(mph, lateral_knots=((begin_s, 0.0), (begin_s + last_s, LANE_M)))
    return straight_config(
        vehicles=(vehicle,), rig=_RECORDED, pairs=pairs, near_m=_NEAR_M,
        start_m=_NEAR_M + 1.0 + mph * MPH_MPS * (pairs - 1) / FPS, speed_limit=f'{mph:g} mph',
        name=f'lane_change{mph:g}')


SEQUENCES: dict[str, PaperSequence] = {
    'straight55': PaperSequence(
        title='straight, 55 mph, rendered', config=_straight55, particles=800,
        speed_step_mps=0.05),
    'circle36': PaperSequence(
        title='circle, 36 mph, rendered', config=_circle36, particles=200, speed_step_mps=0.05),
    'straight36': PaperSequence(
        title='straight, 36 mph', config=_straight36, particles=400, speed_step_mps=0.15),
    'curve28': PaperSequence(
        title='curve, 28 mph', config=_curve28, particles=400, speed_step_mps=0.15),
    'two_vehicles': PaperSequence(
        title='two vehicles', config=_two_vehicles, particles=400, speed_step_mps=0.15,
        vehicles=('50 mph, left', '53 mph, right')),
    'lane_change35': PaperSequence(
        title='lane change in 5 s, 35 mph', config=lambda: _lane_change(35.0, 5.0),
        particles=400, speed_step_mps=0.15),
    'lane_change30': PaperSequence(
        title='lane change in 3 s, 30 mph', config=lambda: _lane_change(30.0, 3.0),
        particles=400, speed_step_mps=0.15),
}


def find_sequence(name: str) -> PaperSequence:
    """
    Return a sequence by its name.

    :raises InputError: there is no such sequence.
    """
    if name not in SEQUENCES:
        raise InputError('evaluation', 'sequence', name, ', '.join(SEQUENCES))
    return SEQUENCES[name]


def rate_std(step_mps: float, fps: float = FPS) -> float:
    """Convert a 1-sigma of the speed's change per pair, m/s, to our rate, m/s/sqrt(s)."""
    return float(step_mps * fps ** 0.5)
