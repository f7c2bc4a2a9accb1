# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Every field of the simulator's configs changes the images, the stamps or the files."""
from __future__ import annotations

from dataclasses import fields, replace
from functools import lru_cache

import numpy as np
import pytest
from stereo_speed.lab.sim.arrivals import TrafficFlow
from stereo_speed.lab.sim.bodies import BODIES, BodyConfig
from stereo_speed.lab.sim.config import RigConfig, RoadConfig, SimConfig, VehicleConfig
from stereo_speed.lab.sim.items import paint
from stereo_speed.lab.sim.optics import FaultConfig, LensConfig
from stereo_speed.lab.sim.planes import Eye
from stereo_speed.lab.sim.props import (
    LightConfig, ParkedConfig, PersonConfig, PoleConfig, StreetLampConfig, TreeConfig)
from stereo_speed.lab.sim.scene import Place, SimScene, Vehicle
from stereo_speed.lab.sim.sequence import simulate
from stereo_speed.lab.sim.street import looks_of, vehicle_item
from stereo_speed.lab.sim.traffic_config import TrafficConfig
from stereo_speed.lab.sim.view import rig_views

TINY = RigConfig(width_px=96, height_px=72, f_px=168.0)
LIGHT = LightConfig(sun_elevation_deg=40.0, cloud_depth=0.5, cloud_m=20.0, drift=0.3)
PLAIN = SimConfig(rig=TINY, pairs=2, fps=2.0, right_turn_deg=(0.4, 0.0, 0.0),
                  right_turn_s=0.3)
FURNISHED = replace(
    PLAIN, light=LIGHT, poles=(PoleConfig(ahead_m=14.0, right_m=1.8),),
    people=(PersonConfig(turns_m=0.5),), trees=(TreeConfig(),), parked=(ParkedConfig(),),
    street_lamps=(StreetLampConfig(),), lens=LensConfig(core_px=0.5, halo_share=0.1, halo_px=8.0),
    faults=FaultConfig(exposure_step=0.1, right_defocus_px=1.0, dirt=3))
SOLID = replace(FURNISHED, vehicles=(VehicleConfig(solid=True, lamp_grey=300.0, gloss=0.3),))

# Another value for every field; the files, for fields that do not affect images.
RIG = {
    'width_px': 100, 'height_px': 70, 'f_px': 180.0, 'right_f_px': 160.0, 'baseline_m': 0.8,
    'left_rotation_deg': (0.5, 0.0, 0.0), 'right_rotation_deg': (0.0, 0.5, 0.0),
    'model': 'equidistant', 'left_coefficients': (-0.3, 0.0, 0.0, 0.0, 0.0),
    'right_coefficients': (-0.3, 0.0, 0.0, 0.0, 0.0)}
ROAD = {
    'curvature_start': -0.02, 'curvature_end': 0.06, 'clothoid_m': 20.0, 'grade': 0.03,
    'lanes': 3, 'lane_width_m': 3.2, 'marking_width_m': 0.4, 'dash_m': 5.0, 'gap_m': 2.0,
    'receding': (0,), 'grade_end': -0.05, 'vertical_curve_m': 20.0, 'vertical_curve_at_m': 5.0,
    'crossfall_start': 0.06, 'crossfall_end': 0.06, 'clothoid_at_m': 9.0, 'turned_about_m': 3.7,
    'dashed_edges': True, 'wear': 0.8, 'roughness_m3': 1e-3}
VEHICLE = {
    'speed_mps': 20.0, 'accel_mps2': -4.0, 'speed_knots': ((0.0, 20.0), (1.0, 15.0)), 'lane': 1,
    'lateral_knots': ((0.0, 0.0), (1.0, 2.0)), 'head_start_m': 5.0, 'front_width_m': 1.4,
    'front_height_m': 1.2, 'clearance_m': 0.7, 'texture_contrast': 0.4, 'relief_m': 0.1,
    'kind': 'van', 'solid': True}
LOOKS = {'lamp_grey': 3000.0, 'gloss': 1.0}
SIM = {
    'vehicles': (VehicleConfig(), VehicleConfig(lane=1)), 'road': RoadConfig(lanes=1),
    'rig': replace(TINY, f_px=150.0), 'start_m': 60.0, 'near_m': 20.0, 'camera_height_m': 5.0,
    'camera_side_m': 3.0, 'camera_pitch_deg': 9.0, 'camera_yaw_deg': 2.0, 'pairs': 1,
    'noise_grey': 4.0, 'right_gain': 0.8, 'right_offset_grey': 9.0, 'exposure': 0.5,
    'rig_moved_deg': (0.5, 0.0, 0.0), 'right_delay_s': 0.1, 'drop': (1,), 'fps': 4.0,
    'gaps_s': ((0.4, 0.9),), 'stamp_jitter_s': 0.05, 'poles': FURNISHED.poles,
    'people': (PersonConfig(),), 'trees': (TreeConfig(),), 'parked': (ParkedConfig(),),
    'light': LIGHT, 'street_lamps': FURNISHED.street_lamps, 'lens': FURNISHED.lens,
    'faults': FURNISHED.faults, 'sway_deg': 0.5, 'right_turn_deg': (0.0, 0.5, 0.0),
    'right_turn_s': None}
