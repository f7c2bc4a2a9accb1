# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Configuration of simulated traffic; all lengths in metres, all times in seconds."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .bodies import BodyConfig, draw_body_size
from .config import RoadConfig, SimConfig
from .optics import LensConfig, USUAL_GAMMA
from .props import (
    DAY, DUSK, LightConfig, OVERCAST, ParkedConfig, PersonConfig, PoleConfig, StreetLampConfig,
    TreeConfig, WET_NIGHT)
from ...core.errors import InputError
from ...core.units import MPH_MPS

LIGHTS: dict[str, tuple[LightConfig, float, float]] = {  # light, exposure, noise in grey levels
    'day': (DAY, 1.0, 2.0), 'overcast': (OVERCAST, 0.85, 2.0), 'dusk': (DUSK, 0.35, 3.0),
    'wet_night': (WET_NIGHT, 1.0, 3.0)}
OUTDOOR_KINDS = (('car', 0.4), ('suv', 0.16), ('small', 0.1), ('van', 0.1), ('truck', 0.1),
                 ('bus', 0.04), ('motorcycle', 0.1))
LIT_SHARE = 0.7  # share of the vehicles with lit lamps by day
# Ranges of the lamps' grey levels by day and by night; 255 is full scale.
DAY_LAMPS, NIGHT_LAMPS = (80.0, 15000.0), (5000.0, 30000.0)


@dataclass(frozen=True, kw_only=True)
class TrafficConfig:
    """
    A stream of traffic.

    :param scene: road, rig, rate, noise, light and objects; its vehicles are ignored.
    :param minutes: length of the stream.
    :param vehicles: number of vehicles that enter the road.
    :param lane_speeds_mps: mean desired speed in each lane, m/s.
    :param lane_shares: share of the vehicles in each lane; need not sum to 1.
    :param speed_std_mps: standard deviation of the desired speeds, m/s.
    :param kinds: share of each kind of vehicle; need not sum to 1.
    :param solid: whether fronts are non-planar, paint and glass glossy, and lamps lit.
    :param follow_share: share of vehicles that closely follow another.
    :param headway_s: least and greatest time gap that a follower keeps, s.
    :param change_share: share of vehicles that plan a lane change.
    :param change_s: shortest and longest lane change, s.
    :param brake_share: share of vehicles that brake or accelerate in view.
    :param hardest_g: greatest planned acceleration, g.
    :param before_s: time before the stream from which vehicles enter, s.
    :param clear_s: time before its end until which vehicles enter, s.
    """

    scene: SimConfig = SimConfig(fps=10.0)
    minutes: float = 10.0
    vehicles: int = 200
    lane_speeds_mps: tuple[float, ...] = tuple(
        mph * MPH_MPS for mph in (45.0, 53.0, 60.0))
    lane_shares: tuple[float, ...] = (0.4, 0.35, 0.25)
    speed_std_mps: float = 2.0
    kinds: tuple[tuple[str, float], ...] = (
        ('car', 0.5), ('suv', 0.24), ('van', 0.14), ('truck', 0.12))
    solid: bool = False
    follow_share: float = 0.3
    headway_s: tuple[float, float] = (0.9, 1.8)
    change_share: float = 0.1
    change_s: tuple[float, float] = (2.0, 6.0)
    brake_share: float = 0.15
    hardest_g: float = 0.6
    before_s: float = 12.0
    clear_s: float = 20.0

    def __post_init__(self) -> None:
        """Refuse values that cannot be simulated."""
        lanes = self.scene.road.lanes
        for name in ('lane_speeds_mps', 'lane_shares'):
            if len(getattr(self, name)) < lanes:
                raise InputError('traffic', name, getattr(self, name), f'{lanes} values')
        for name, good in (('minutes', self.minutes > 0), ('vehicles', self.vehicles >= 1),
                           ('hardest_g', 0.15 <= self.hardest_g <= 0.6),
                           ('headway_s', 0.5 <= self.headway_s[0] <= self.headway_s[1]),
                           ('change_s', 1.0 <= self.change_s[0] <= self.change_s[1])):
            if not good:
                raise InputError('traffic', name, getattr(self, name), 'a value that can be')

    def same_way(self, lane: int, other: int) -> bool:
        """Return whether a lane ``other`` exists and has the same direction."""
        road = self.scene.road
        return (0 <= other < road.lanes
                and (lane in road.receding) == (other in road.receding))

    def draw_body(self, rng: np.random.Generator) -> BodyConfig:
        """Draw a vehicle's body."""
        share = np.array([s for _, s in self.kinds])
        kind = self.kinds[int(rng.choice(len(share), p=share / share.sum()))][0]
        body = draw_body_size(kind, rng)
        if not self.solid:
            return body
        light = self.scene.light
        night = light is not None and light.headlights
        grey = float(np.exp(rng.uniform(*np.log(NIGHT_LAMPS if night else DAY_LAMPS))))
        lit = rng.random() < LIT_SHARE or night
        return replace(body, solid=True, relief_m=0.01, gloss=float(rng.uniform(0.3, 1.0)),
                       lamp_grey=grey if lit else 0.0)


