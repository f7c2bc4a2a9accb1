# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Where everything of a simulated pass is: rig, road and vehicles at a time."""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from .config import RigConfig, SimConfig, VehicleConfig
from .kinematics import heading_rad, lateral_m, path_m, path_speed_mps
from .road import Road
from ...core.errors import InputError
from ...core.records import Array
from ...geometry.camera import Camera
from ...geometry.rig import StereoRig

_ZEROS = {'plumb_bob': 5, 'rational_polynomial': 8, 'equidistant': 4}
_RATE_S = 1e-4  # half the step of the numeric ground speed


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


def moved_rig(rig: StereoRig, moved_deg: tuple[float, float, float]) -> StereoRig:
    """
    Turn the right camera about its own centre.

    :param rig: the rig as it was.
    :param moved_deg: pan to the right, tilt upwards, roll clockwise, degrees; one rotation
        vector about the right camera's y, x and z axis.
    """
    if not any(moved_deg):
        return rig
    pan, tilt, roll = moved_deg
    moved_R_right = Rotation.from_rotvec((tilt, pan, roll), degrees=True).as_matrix().T
    return StereoRig(rig.left, rig.right, moved_R_right @ rig.R, moved_R_right @ rig.t)


def stamp_text(stamp_ns: int) -> str:
    """Print a stamp as ``truth.csv`` does: seconds with whole microseconds."""
    return f'{stamp_ns // 10**9}.{stamp_ns % 10**9 // 1000:06d}'


@dataclass(frozen=True, eq=False)
class FrontPose:
    """
    Place of a vehicle's front.

    :param centre_m: (3,) its centre, left optical frame, m.
    :param axes: (3, 3) columns along travel, left and up, left optical frame.
    :param corners_m: (4, 3) clockwise as seen by the camera, from the image's top-left corner.
    :param ground_m: (3,) the point of the road below the front's middle, left optical frame.
    """

    centre_m: Array
    axes: Array
    corners_m: Array
    ground_m: Array


def turn_left(angle_rad: float) -> Array:
    """Return the rotation (3, 3) of a frame, columns along, left and up, about its up."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


class SimScene:
    """
    Geometry of a pass; the same config gives the same scene.

    :param config: what to build.

    ``rig`` is the calibrated rig, ``seen_rig`` the one that takes the images.
    """

    def __init__(self, config: SimConfig) -> None:
        self.config = config
        self.road = Road(config.road)
        self.rig = make_rig(config.rig)
        self.seen_rig = moved_rig(self.rig, config.rig_moved_deg)
        self.end_station_m = self._end_station()
        self.centre_world_m, self.left_R_world, self.chord = self._camera_pose()

    def _end_station(self) -> float:
        """Find the station whose point lies a chord of ``start_m - near_m`` from the start."""
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
        # Angles about the reversed chord: to the camera's right and downwards.
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
        """Turn world points (..., 3) into the left optical frame, m."""
        return (np.asarray(world_m) - self.centre_world_m) @ self.left_R_world.T

    @cached_property
    def _stations(self) -> dict[int, CubicHermiteSpline]:
        """Station over arc length of each lane's path, 0 at station 0."""
        road, splines = self.road, {}
        s = np.union1d(np.linspace(road.from_m, road.to_m, 4001), [0.0, road.config.clothoid_m])
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

    def road_point(self, vehicle: VehicleConfig, t_s: float) -> tuple[Array, float, float]:
        """Return the world point below the front, its station and its offset."""
        away = self.away(vehicle)
        gone = path_m(vehicle, t_s)
        if away:
            gone = self.arc(vehicle.lane, self.end_station_m) - gone
        station = self.station(vehicle.lane, gone)
        lateral = lateral_m(vehicle, t_s)
        offset = self.road.lane_offset(vehicle.lane) + (-lateral if away else lateral)
        return self.road.position(station, offset), station, offset

    def away(self, vehicle: VehicleConfig) -> bool:
        """Say whether a vehicle drives away from the camera, which then sees its rear."""
        return vehicle.lane in self.config.road.receding

    def front(self, vehicle: VehicleConfig, t_s: float) -> FrontPose:
        """Return the place of a vehicle's front, or of its rear when it recedes, at a time."""
        world, station, _ = self.road_point(vehicle, t_s)
        frame = self.road.frame(station, self.road.lane_offset(vehicle.lane))
        frame = frame @ turn_left(heading_rad(vehicle, t_s))
        if self.away(vehicle):
            frame = frame * [-1.0, -1.0, 1.0]
        axes = self.left_R_world @ frame
        ground = self.to_left(world)
        centre = ground + axes[:, 2] * (vehicle.clearance_m + vehicle.front_height_m / 2)
        half_w, half_h = vehicle.front_width_m / 2, vehicle.front_height_m / 2
        # The right of a vehicle that faces the camera is the image's left.
        half_w = -half_w if self.away(vehicle) else half_w
        corners = np.stack([centre + axes[:, 1] * w + axes[:, 2] * h for w, h in (
            (-half_w, half_h), (half_w, half_h), (half_w, -half_h), (-half_w, -half_h))])
        return FrontPose(centre, axes, corners, ground)

    def visible(self, vehicle: VehicleConfig, t_s: float) -> bool:
        """Say whether the front is whole in both views and not beyond the pass's end."""
        pose = self.front(vehicle, t_s)
        _, _, left, right = self.seen_rig.project(pose.corners_m)
        world, _, _ = self.road_point(vehicle, t_s)
        ahead = float((self.centre_world_m - world) @ self.chord)
        if self.away(vehicle) and ahead > self.config.start_m + 1e-6:
            return False
        return bool(left.all() and right.all()) and ahead >= self.config.near_m - 1e-6

    def truth(self, index: int, t_s: float, stamp_ns: int) -> dict[str, Any]:
        """Return a row of ``truth.csv`` for a vehicle, and ``stamp_ns`` with it."""
        vehicle = self.config.vehicles[index]
        pose = self.front(vehicle, t_s)
        step = (self.road_point(vehicle, t_s + _RATE_S)[0]
                - self.road_point(vehicle, t_s - _RATE_S)[0])
        uv, _, _, _ = self.seen_rig.project(pose.corners_m)
        x, y, z = pose.centre_m
        return {
            'stamp': stamp_text(stamp_ns),
            'stamp_ns': stamp_ns, 'vehicle': index,
            'speed': float(np.linalg.norm(step)) / (2 * _RATE_S),
            'path_speed': float(path_speed_mps(vehicle, t_s)),
            'lateral': float(lateral_m(vehicle, t_s)),
            'x': float(x), 'y': float(y), 'z': float(z),
            'width_px': float(np.linalg.norm((uv[1] + uv[2] - uv[0] - uv[3]) / 2)),
        }
