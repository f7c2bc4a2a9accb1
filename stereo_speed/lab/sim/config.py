# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Configuration of a simulated pass; all lengths in metres, all times in seconds."""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Any, Optional

from .bodies import BODIES, BodyConfig
from .optics import FaultConfig, LensConfig, SHARP, SOUND
from .props import (
    LightConfig, ParkedConfig, PersonConfig, PoleConfig, StreetLampConfig, TreeConfig)
from ...core.errors import InputError
from ...core.units import parse_speed

Knots = tuple[tuple[float, float], ...]

ROOF_RISE_M = 0.2  # least height of a roof above the front


@dataclass(frozen=True, kw_only=True)
class RigConfig:
    """
    The stereo rig.

    :param width_px: image width of both cameras, px.
    :param height_px: image height of both cameras, px.
    :param f_px: focal length of the left camera, px.
    :param right_f_px: focal length of the right camera, px; None for the same.
    :param baseline_m: distance between the two centres, m.
    :param left_rotation_deg: rotation vector of the left camera relative to the rig's base frame
        (x along the baseline, z forward), degrees about x, y and z.
    :param right_rotation_deg: the same for the right camera.
    :param model: distortion model: ``plumb_bob``, ``rational_polynomial`` or ``equidistant``.
    :param left_coefficients: D of the left camera; empty for zeros.
    :param right_coefficients: D of the right camera; empty for zeros.
    """

    width_px: int = 1024
    height_px: int = 768
    f_px: float = 1800.0
    right_f_px: Optional[float] = None
    baseline_m: float = 0.5
    left_rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    right_rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    model: str = 'plumb_bob'
    left_coefficients: tuple[float, ...] = ()
    right_coefficients: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RoadConfig:
    """
    The road, in travel direction.

    Its curvature is ``curvature_start`` up to a clothoid, along which it changes linearly to
    ``curvature_end``; a positive one turns left.

    :param curvature_start: curvature of the road's right lane path, 1/m.
    :param curvature_end: the same at the end of the clothoid, 1/m.
    :param clothoid_m: length over which the curvature changes, m.
    :param clothoid_at_m: station at which the clothoid begins; 0 is the vehicle's start.
    :param grade: rise over plan distance along the road, positive uphill in travel direction.
    :param grade_end: the same beyond the vertical curve; None for ``grade``.
    :param vertical_curve_m: plan length of the parabola between the two grades, a crest or a sag.
    :param vertical_curve_at_m: station of its middle.
    :param crossfall_start: rise to the left over plan distance, where the curvature is
        ``curvature_start``; it changes along the clothoid as the curvature does.
    :param crossfall_end: the same at the end of the clothoid.
    :param turned_about_m: offset of the line about which the crossfall turns the road, m.
    :param lanes: number of lanes, 1 to 3; lane 0 is the rightmost.
    :param lane_width_m: distance between two lane markings, centre to centre, m.
    :param marking_width_m: width of a lane marking, m.
    :param dash_m: length of a dash of the inner lines, m.
    :param gap_m: gap between two dashes, m.
    :param dashed_edges: whether the outer lines are dashed as well.
    :param wear: share of the paint that is worn away, in patches.
    :param receding: lanes whose vehicles drive in the other direction and show their rears.
    :param roughness_m3: displacement density at 0.1 cycles/m of the profile that makes vehicles
        bounce, m^3 (ISO 8608); 0 for none. The surface is drawn smooth, and the vehicles of
        ``traffic`` and parked ones stay level.
    :param roughness_seed: seed of that profile, which differs from lane to lane.
    """

    curvature_start: float = 0.0
    curvature_end: float = 0.0
    clothoid_m: float = 40.0
    clothoid_at_m: float = 0.0
    grade: float = 0.0
    grade_end: Optional[float] = None
    vertical_curve_m: float = 60.0
    vertical_curve_at_m: float = 20.0
    crossfall_start: float = 0.0
    crossfall_end: float = 0.0
    turned_about_m: float = 0.0
    lanes: int = 2
    lane_width_m: float = 3.7
    marking_width_m: float = 0.15
    dash_m: float = 3.0
    gap_m: float = 6.0
    dashed_edges: bool = False
    wear: float = 0.0
    receding: tuple[int, ...] = ()
    roughness_m3: float = 0.0
    roughness_seed: int = 0


