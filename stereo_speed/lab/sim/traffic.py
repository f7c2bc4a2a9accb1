# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A stream of traffic: pair after pair with exact truth, never held in memory."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Iterator, Mapping

import numpy as np

from .appearance import BodyLook
from .arrivals import Driver, TrafficFlow
from .painter import Painter, Shown
from .scene import FrontPose, SimScene, stamp_text
from .sequence import picked_site
from .street import Ground
from .traffic_config import TrafficConfig
from ...core.records import Array, StereoPair

FAR_M = 300.0  # vehicles come into being this far from the camera
BEHIND_M = 16.0  # and are kept this far behind it
TRUTH_FAR_M = 150.0  # truth is told up to this distance
_RATE_S = 1e-4  # half the step of the numeric ground speed


@dataclass(frozen=True, eq=False)
class TrafficPair:
    """
    A pair and what is true of it.

    :param pair: the pair.
    :param truth: a row for each vehicle whose tracked face (front, or rear when receding) has
        its centre in both images: the columns of ``truth.csv``, ``lane`` (index of the lane
        that its centre is in, from which ``lateral`` counts), ``visible`` (share of the face
        that is seen, the least of both views) and ``in_view`` (the face lies wholly in both
        images, and not nearer than the pass's end).
    """

    pair: StereoPair
    truth: tuple[Mapping[str, Any], ...]


