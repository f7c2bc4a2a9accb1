# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Geometry and timing of a simulated scene: rig, road, vehicles and exposures."""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Callable, Iterator, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from .bodies import BodyConfig
from .config import RigConfig, SimConfig, VehicleConfig
from .kinematics import lateral_m, lateral_mps, path_m, path_speed_mps
from .ride import Attitude, lean_rad, LEVEL, Springs
from .road import Road
from ...core.errors import InputError
from ...core.records import Array
from ...geometry.camera import Camera
from ...geometry.rig import StereoRig

_ZEROS = {'plumb_bob': 5, 'rational_polynomial': 8, 'equidistant': 4}
_RATE_S = 1e-4  # half the step of the numerical derivative for the ground speed
_SLOWEST_MPS = 1.0  # lower limit of the path speed in the computation of a heading
_MARGIN_M = 1e-6  # margin for comparisons with the ends of the pass
AWAY = np.array([-1.0, -1.0, 1.0])  # reverses the direction of travel of a frame


class TruthRow(TypedDict):
    """A row of ``truth.csv``, and its stamp in ns."""

    stamp: str
    stamp_ns: int
    vehicle: int
    speed: float
    path_speed: float
    lateral: float
    x: float
    y: float
    z: float
    width_px: float


def make_rig(config: RigConfig) -> StereoRig:
    """Build the rig; the base frame has its origin in the left centre and x on the baseline."""
    cameras = []
    for name, f_px, coefficients in (
            ('left', config.f_px, config.left_coefficients),
            ('right', config.right_f_px or config.f_px, config.right_coefficients)):
        k = np.array([[f_px, 0.0, (config.width_px - 1) / 2],
                      [0.0, f_px, (config.height_px - 1) / 2], [0.0, 0.0, 1.0]])
        d = np.array(coefficients or np.zeros(_ZEROS.get(config.model, 5)), dtype=float)
        cameras.append(Camera(name, config.width_px, config.height_px, k, d, config.model))
    left_R_base, right_R_base = (
        Rotation.from_rotvec(r, degrees=True).as_matrix().T
        for r in (config.left_rotation_deg, config.right_rotation_deg))
    left, right = cameras
    return StereoRig(left, right, right_R_base @ left_R_base.T,
                     -right_R_base @ np.array([config.baseline_m, 0.0, 0.0]))


def stamp_text(stamp_ns: int) -> str:
    """Return a stamp in the form of ``truth.csv``: seconds with whole microseconds."""
    return f'{stamp_ns // 10**9}.{stamp_ns % 10**9 // 1000:06d}'


@dataclass(frozen=True)
class Exposure:
    """
    The exposure of a pair.

    :param t_s: exposure time of the left camera after the start of the simulation, s.
    :param stamp_ns: left stamp.
    :param right_stamp_ns: right stamp.
    """

    t_s: float
    stamp_ns: int
    right_stamp_ns: int


@dataclass(frozen=True)
class Place:
    """
    Position of the tracked front of a vehicle on the road.

    :param station_m: station of the point of the road below it.
    :param offset_m: offset of that point.
    :param lane: lane from whose path its lateral offset is counted.
    :param speed_mps: speed along the path.
    :param drift_mps: speed across the path, positive to the left of travel.
    """

    station_m: float
    offset_m: float
    lane: int
    speed_mps: float
    drift_mps: float


@dataclass(frozen=True, eq=False)
class Vehicle:
    """
    A vehicle on the road.

    :param number: as in ``truth.csv``.
    :param body: its size.
    :param place: returns its position at a time, s.
    :param attitude: returns its attitude at a place.
    """

    number: int
    body: BodyConfig
    place: Callable[[float], Place]
    attitude: Callable[[Place], Attitude] = lambda _: LEVEL


