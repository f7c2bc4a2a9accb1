# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A stream of traffic: pairs with exact truth, generated one by one."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Iterator, Optional

import numpy as np

from .arrivals import Driver, TrafficFlow
from .painter import Painter
from .scene import Place, SimScene, TruthRow, Vehicle
from .sequence import picked_site
from .sway import Sway
from .traffic_config import TrafficConfig
from ...core.records import StereoPair

FAR_M = 300.0  # vehicles enter at this distance from the camera
BEHIND_M = 16.0  # vehicles are kept up to this distance behind the camera
TRUTH_FAR_M = 150.0  # truth is given up to this distance


class TrafficRow(TruthRow):
    """
    A row of the ``truth.csv`` of traffic.

    ``lane`` is the index of the lane with the front's centre, from which ``lateral`` is counted;
    ``visible`` is the visible share of the front, the lesser of both views; ``in_view`` tells
    whether the whole front is in both images, and not nearer than the pass's end.
    """

    lane: int
    visible: float
    in_view: bool


@dataclass(frozen=True, eq=False)
class TrafficPair:
    """
    A pair with its truth.

    :param pair: the pair.
    :param truth: a row for each vehicle whose tracked front (its rear when it recedes) has its
        centre in both images.
    """

    pair: StereoPair
    truth: tuple[TrafficRow, ...]


class TrafficStream:
    """
    Traffic past a rig.

    :param config: configuration of the traffic.
    :param rng: source of all randomness; equal states give equal streams.

    ``scene`` is its geometry, ``rig`` the calibrated rig, ``site`` the content of a site file
    with picked lines. It can be iterated once.
    """

    def __init__(self, config: TrafficConfig, rng: np.random.Generator) -> None:
        self._scenery, flow, self._clock, pick, self._bodies, wind = rng.spawn(6)
        self.config = config
        self.scene = SimScene(config.scene)
        self.rig, self._sway = self.scene.rig, Sway(config.scene, wind)
        self.site = picked_site(self.scene, pick)
        self._enter = {lane: self._limits(lane) for lane in range(config.scene.road.lanes)}
        self._flow = TrafficFlow(
            config, {lane: limits[2] for lane, limits in self._enter.items()},
            {lane: limits[1] for lane, limits in self._enter.items()}, flow)

    def __iter__(self) -> Iterator[TrafficPair]:
        """Yield the pairs, one after the other."""
        painter = Painter(self.scene, self._scenery, self._bodies)
        count = int(self.config.minutes * 60 * self.config.scene.fps)
        for index, taken in enumerate(self.scene.exposures(count, self._clock)):
            self._flow.advance(taken.t_s)
            vehicles = [self._vehicle(driver) for driver in self._flow.drivers]
            motion = self._sway.motion(taken.t_s)
            images, shares = painter.paint(vehicles, taken.t_s, motion)
            rows = [self._row(vehicle, taken.t_s, taken.stamp_ns, shares.get(vehicle.number, 0.0))
                    for vehicle in vehicles]
            pair = StereoPair(index, taken.stamp_ns, taken.right_stamp_ns, *images)
            yield TrafficPair(pair, tuple(row for row in rows if row is not None))

    def _limits(self, lane: int) -> tuple[float, float, tuple[float, float]]:
        """Return a lane's entry, as arc length, and its exit and measured part, from there, m."""
        scene, road = self.scene, self.scene.road
        camera = scene.end_station_m + scene.config.near_m
        near = min(camera + BEHIND_M, road.to_m - 1.0)
        far = max(camera - FAR_M, road.from_m + 1.0)
        stations = (far, near, 0.0, scene.end_station_m)
        arcs = [scene.arc(lane, station) for station in stations]
        if lane in road.config.receding:
            return arcs[1], arcs[1] - arcs[0], (arcs[1] - arcs[3], arcs[1] - arcs[2])
        return arcs[0], arcs[1] - arcs[0], (arcs[2] - arcs[0], arcs[3] - arcs[0])

    def _vehicle(self, driver: Driver) -> Vehicle:
        """Return a driver's vehicle, whose position is valid within a step of the flow."""
        road, enter_m = self.config.scene.road, self._enter[driver.lane][0]
        away = self.scene.away(driver.lane)

        def place(t_s: float) -> Place:
            x_m, speed_mps = self._flow.place(driver, t_s)
            arc_m = enter_m - (x_m - driver.body.length_m) if away else enter_m + x_m
            lanes, rate = driver.lane_place(t_s)
            lane = int(np.clip(round(lanes), 0, road.lanes - 1))
            return Place(self.scene.station(driver.lane, arc_m), lanes * road.lane_width_m, lane,
                         speed_mps, rate * road.lane_width_m * (-1 if away else 1))
        return Vehicle(driver.number, driver.body, place)

    def _row(self, vehicle: Vehicle, t_s: float, stamp_ns: int,
             share: float) -> Optional[TrafficRow]:
        """Return the truth of a vehicle; None where its front's centre is out of view."""
        centre = self.scene.front(vehicle, t_s).centre_m
        if not 1.0 < centre[2] < TRUTH_FAR_M:
            return None
        _, _, left, right = self.scene.seen_rig.project(centre[None])
        if not (left.all() and right.all()):
            return None
        return {**self.scene.truth(vehicle, t_s, stamp_ns), 'lane': vehicle.place(t_s).lane,
                'visible': share, 'in_view': self.scene.in_view(vehicle, t_s)}
