# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated vehicles on their springs, and riders who lean into bends."""
from __future__ import annotations

import argparse
from dataclasses import replace
import math

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.cli import simulate
from stereo_speed.lab.evaluation.random_passes import draw_pass
from stereo_speed.lab.sim.bodies import BODIES
from stereo_speed.lab.sim.config import circle_config, SimConfig
from stereo_speed.lab.sim.ride import lean_rad, LEVEL, ROUGHNESS_M3, Springs, with_ride
from stereo_speed.lab.sim.scene import SimScene
from stereo_speed.lab.sim.street import body_box, looks_of, vehicle_item

CAR = BODIES['car']
CLASS_C = ROUGHNESS_M3['C']


def _springs(speed_mps, seeds, body=CAR):
    return [Springs(CLASS_C, body, speed_mps, np.random.default_rng(seed)) for seed in seeds]


@pytest.mark.parametrize('speed_mps', [5.0, 30.0])
def test_axle_rises_as_much_as_that_of_a_quarter_car(speed_mps):
    """Compare with the integral of the road's density times the squared transmissibility."""
    rises = []
    for springs in _springs(speed_mps, range(600), BODIES['motorcycle']):
        stands = springs.attitude(0.0)
        rises.append(stands.rise_m - springs.overhang_m * stands.pitch_rad)
    per_m = np.linspace(0.02, 3.0, 200_000)
    r = per_m * speed_mps / 1.3
    passes = (1 + (0.6 * r) ** 2) / ((1 - r ** 2) ** 2 + (0.6 * r) ** 2)
    density = CLASS_C * (0.1 / per_m) ** 2 * passes
    variance = np.sum((density[1:] + density[:-1]) / 2 * np.diff(per_m))
    assert abs(np.var(rises) / variance - 1) < 4 * math.sqrt(2 / 600)


def test_front_is_on_the_line_through_its_axles():
    """Both axles follow the profile, which a car without length shows, each at its own place."""
    car, point = (_springs(12.0, [3], body)[0]
                  for body in (CAR, replace(CAR, length_m=1e-9)))
    overhang_m, base_m = 0.2 * CAR.length_m, 0.6 * CAR.length_m
    for at_m in (0.0, 7.0):
        stands = car.attitude(at_m)
        near_m, far_m = (point.attitude(at_m - back_m).rise_m
                         for back_m in (overhang_m, overhang_m + base_m))
        assert stands.pitch_rad == pytest.approx((near_m - far_m) / base_m, rel=1e-6)
        assert stands.rise_m == pytest.approx(
            near_m + (near_m - far_m) * overhang_m / base_m, rel=1e-6)