@dataclass(frozen=True, kw_only=True)
class VehicleConfig:
    """
    One vehicle, which moves with the frame of its lane's path.

    Its front is tracked; in a receding lane it is its rear, with the same size and finish.

    :param speed_mps: path speed at the start, m/s.
    :param accel_mps2: constant acceleration along the path, m/s^2; the speed stops at zero.
    :param speed_knots: (time s, path speed m/s) pairs, linear in between and constant outside;
        they replace the two fields above.
    :param lane: index of its lane, 0 the rightmost.
    :param lateral_knots: (time s, offset m) pairs, positive to the left of travel, with smooth
        steps in between; empty for none.
    :param head_start_m: position along the lane at the first stamp, m; a negative one is farther
        away than ``SimConfig.start_m``.
    :param front_width_m: width of the front, m.
    :param front_height_m: height of the front, m.
    :param clearance_m: height of the front's lower edge above the road, m.
    :param texture_contrast: scale of the front's grey-level detail; 1 as on a real car.
    :param relief_m: standard deviation of the front's depth: grilles lie deeper than bumpers.
    :param kind: ``car``, ``suv``, ``van``, ``truck``, ``small``, ``bus`` or ``motorcycle`` for
        the body behind the front; empty for only a front.
    :param solid: whether the front is not planar; its foremost part is where a plane would be.
    :param lamp_grey: grey level of the lit lamps of a solid body; 255 is full scale, 0 is off.
    :param gloss: gloss of paint and glass of a solid body: 0 is matt, 1 is clear lacquer.
    :param leans: whether it leans into bends, which a motorcycle may.
    """

    speed_mps: float = 24.58720
    accel_mps2: float = 0.0
    speed_knots: Knots = ()
    lane: int = 0
    lateral_knots: Knots = ()
    head_start_m: float = 0.0
    front_width_m: float = 1.8
    front_height_m: float = 0.8
    clearance_m: float = 0.25
    texture_contrast: float = 1.0
    relief_m: float = 0.0
    kind: str = 'car'
    solid: bool = False
    lamp_grey: float = 0.0
    gloss: float = 0.0
    leans: bool = False

    @property
    def body(self) -> BodyConfig:
        """Return the body behind the front."""
        kind = BODIES[self.kind]
        top = self.clearance_m + self.front_height_m
        return replace(
            kind, width_m=self.front_width_m, front_m=self.front_height_m,
            rear_m=self.front_height_m, clearance_m=self.clearance_m,
            roof_m=max(kind.roof_m, top + ROOF_RISE_M), relief_m=self.relief_m,
            contrast=self.texture_contrast, solid=kind.solid or self.solid,
            lamp_grey=self.lamp_grey, gloss=self.gloss)