STAMPS = {'origin_ns': 5_000_000, 'right_stamp_jitter_s': 0.01}
FILES = {'picks': 5, 'pick_std_px': 2.0, 'init_std_px': 3.0, 'speed_limit': '30 mph',
         'name': 'another'}
POLE = {'ahead_m': 20.0, 'right_m': 0.0, 'radius_m': 0.4, 'height_m': 5.0, 'grey': 200.0}
PERSON = {'station_m': 30.0, 'offset_m': -2.0, 'speed_mps': -3.0, 'height_m': 1.2,
          'turns_m': None}
TREE = {'station_m': 30.0, 'offset_m': 10.0, 'height_m': 4.0, 'sway_m': 2.0, 'period_s': 1.3}
PARKED = {'station_m': 20.0, 'offset_m': -3.0, 'kind': 'truck'}
SKY = {'sun_elevation_deg': 20.0, 'sun_azimuth_deg': -60.0, 'shadow': 0.9, 'headlights': True,
       'cloud_depth': 0.1, 'cloud_m': 60.0, 'wind_mps': (40.0, -20.0), 'drift': 0.05,
       'drift_period_s': 3.0, 'ambient': 0.4, 'wet': 1.0}
STREET_LAMP = {'station_m': 30.0, 'offset_m': 3.0, 'height_m': 4.0, 'grey': 500.0}
LENS = {'core_px': 1.0, 'halo_share': 0.3, 'halo_px': 4.0, 'gamma': 2.2}
FAULTS = {'exposure_step': 0.3, 'right_defocus_px': 2.0, 'dirt': 9, 'dirt_depth': 0.9,
          'dirt_px': 9.0}


@lru_cache(maxsize=4)
def _outcome(config):
    sequence = simulate(config, np.random.default_rng(3))
    pictures = b''.join(image.tobytes() for p in sequence.pairs for image in (p.left, p.right))
    stamps = [(p.stamp_ns, p.right_stamp_ns) for p in sequence.pairs]
    return pictures, stamps, (sequence.site, sequence.init)


def _within(outer, name):
    """Return the function that replaces fields of a config in a tuple of another one."""
    return lambda changes: replace(outer, **{name: (replace(getattr(outer, name)[0], **changes),)})


def _inside(outer, name):
    return lambda changes: replace(outer, **{name: replace(getattr(outer, name), **changes)})


# A short bend: the search for its stations takes little time.
BEND = replace(PLAIN, start_m=32.0, road=RoadConfig(
    curvature_start=0.04, curvature_end=0.05, crossfall_end=0.02, grade_end=0.04))
RIDDEN = replace(BEND, vehicles=(VehicleConfig(kind='motorcycle'),))
SWEEP = [
    *((RigConfig, name, _inside(PLAIN, 'rig'), value) for name, value in RIG.items()),
    *((RoadConfig, name, _inside(BEND, 'road'), value) for name, value in ROAD.items()),
    *((VehicleConfig, name, _within(FURNISHED, 'vehicles'), value)
      for name, value in VEHICLE.items()),
    *((VehicleConfig, name, _within(SOLID, 'vehicles'), value) for name, value in LOOKS.items()),
    (VehicleConfig, 'leans', _within(RIDDEN, 'vehicles'), True),
    (RoadConfig, 'roughness_seed', _inside(replace(
        BEND, road=replace(BEND.road, roughness_m3=1e-3)), 'road'), 7),
    *((StreetLampConfig, name, _within(FURNISHED, 'street_lamps'), value)
      for name, value in STREET_LAMP.items()),
    *((LensConfig, name, _inside(FURNISHED, 'lens'), value) for name, value in LENS.items()),
    *((FaultConfig, name, _inside(FURNISHED, 'faults'), value) for name, value in FAULTS.items()),
    *((SimConfig, name, lambda c: replace(PLAIN, **c), value)
      for part in (SIM, STAMPS, FILES) for name, value in part.items()),
    (SimConfig, 'sway_hz', lambda c: replace(PLAIN, sway_deg=0.5, **c), 3.0),
    *((PoleConfig, name, _within(FURNISHED, 'poles'), value) for name, value in POLE.items()),
    *((PersonConfig, name, _within(FURNISHED, 'people'), value)
      for name, value in PERSON.items()),
    *((TreeConfig, name, _within(FURNISHED, 'trees'), value) for name, value in TREE.items()),
    *((ParkedConfig, name, _within(FURNISHED, 'parked'), value)
      for name, value in PARKED.items()),
    *((LightConfig, name, _inside(FURNISHED, 'light'), value) for name, value in SKY.items())]