@dataclass(frozen=True, eq=False)
class FrontPose:
    """
    Pose of the tracked front of a vehicle: its front, or its rear when it recedes.

    All places are in the left optical frame, m; axes are columns ahead, left and up in that frame.

    :param centre_m: (3,), its centre.
    :param axes: (3, 3), axes of the body.
    :param corners_m: (4, 3), clockwise as seen by the camera, from the image's top-left corner.
    :param origin_m: (3,), where the body's vertical through the front's middle meets its tyres.
    :param ground_m: (3,), the point of the road there; the body may be above or below it.
    :param ground_axes: (3, 3), axes of a body that is level with the road.
    :param rear: whether it is the rear.
    """

    centre_m: Array
    axes: Array
    corners_m: Array
    origin_m: Array
    ground_m: Array
    ground_axes: Array
    rear: bool = False


class SimScene:
    """
    Geometry of a scene, which follows from the config.

    :param config: the configuration.

    ``rig`` is the calibrated rig, ``seen_rig`` the one that takes the images; ``vehicles`` are
    those of the config.
    """

    def __init__(self, config: SimConfig) -> None:
        self.config = config
        self.road = Road(config.road)
        self.rig = make_rig(config.rig)
        # Its drift is not recorded, because no site has corrected it.
        self.seen_rig = replace(self.rig.drifted(np.radians(config.rig_moved_deg)),
                                drift_rad=self.rig.drift_rad)
        self.end_station_m = self._end_station()
        self.centre_world_m, self.left_R_world, self.chord = self._camera_pose()
        self.vehicles = [self._vehicle(number, v) for number, v in enumerate(config.vehicles)]

    def _end_station(self) -> float:
        """Return the station at a chord of ``start_m - near_m`` from the start."""
        chord = self.config.start_m - self.config.near_m
        stations = np.arange(0.0, 2.0 * chord, 0.5)
        gaps = np.linalg.norm(self.road.position(stations)[:, :2], axis=1) - chord
        if not np.any(gaps > 0):
            raise InputError('simulation', 'start_m - near_m', f'{chord} m',
                             'a chord that fits on the curve')
        last = int(np.argmax(gaps > 0))
        return float(brentq(
            lambda s: np.linalg.norm(self.road.position(s)[:2]) - chord,
            stations[last - 1], stations[last]))

    def _camera_pose(self) -> tuple[Array, Array, Array]:
        """Place the camera beyond the end of the chord and aim it at the pass."""
        c, stations = self.config, np.linspace(0.0, self.end_station_m, 60)
        points = self.road.position(stations)
        chord = points[-1] - points[0]
        chord[2] = 0.0
        chord /= np.linalg.norm(chord)
        side = c.camera_side_m
        if side is None:
            side = 0.0 if self.road.curved else 5.0
        centre = points[-1] + chord * c.near_m + side * np.array([chord[1], -chord[0], 0.0])
        centre[2] += c.camera_height_m
        sight = points + [0.0, 0.0, 0.8] - centre
        # Angles relative to the reversed chord: to the camera's right and downwards.
        right = np.array([-chord[1], chord[0], 0.0])
        ahead = np.hypot(sight @ chord, sight @ right)
        azimuth = np.arctan2(sight @ right, -(sight @ chord))
        depression = np.arctan2(-sight[:, 2], ahead)
        yaw = (azimuth.max() + azimuth.min()) / 2 + np.radians(c.camera_yaw_deg)
        pitch = ((depression.max() + depression.min()) / 2 if c.camera_pitch_deg is None
                 else np.radians(c.camera_pitch_deg))
        forward = np.cos(yaw) * -chord + np.sin(yaw) * right
        x = np.cross(forward, [0.0, 0.0, 1.0])
        z = np.cos(pitch) * forward - np.sin(pitch) * np.array([0.0, 0.0, 1.0])
        base_R_world = np.stack([x, np.cross(z, x), z])
        left_R_base = Rotation.from_rotvec(
            c.rig.left_rotation_deg, degrees=True).as_matrix().T
        return centre, left_R_base @ base_R_world, chord

    def to_left(self, world_m: Array) -> Array:
        """Return world points (..., 3) in the left optical frame, m."""
        return np.asarray((world_m - self.centre_world_m) @ self.left_R_world.T)

    def point(self, station_m: ArrayLike, offset_m: ArrayLike) -> Array:
        """Return points (..., 3) of the road's surface in the left optical frame, m."""
        return self.to_left(self.road.position(station_m, offset_m))

    def open_m(self, points_m: Array) -> NDArray[np.bool_]:
        """Return which points (n, 3) of the surface are not self-occluded in the left view."""
        world = points_m @ self.left_R_world + self.centre_world_m
        share = np.linspace(0.02, 0.98, 60)[:, None, None]
        sight = self.centre_world_m + share * (world - self.centre_world_m)
        ground = self.road.height(*self.road.station(sight[..., :2]))
        return np.asarray((sight[..., 2] > ground - _MARGIN_M).all(axis=0))

    @cached_property
    def up(self) -> Array:
        """Return the vertical (3,) in the left optical frame."""
        return np.asarray(self.left_R_world[:, 2])

    @cached_property
    def _stations(self) -> dict[int, CubicHermiteSpline]:
        """Return station over arc length of each lane's path, 0 at station 0."""
        road, splines = self.road, {}
        begin_m = road.config.clothoid_at_m
        s = np.union1d(np.linspace(road.from_m, road.to_m, 4001), [
            0.0, begin_m, begin_m + road.config.clothoid_m])
        for lane in range(road.config.lanes):
            rate = road.length_per_station(s, road.lane_offset(lane))
            arc = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(s))])
            arc -= arc[np.searchsorted(s, 0.0)]
            splines[lane] = CubicHermiteSpline(arc, s, 1 / rate)
        return splines

    def station(self, lane: int, arc_m: float) -> float:
        """Return the station at an arc length along a lane's path, both 0 at station 0."""
        return float(self._stations[lane](arc_m))

    def arc(self, lane: int, station_m: float) -> float:
        """Return the arc length along a lane's path at a station."""
        arcs = self._stations[lane].x
        return float(np.interp(station_m, self._stations[lane](arcs), arcs))

    def away(self, lane: int) -> bool:
        """Return whether a lane leads away from the camera, which then sees rears."""
        return lane in self.config.road.receding

    def _vehicle(self, number: int, config: VehicleConfig) -> Vehicle:
        """Return a vehicle that moves as configured."""
        lane = config.lane
        away = self.away(lane)

        def place(t_s: float) -> Place:
            arc, lateral = path_m(config, t_s), lateral_m(config, t_s)
            if away:
                arc, lateral = self.arc(lane, self.end_station_m) - arc, -lateral
            return Place(self.station(lane, arc), self.road.lane_offset(lane) + lateral, lane,
                         path_speed_mps(config, t_s), lateral_mps(config, t_s))
        return Vehicle(number, config.body, place, self._attitude(config))

    def _attitude(self, config: VehicleConfig) -> Callable[[Place], Attitude]:
        """Return how a vehicle stands on the road: on its springs, and leaning if it leans."""
        road, springs = self.config.road, None
        if road.roughness_m3:
            rng = np.random.default_rng([road.roughness_seed, config.lane])
            springs = Springs(road.roughness_m3, config.body, path_speed_mps(config, 0.0), rng)

        def attitude(place: Place) -> Attitude:
            found = springs.attitude(place.station_m) if springs else LEVEL
            if config.leans:
                curvature = float(self.road.curvature(place.station_m))
                found = replace(found, roll_rad=lean_rad(
                    curvature / (1 - curvature * place.offset_m), place.speed_mps,
                    float(self.road.crossfall(place.station_m))))
            return found
        return attitude

    def exposures(self, count: int, rng: np.random.Generator) -> Iterator[Exposure]:
        """
        Yield the exposure of each pair that arrives.

        :param count: number of exposures; some of their pairs are lost.
        :param rng: source of the jitter.
        """
        c = self.config
        for i in range(count):
            jitter = float(rng.standard_normal()) * c.stamp_jitter_s if i else 0.0
            # At most a third of a period, so that the order is kept.
            jitter = float(np.clip(jitter, -1 / (3 * c.fps), 1 / (3 * c.fps)))
            skew = float(rng.uniform(-1, 1)) * c.right_stamp_jitter_s
            # Whole microseconds, so that truth.csv has them exactly.
            offset_ns = round((i / c.fps + jitter) * 1e6) * 1000
            t_s = offset_ns * 1e-9
            if i not in c.drop and not any(a <= t_s < b for a, b in c.gaps_s):
                stamp_ns = c.origin_ns + offset_ns
                yield Exposure(t_s, stamp_ns, stamp_ns + round((c.right_delay_s + skew) * 1e9))

    def front(self, vehicle: Vehicle, t_s: float) -> FrontPose:
        """Return the pose of a vehicle's tracked front, which steers along its velocity."""
        place, body = vehicle.place(t_s), vehicle.body
        away = self.away(place.lane)
        heading = np.arctan2(place.drift_mps, max(place.speed_mps, _SLOWEST_MPS))
        stands = vehicle.attitude(place)
        road = self.road.frame(place.station_m, place.offset_m)
        tilt = Rotation.from_euler('YX', [-stands.pitch_rad, stands.roll_rad]).as_matrix()
        steered = Rotation.from_rotvec([0.0, 0.0, heading]).as_matrix()
        ground_axes, axes = (
            self.left_R_world @ (frame * AWAY if away else frame) @ steered
            for frame in (road, road @ tilt))
        ground = self.point(place.station_m, place.offset_m)
        origin = ground + stands.rise_m * self.up
        height_m = body.tracked_m(away)
        centre = origin + axes[:, 2] * (body.clearance_m + height_m / 2)
        # The image's left is the right side of an approaching vehicle, the left of a receding one.
        left = axes[:, 1] * body.width_m / 2 * (1 if away else -1)
        up = axes[:, 2] * height_m / 2
        corners = centre + np.stack([left + up, up - left, -left - up, left - up])
        return FrontPose(centre, axes, corners, origin, ground, ground_axes, away)

    def in_view(self, vehicle: Vehicle, t_s: float) -> bool:
        """Return whether the whole front is in both views and not beyond the pass's end."""
        _, _, left, right = self.seen_rig.project(self.front(vehicle, t_s).corners_m)
        return bool(left.all() and right.all()
                    and self._ahead_m(vehicle, t_s) >= self.config.near_m - _MARGIN_M)

    def visible(self, vehicle: Vehicle, t_s: float) -> bool:
        """Return whether a vehicle's front is in view, and not before the pass's start."""
        if self.away(vehicle.place(t_s).lane) \
                and self._ahead_m(vehicle, t_s) > self.config.start_m + _MARGIN_M:
            return False
        return self.in_view(vehicle, t_s)

    def _world(self, vehicle: Vehicle, t_s: float) -> Array:
        place = vehicle.place(t_s)
        return self.road.position(place.station_m, place.offset_m)

    def _ahead_m(self, vehicle: Vehicle, t_s: float) -> float:
        """Return the distance of a vehicle ahead of the camera along the chord."""
        return float((self.centre_world_m - self._world(vehicle, t_s)) @ self.chord)

    def truth(self, vehicle: Vehicle, t_s: float, stamp_ns: int) -> TruthRow:
        """Return a vehicle's row of ``truth.csv``, with ``stamp_ns``."""
        pose, place = self.front(vehicle, t_s), vehicle.place(t_s)
        step = self._world(vehicle, t_s + _RATE_S) - self._world(vehicle, t_s - _RATE_S)
        lateral = place.offset_m - self.road.lane_offset(place.lane)
        uv = self.seen_rig.project(pose.corners_m)[0]
        x, y, z = (float(k) for k in pose.centre_m)
        return {
            'stamp': stamp_text(stamp_ns), 'stamp_ns': stamp_ns, 'vehicle': vehicle.number,
            'speed': float(np.linalg.norm(step)) / (2 * _RATE_S), 'path_speed': place.speed_mps,
            'lateral': -lateral if pose.rear else lateral, 'x': x, 'y': y, 'z': z,
            'width_px': float(np.linalg.norm((uv[1] + uv[2] - uv[0] - uv[3]) / 2))}