@dataclass(frozen=True, kw_only=True)
class SimConfig:
    """
    A simulated stereo sequence; its randomness comes from a separate generator.

    :param vehicles: the vehicles.
    :param road: the road.
    :param rig: the rig.
    :param start_m: distance of the first front from the camera, along the chord of the pass, m.
    :param near_m: distance at which the pass ends, likewise, m.
    :param camera_height_m: height of the left camera above the road at the pass's end, m.
    :param camera_side_m: offset of the camera from the chord of the right lane's pass, positive
        to the right of travel, m; None for 5 m on straight roads and 0 m on curved ones.
    :param camera_pitch_deg: downward pitch of the rig, degrees; None aims at the pass.
    :param camera_yaw_deg: rotation of the rig to its right, away from the middle of the pass,
        degrees.
    :param pairs: greatest number of pairs; None for all until ``near_m``.
    :param fps: nominal pair rate, 1/s.
    :param stamp_jitter_s: standard deviation of the exposure times about the nominal ones, s;
        the stamps are the true times.
    :param right_stamp_jitter_s: largest error of the right stamps relative to the true times, s.
    :param drop: indices of pairs that are lost.
    :param noise_grey: standard deviation of the sensor noise, grey levels.
    :param right_gain: gain of the right view relative to the left one.
    :param right_offset_grey: offset of the right view relative to the left one, grey levels.
    :param exposure: brightness of the scene, 1 is daylight, 0.35 is dusk.
    :param picks: number of clicked points on each line in each view.
    :param pick_std_px: scatter of the clicked points, px.
    :param init_std_px: scatter of the corners of the initial fronts, px.
    :param speed_limit: as in the site file.
    :param name: name of the site.
    :param origin_ns: first stamp, ns.
    :param rig_moved_deg: pan to the right, tilt upwards and roll clockwise, degrees, by which
        the right camera has rotated about its own centre since the calibration: the images, the
        clicked points and the initial fronts are those of the rotated camera, ``rig`` and
        ``CameraInfo`` those of the calibration.
    :param sway_deg: standard deviation of each angle of the rig, degrees; the clicked points are
        those of the rig at rest.
    :param sway_hz: frequency of that sway; 0 for angles that are drawn for each pair.
    :param right_turn_deg: pan to the right, tilt upwards and roll clockwise, degrees, by which
        the right camera turns in the middle of the stream.
    :param right_turn_s: time of that turn, s; None for never.
    :param gaps_s: start and end times of gaps in which no pair arrives, s.
    :param right_delay_s: delay of the right camera's exposure, which its stamps show, s.
    :param poles: poles between camera and road.
    :param people: people who walk beside the road.
    :param trees: trees in the wind.
    :param parked: parked vehicles.
    :param light: the light on the scene; None for an even sky.
    :param street_lamps: lit lamps above the road.
    :param lens: point spread of both lenses.
    :param faults: faults of the cameras.
    """

    vehicles: tuple[VehicleConfig, ...] = (VehicleConfig(),)
    road: RoadConfig = RoadConfig()
    rig: RigConfig = RigConfig()
    start_m: float = 72.0
    near_m: float = 17.5
    camera_height_m: float = 4.0
    camera_side_m: Optional[float] = None
    camera_pitch_deg: Optional[float] = None
    camera_yaw_deg: float = 0.0
    pairs: Optional[int] = None
    fps: float = 5.0
    stamp_jitter_s: float = 0.0
    right_stamp_jitter_s: float = 0.0
    drop: tuple[int, ...] = ()
    noise_grey: float = 2.0
    right_gain: float = 1.0
    right_offset_grey: float = 0.0
    exposure: float = 1.0
    picks: int = 14
    pick_std_px: float = 0.3
    init_std_px: float = 0.7
    speed_limit: str = '45 mph'
    name: str = 'simulated'
    origin_ns: int = 1_700_000_000_000_000_000
    rig_moved_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sway_deg: float = 0.0
    sway_hz: float = 0.0
    right_turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    right_turn_s: Optional[float] = None
    gaps_s: Knots = ()
    right_delay_s: float = 0.0
    poles: tuple[PoleConfig, ...] = ()
    people: tuple[PersonConfig, ...] = ()
    trees: tuple[TreeConfig, ...] = ()
    parked: tuple[ParkedConfig, ...] = ()
    light: Optional[LightConfig] = None
    street_lamps: tuple[StreetLampConfig, ...] = ()
    lens: LensConfig = SHARP
    faults: FaultConfig = SOUND

    def __post_init__(self) -> None:
        """Refuse values that cannot be simulated."""
        _want(1 <= self.road.lanes <= 3, 'road.lanes', self.road.lanes, '1, 2 or 3')
        for vehicle in self.vehicles:
            _want(0 <= vehicle.lane < self.road.lanes, 'vehicle.lane', vehicle.lane,
                  f'a lane below {self.road.lanes}')
            _want(vehicle.front_width_m > 0 and vehicle.front_height_m > 0,
                  'vehicle front', (vehicle.front_width_m, vehicle.front_height_m),
                  'a positive width and height in m')
            _want(vehicle.kind in BODIES, 'vehicle.kind', vehicle.kind,
                  'one of ' + repr(tuple(BODIES)))
            _want(vehicle.kind == 'motorcycle' or not vehicle.leans, 'vehicle.leans',
                  vehicle.leans, 'a motorcycle')
            _want(vehicle.kind != '' or not vehicle.solid, 'vehicle.solid', vehicle.solid,
                  'a kind of body for a front that is no plane')
        _want(all(0 <= lane < self.road.lanes for lane in self.road.receding), 'road.receding',
              self.road.receding, f'lanes below {self.road.lanes}')
        _want(self.road.roughness_m3 >= 0, 'road.roughness_m3', self.road.roughness_m3,
              'not negative')
        _want(len(self.vehicles) > 0, 'vehicles', 0, 'at least one')
        _want(self.start_m > self.near_m > 0, 'start_m, near_m', (self.start_m, self.near_m),
              'start_m > near_m > 0')
        _want(self.fps > 0 and math.isfinite(self.fps), 'fps', self.fps, 'a positive rate')
        _want(self.noise_grey >= 0, 'noise_grey', self.noise_grey, 'not negative')
        _want(self.rig.baseline_m > 0, 'rig.baseline_m', self.rig.baseline_m, 'positive')
        _want(self.camera_height_m > 0, 'camera_height_m', self.camera_height_m, 'positive')
        _want(self.picks >= 2, 'picks', self.picks, 'at least 2')
        lens, faults, light = self.lens, self.faults, self.light or LightConfig()
        _want(lens.core_px >= 0 and lens.halo_px > 0 and 0 <= lens.halo_share < 1
              and lens.gamma >= 1, 'lens', lens, 'widths of at least 0 px, a halo wider than '
              'that, a share below 1, and a gamma of at least 1')
        _want(0 <= faults.exposure_step < 1, 'faults.exposure_step', faults.exposure_step,
              'a share below 1')
        _want(min(faults.right_defocus_px, faults.dirt) >= 0 and faults.dirt_px > 0
              and 0 <= faults.dirt_depth <= 1, 'faults', faults, 'no negative blur or dirt')
        _want(0 < light.ambient <= 1 and 0 <= light.wet <= 1, 'light.ambient, light.wet',
              (light.ambient, light.wet), 'shares, and some light')
        _want(0 <= self.sway_deg <= 10, 'sway_deg', self.sway_deg, '0 to 10 degrees')
        _want(0 <= self.sway_hz <= 1000, 'sway_hz', self.sway_hz, '0 to 1000 Hz')
        _want(len(self.right_turn_deg) == 3 and all(abs(a) <= 10 for a in self.right_turn_deg),
              'right_turn_deg', self.right_turn_deg,
              'pan, tilt and roll of at most 10 degrees')
        _want(len(self.rig_moved_deg) == 3 and all(abs(a) <= 10 for a in self.rig_moved_deg),
              'rig_moved_deg', self.rig_moved_deg, 'pan, tilt and roll of at most 10 degrees')