def traffic_config(light: str = 'day', lanes: int = 3, receding: int = 0, fps: float = 10.0,
                   minutes: float = 10.0, vehicles: int = 200, outdoors: bool = False,
                   **changes: Any) -> TrafficConfig:
    """
    Build a stream by a road of several lanes, with people, trees, a parked car and a pole.

    :param light: one of ``LIGHTS``.
    :param lanes: number of lanes.
    :param receding: number of lanes, from the left, with receding traffic that shows its rears.
    :param fps: pairs per second.
    :param outdoors: whether to add motorcycles, buses and small cars, and non-planar fronts.
    :param changes: fields of :class:`SimConfig`.
    """
    if light not in LIGHTS:
        raise InputError('traffic', 'light', light, 'one of ' + ', '.join(LIGHTS))
    sun, exposure, noise = LIGHTS[light]
    road = RoadConfig(lanes=lanes, receding=tuple(range(lanes - receding, lanes)))
    left_m = (lanes - 0.5) * road.lane_width_m
    scene = SimConfig(
        road=road, fps=fps, light=sun, exposure=exposure, noise_grey=noise, right_gain=1.03,
        right_offset_grey=1.5, name=f'traffic_{light}', camera_height_m=6.0,
        poles=(PoleConfig(ahead_m=14.0, right_m=1.8),),
        people=(PersonConfig(station_m=12.0, offset_m=-4.2, turns_m=25.0),
                PersonConfig(station_m=36.0, offset_m=left_m + 2.6, speed_mps=-1.2,
                             height_m=1.68, turns_m=30.0)),
        trees=(TreeConfig(station_m=4.0, offset_m=left_m + 6.0),
               TreeConfig(station_m=-40.0, offset_m=left_m + 9.0, height_m=9.0, period_s=3.3),
               TreeConfig(station_m=-55.0, offset_m=-8.0, height_m=8.0, period_s=2.9)),
        parked=(ParkedConfig(station_m=20.0, offset_m=-4.5),))
    if sun.wet:
        scene = replace(scene, street_lamps=(
            StreetLampConfig(station_m=25.0), StreetLampConfig(station_m=-15.0),
            StreetLampConfig(station_m=5.0, offset_m=left_m + 2.0)))
    if outdoors:
        scene = replace(scene, lens=LensConfig(
            core_px=0.6, halo_share=0.03, halo_px=8.0, gamma=USUAL_GAMMA))
    config = TrafficConfig(scene=replace(scene, **changes), minutes=minutes, vehicles=vehicles)
    return replace(config, solid=True, kinds=OUTDOOR_KINDS) if outdoors else config