def test_only_a_vehicle_of_two_tracks_rolls():
    stations = np.arange(0.0, 40.0, 2.0)
    rolls = [np.std([springs.attitude(s).roll_rad for s in stations])
             for body in (CAR, BODIES['motorcycle']) for springs in _springs(15.0, [5], body)]
    assert rolls[0] > 1e-3 and rolls[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize('curvature, speed_mps, crossfall, degrees', [
    (0.02, 15.0, 0.0, -24.65), (-0.02, 15.0, 0.0, 24.65), (0.0, 30.0, 0.0, 0.0),
    (0.01, 10.0, -0.1019368, 0.0),  # banked for this speed, so that it stands upright on the road
    (0.0, 30.0, 0.05, -2.862)])  # vertical on a road that rises to the left
def test_rider_leans_into_bends(curvature, speed_mps, crossfall, degrees):
    assert math.degrees(lean_rad(curvature, speed_mps, crossfall)) == pytest.approx(
        degrees, abs=0.005)


def _scene(config, seed=1):
    return SimScene(with_ride(config, 'C', seed))


def _attitudes(config):
    vehicle = SimScene(config).vehicles[0]
    return [vehicle.attitude(vehicle.place(t)) for t in (0.0, 0.3)]


def test_each_drawn_pass_has_a_road_of_its_own():
    passes = [_attitudes(draw_pass(seed, number, ride='C').config)
              for seed, number in ((0, 0), (0, 3), (1, 0), (0, 0))]
    assert passes[0] == passes[3]
    assert passes[0] != passes[1] and passes[0] != passes[2]


def test_seed_of_simulate_draws_the_road(tmp_path):
    parser = argparse.ArgumentParser()
    simulate.add_arguments(parser)
    level, *rough = (_attitudes(simulate.make_config(parser.parse_args(
        ['--out', str(tmp_path / 'out'), *words]))) for words in (
        [], ['--ride', 'C', '--seed', '1'], ['--ride', 'C', '--seed', '2']))
    assert level == [LEVEL, LEVEL] and rough[0] != rough[1] and level not in rough


@pytest.mark.parametrize('receding', [(), (0,)])
@pytest.mark.parametrize('lane', [0, 1])
def test_leaning_front_is_inside_the_bend_above_its_tyres(receding, lane):
    base = circle_config('30 mph', radius_m=40.0)
    base = replace(base, road=replace(base.road, lanes=2, receding=receding if lane == 0 else ()))
    rider = replace(base.vehicles[0], kind='motorcycle', lane=lane)
    level, leaning = (SimScene(replace(base, vehicles=(replace(rider, leans=leans),)))
                      for leans in (False, True))
    pose, upright = (scene.front(scene.vehicles[0], 0.5) for scene in (leaning, level))
    np.testing.assert_array_equal(pose.ground_m, upright.ground_m)
    np.testing.assert_array_equal(pose.ground_axes, upright.axes)
    height_m = rider.clearance_m + rider.front_height_m / 2
    radius_m = 40.0 - leaning.road.lane_offset(lane)  # it bends to the left
    lean = math.atan((30 * MPH_MPS) ** 2 / radius_m / 9.81)
    left = 1 if lane == 1 or not receding else -1  # whose left is the inside
    inside = left * (pose.centre_m - pose.ground_m) @ upright.axes[:, 1]
    assert inside == pytest.approx(height_m * math.sin(lean), rel=1e-3)
    assert pose.corners_m[0] - pose.corners_m[3] == pytest.approx(
        rider.front_height_m * pose.axes[:, 2])


@pytest.mark.parametrize('receding', [(), (0,)])
def test_body_tilts_as_its_springs_say(receding):
    base = SimConfig()
    base = replace(base, road=replace(base.road, receding=receding))
    scene = _scene(base)
    vehicle = scene.vehicles[0]
    pose = scene.front(vehicle, 0.4)
    attitude = vehicle.attitude(vehicle.place(0.4))
    along = -1 if receding else 1  # of stations, relative to travel
    up = pose.ground_axes[:, 2]
    assert (pose.origin_m - pose.ground_m) @ scene.up == pytest.approx(attitude.rise_m)
    assert along * pose.axes[:, 0] @ up == pytest.approx(math.sin(attitude.pitch_rad), abs=1e-9)
    assert along * pose.axes[:, 1] @ up == pytest.approx(
        math.sin(attitude.roll_rad) * math.cos(attitude.pitch_rad), abs=1e-9)
    level = SimScene(base)
    flat = level.front(level.vehicles[0], 0.4)
    np.testing.assert_array_equal(pose.ground_m, flat.ground_m)
    np.testing.assert_array_equal(pose.ground_axes, flat.axes)


def test_feet_of_a_leaning_body_and_mirror_images_belong_to_the_road():
    base = circle_config('30 mph', radius_m=40.0)
    rider = replace(base.vehicles[0], kind='motorcycle', leans=True)
    scene = SimScene(replace(base, vehicles=(rider,)))
    pose, body = scene.front(scene.vehicles[0], 0.5), rider.body
    up = pose.ground_axes[:, 2]
    assert (body_box(body, pose)[:4] - pose.ground_m) @ up == pytest.approx(0.0, abs=1e-9)
    item = vehicle_item(scene, looks_of(body, False, np.random.default_rng(0)), pose, 0, lit=True)
    assert len(item.lamps_m)
    heights = [(places - pose.ground_m) @ up for places in (item.lamps_m, item.mirrored_m)]
    assert heights[0] == pytest.approx(-heights[1]) and heights[0].min() > 0.3


def test_leaning_car_is_refused():
    base = SimConfig()
    with pytest.raises(InputError, match='vehicle.leans'):
        replace(base, vehicles=(replace(base.vehicles[0], leans=True),))