@pytest.mark.parametrize('of, name, change, value', SWEEP,
                         ids=[f'{of.__name__}.{name}' for of, name, *_ in SWEEP])
def test_field_has_the_effect_it_describes(of, name, change, value):
    base, other = _outcome(change({})), _outcome(change({name: value}))
    part = 1 if name in STAMPS else 2 if name in FILES else 0
    assert base[part] != other[part]


def test_no_field_is_missing_from_the_tests():
    swept = {(of, name) for of, name, *_ in SWEEP}
    assert swept == {(of, f.name) for of, *_ in SWEEP for f in fields(of)}


BODY = {'length_m': 7.0, 'width_m': 1.5, 'roof_m': 4.0, 'front_m': 1.2, 'rear_m': 1.4,
        'clearance_m': 0.6, 'bonnet_m': 0.8, 'screen_m': 0.3, 'cab_m': 1.5, 'relief_m': 0.1,
        'contrast': 0.4}


@lru_cache(maxsize=None)
def _scene(receding):
    return SimScene(replace(PLAIN, road=RoadConfig(receding=receding)))


def _picture(body, receding=()):
    """Paint a body some way ahead."""
    scene = _scene(receding)
    place = Place(30.0, 0.0, 0, 10.0, 0.0)
    appearance = looks_of(body, bool(receding), np.random.default_rng(0))
    item = vehicle_item(scene, appearance, scene.front(Vehicle(0, body, lambda _: place), 0.0))
    image = np.zeros((72, 96), np.float32)
    paint(image, Eye(rig_views(scene.rig)[0]), item)
    return image


@pytest.mark.parametrize('receding', [(), (0,)])
@pytest.mark.parametrize('kind', sorted(BODIES))
def test_relief_contrast_and_size_are_drawn_for_every_kind(kind, receding):
    base = _picture(VehicleConfig(kind=kind).body, receding)
    for name in ('texture_contrast', 'relief_m', 'front_width_m', 'front_height_m',
                 'clearance_m'):
        other = _picture(VehicleConfig(kind=kind, **{name: VEHICLE[name]}).body, receding)
        assert np.abs(other - base).max() > 2.0, name


def test_every_size_of_a_body_is_drawn():
    # Fields that only matter under a sky are tested as fields of the vehicle.
    names = {field.name for field in fields(BodyConfig)}
    assert set(BODY) | {'kind', 'solid'} | set(LOOKS) == names
    for name, value in BODY.items():
        kind, receding = 'truck' if name == 'cab_m' else 'car', (0,) if name == 'rear_m' else ()
        base, other = (_picture(body, receding) for body in (
            BODIES[kind], replace(BODIES[kind], **{name: value})))
        assert np.abs(other - base).max() > 1.0, name
    assert len({_picture(body).tobytes() for body in BODIES.values()}) == len(BODIES)


TRAFFIC = {
    'scene': SimConfig(road=RoadConfig(lanes=3, receding=(2,))), 'minutes': 2.0, 'vehicles': 60,
    'lane_speeds_mps': (15.0, 18.0, 20.0), 'lane_shares': (1.0, 0.1, 0.1), 'speed_std_mps': 0.1,
    'kinds': (('truck', 1.0),), 'solid': True, 'follow_share': 0.9, 'headway_s': (2.0, 3.0),
    'change_share': 1.0, 'change_s': (5.0, 9.0), 'brake_share': 0.9, 'hardest_g': 0.2,
    'before_s': 30.0, 'clear_s': 1.0}


def test_every_traffic_field_changes_the_drivers():
    assert set(TRAFFIC) == {field.name for field in fields(TrafficConfig)}
    base = TrafficConfig(
        scene=SimConfig(road=RoadConfig(lanes=3)), minutes=1.0, vehicles=30, change_share=0.5,
        brake_share=0.5)

    def drivers(config):
        flow = TrafficFlow(config, dict.fromkeys(range(3), (225.0, 280.0)),
                           dict.fromkeys(range(3), 320.0), np.random.default_rng(0))
        flow.advance(10.0)
        return [(d.number, d.x_m, d.v_mps, d.lane_place(10.0), d.body) for d in flow.drivers]
    true = drivers(base)
    for name, value in TRAFFIC.items():
        assert drivers(replace(base, **{name: value})) != true, name