def _want(condition: bool, what: str, found: object, wanted: str) -> None:
    if not condition:
        raise InputError('simulation', what, found, wanted)


def straight_config(speed: str = '55 mph', **changes: Any) -> SimConfig:
    """
    Build a straight pass at a constant speed, from 72 m to 17.5 m.

    :param speed: as in the site file.
    :param changes: fields of :class:`SimConfig`.
    """
    config = SimConfig(vehicles=(VehicleConfig(speed_mps=parse_speed(speed)),))
    return replace(config, **changes)


def circle_config(speed: str = '36 mph', radius_m: float = 41.0, **changes: Any) -> SimConfig:
    """
    Build a pass on a circle at a constant speed, from 48 m to 16 m.

    :param speed: as in the site file.
    :param radius_m: radius of the right lane's path, m; negative turns right.
    :param changes: fields of :class:`SimConfig`.
    """
    curvature = 1 / radius_m
    config = SimConfig(
        vehicles=(VehicleConfig(speed_mps=parse_speed(speed)),),
        road=RoadConfig(curvature_start=curvature, curvature_end=curvature),
        start_m=48.0, near_m=16.0)
    return replace(config, **changes)


CONVERGING = RigConfig(
    left_rotation_deg=(0.3, 0.8, -0.4), right_rotation_deg=(-0.2, -0.7, 0.5))
DISTORTED = RigConfig(
    left_rotation_deg=(0.3, 0.8, -0.4), right_rotation_deg=(-0.2, -0.7, 0.5),
    right_f_px=1785.0,
    left_coefficients=(-0.22, 0.15, 4e-4, -3e-4, 0.0),
    right_coefficients=(-0.20, 0.11, -3e-4, 5e-4, 0.0))
RATIONAL = replace(
    DISTORTED, model='rational_polynomial',
    left_coefficients=(0.18, -0.12, 4e-4, -3e-4, 0.02, 0.40, -0.05, 0.01),
    right_coefficients=(0.15, -0.10, -3e-4, 5e-4, 0.01, 0.36, -0.04, 0.01))
EQUIDISTANT = replace(
    DISTORTED, model='equidistant',
    left_coefficients=(0.02, -0.01, 0.003, 0.0), right_coefficients=(0.015, -0.008, 0.002, 0.0))
RIGS = {'parallel': RigConfig(), 'converging': CONVERGING, 'distorted': DISTORTED,
        'rational': RATIONAL, 'equidistant': EQUIDISTANT}