class TrafficStream:
    """
    Traffic past a rig.

    :param config: what to simulate.
    :param rng: source of all randomness; one state, one stream.

    ``scene`` is its geometry, ``rig`` the calibrated rig, ``site`` the content of a site file
    with picked lines. It can be iterated once.
    """

    def __init__(self, config: TrafficConfig, rng: np.random.Generator) -> None:
        paint, flow, self._clock, pick, look = rng.spawn(5)
        self.config = config
        self.scene = SimScene(config.scene)
        self.rig = self.scene.rig
        self.site = picked_site(self.scene, pick)
        self._painter_rng, self._look_seed = paint, int(look.integers(2 ** 62))
        self._looks: dict[int, BodyLook] = {}
        self._ground = Ground(self.scene)
        self._enter = {lane: self._limits(lane) for lane in range(config.scene.road.lanes)}
        self._flow = TrafficFlow(
            config, {lane: limits[2] for lane, limits in self._enter.items()},
            {lane: limits[1] for lane, limits in self._enter.items()}, flow)

    def __iter__(self) -> Iterator[TrafficPair]:
        """Give the pairs, one after the other."""
        painter = Painter(self.scene, self._painter_rng)
        scene = self.config.scene
        count = 0
        for t_s, stamp_ns, right_ns in self._times():
            self._flow.advance(t_s)
            shown = self._shown(t_s)
            late = self._shown(t_s + scene.right_delay_s) if scene.right_delay_s else None
            images, shares = painter.paint(
                shown, (t_s, t_s + scene.right_delay_s), late)
            rows = [self._row(d, t_s, stamp_ns, shares) for d in self._flow.drivers]
            pair = StereoPair(count, stamp_ns, right_ns, *images)
            yield TrafficPair(pair, tuple(row for row in rows if row is not None))
            count += 1

    def _limits(self, lane: int) -> tuple[float, float, tuple[float, float]]:
        """Return the arc at which a lane is entered, where it is left, and what is measured."""
        scene, road = self.scene, self.scene.road
        camera = scene.end_station_m + scene.config.near_m
        near = min(camera + BEHIND_M, road.to_m - 1.0)
        far = max(camera - FAR_M, road.from_m + 1.0)
        stations = (far, near, 0.0, scene.end_station_m)
        arcs = [scene.arc(lane, station) for station in stations]
        if lane in road.config.receding:
            return arcs[1], arcs[1] - arcs[0], (arcs[1] - arcs[3], arcs[1] - arcs[2])
        return arcs[0], arcs[1] - arcs[0], (arcs[2] - arcs[0], arcs[3] - arcs[0])

    def _times(self) -> Iterator[tuple[float, int, int]]:
        """Yield exposure time, s, left and right stamp, ns, of each pair that arrives."""
        c = self.config.scene
        for i in range(int(self.config.minutes * 60 * c.fps)):
            jitter, skew = (float(k) for k in self._clock.standard_normal(2))
            jitter = float(np.clip(jitter * c.stamp_jitter_s, -1 / (3 * c.fps), 1 / (3 * c.fps)))
            offset_ns = max(round((i / c.fps + (jitter if i else 0.0)) * 1e6) * 1000, 0)
            t_s = offset_ns * 1e-9
            if i in c.drop or any(a <= t_s < b for a, b in c.gaps_s):
                continue
            stamp_ns = c.origin_ns + offset_ns
            skew = float(np.clip(skew / 2, -1, 1)) * c.right_stamp_jitter_s
            yield t_s, stamp_ns, stamp_ns + round((c.right_delay_s + skew) * 1e9)

    def _point(self, driver: Driver, t_s: float) -> tuple[Array, float, float, int]:
        """Return the world point below the tracked face, its station, offset and direction."""
        enter = self._enter[driver.lane][0]
        away = driver.lane in self.config.scene.road.receding
        x, _ = self._flow.place(driver, t_s)
        arc = enter - (x - driver.body.length_m) if away else enter + x
        station = self.scene.station(driver.lane, arc)
        place, _ = driver.lane_place(t_s)
        offset = place * self.config.scene.road.lane_width_m
        return self.scene.road.position(station, offset), station, offset, -1 if away else 1

    def _pose(self, driver: Driver, t_s: float) -> FrontPose:
        """Return the place of the tracked face; the heading follows the lane change."""
        world, station, offset, way = self._point(driver, t_s)
        axes = self._ground.axes(station, offset, way < 0)
        rate = driver.lane_place(t_s)[1] * self.config.scene.road.lane_width_m * way
        yaw = np.arctan2(rate, max(self._flow.place(driver, t_s)[1], 1.0))
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0],
                         [0, 0, 1]])
        axes = axes @ turn
        body = driver.body
        ground = self.scene.to_left(world)
        height, half = (body.rear_m if way < 0 else body.face_m), body.width_m / 2
        centre = ground + axes[:, 2] * (body.clearance_m + height / 2)
        # The image's left is the right of who comes, and the left of who goes.
        left = -axes[:, 1] * half * way
        up = axes[:, 2] * height / 2
        corners = centre + np.stack([left + up, up - left, -left - up, left - up])
        return FrontPose(centre, axes, corners, ground)

    def _shown(self, t_s: float) -> list[Shown]:
        here = {d.number: d for d in self._flow.drivers}
        self._looks = {n: look for n, look in self._looks.items() if n in here}
        for number, driver in here.items():
            if number not in self._looks:
                rng = np.random.default_rng([self._look_seed, number])
                self._looks[number] = BodyLook(
                    driver.body, driver.lane in self.config.scene.road.receding, rng)
        return [Shown(n, self._looks[n], self._pose(d, t_s)) for n, d in here.items()]

    def _row(self, driver: Driver, t_s: float, stamp_ns: int,
             shares: Mapping[int, float]) -> Mapping[str, Any] | None:
        """Return what is true of a vehicle; None where its face's centre is out of view."""
        pose, rig = self._pose(driver, t_s), self.scene.seen_rig
        if not 1.0 < pose.centre_m[2] < TRUTH_FAR_M:
            return None
        _, _, left, right = rig.project(pose.centre_m[None])
        if not (left.all() and right.all()):
            return None
        world, _, offset, way = self._point(driver, t_s)
        step = self._point(driver, t_s + _RATE_S)[0] - self._point(driver, t_s - _RATE_S)[0]
        width_m = self.config.scene.road.lane_width_m
        lane = int(np.clip(round(offset / width_m), 0, self.config.scene.road.lanes - 1))
        uv, _, left, right = rig.project(pose.corners_m)
        ahead = float((self.scene.centre_world_m - world) @ self.scene.chord)
        x, y, z = (float(k) for k in pose.centre_m)
        return {
            'stamp': stamp_text(stamp_ns), 'stamp_ns': stamp_ns, 'vehicle': driver.number,
            'speed': float(np.linalg.norm(step)) / (2 * _RATE_S),
            'path_speed': self._flow.place(driver, t_s)[1],
            'lateral': way * (offset - lane * width_m), 'x': x, 'y': y, 'z': z,
            'width_px': float(np.linalg.norm((uv[1] + uv[2] - uv[0] - uv[3]) / 2)),
            'lane': lane, 'visible': shares.get(driver.number, 0.0),
            'in_view': bool(left.all() and right.all()
                            and ahead >= self.config.scene.near_m - 1e-6)}


def stream_traffic(config: TrafficConfig, rng: np.random.Generator) -> Iterator[TrafficPair]:
    """
    Simulate traffic, pair after pair; the same config and generator state give the same stream.

    :param config: what to simulate.
    :param rng: source of all randomness.
    """
    return iter(TrafficStream(config, rng))
