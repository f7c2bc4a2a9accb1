# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated vehicles on their springs, and riders who lean into bends."""
from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from stereo_speed.core.units import MPH_MPS
from stereo_speed.lab.sim.bodies import BODIES
from stereo_speed.lab.sim.config import circle_config, SimConfig
from stereo_speed.lab.sim.ride import lean_rad, ROUGHNESS_M3, Springs, with_ride
from stereo_speed.lab.sim.scene import SimScene

CAR = BODIES['car']
CLASS_C = ROUGHNESS_M3['C']


def _springs(speed_mps, seeds, body=CAR):
    return [Springs(CLASS_C, body, speed_mps, np.random.default_rng(seed)) for seed in seeds]


@pytest.mark.parametrize('speed_mps', [5.0, 30.0])
def test_body_rises_as_much_as_a_quarter_car(speed_mps):
    """Compare with the integral of the road's density times the squared transmissibility."""
    body = replace(CAR, length_m=0.01)  # its front is above its wheels
    rises = [s.attitude(0.0).rise_m for s in _springs(speed_mps, range(600), body)]
    per_m = np.linspace(0.02, 3.0, 200_000)
    r = per_m * speed_mps / 1.3
    passes = (1 + (0.6 * r) ** 2) / ((1 - r ** 2) ** 2 + (0.6 * r) ** 2)
    density = CLASS_C * (0.1 / per_m) ** 2 * passes
    variance = np.sum((density[1:] + density[:-1]) / 2 * np.diff(per_m))
    # Less by the short waves that differ left and right, whose mean the front follows.
    assert 0.75 < np.var(rises) / variance < 1 + 4 * math.sqrt(2 / 600)


def test_slow_body_follows_the_road():
    """At walking speed both axles follow the same profile, each at its place."""
    springs = _springs(0.01, [3])[0]
    overhang_m, base_m = 0.2 * CAR.length_m, 0.6 * CAR.length_m

    def axle_m(at_m):
        attitude = springs.attitude(at_m + overhang_m)  # its near axle is at at_m
        return attitude.rise_m - overhang_m * attitude.pitch_rad
    for at_m in (0.0, 7.0):
        pitch = springs.attitude(at_m + overhang_m).pitch_rad
        assert pitch * base_m == pytest.approx(axle_m(at_m) - axle_m(at_m - base_m), abs=1e-12)


def test_only_a_vehicle_of_two_tracks_rolls():
    stations = np.arange(0.0, 40.0, 2.0)
    rolls = [np.std([springs.attitude(s).roll_rad for s in stations])
             for body in (CAR, BODIES['motorcycle']) for springs in _springs(15.0, [5], body)]
    assert rolls[0] > 1e-3 and rolls[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize('curvature, speed_mps, crossfall, degrees', [
    (0.02, 15.0, 0.0, -24.64), (-0.02, 15.0, 0.0, 24.64), (0.0, 30.0, 0.0, 0.0),
    (0.01, 10.0, -0.1019368, 0.0),  # banked for this speed, so that it stands upright on the road
    (0.0, 30.0, 0.05, -2.862)])  # vertical on a road that rises to the left
def test_rider_leans_into_bends(curvature, speed_mps, crossfall, degrees):
    assert math.degrees(lean_rad(curvature, speed_mps, crossfall)) == pytest.approx(
        degrees, abs=0.005)


def _scene(config, road_class='C'):
    return SimScene(with_ride(config, road_class))


def test_leaning_front_is_inside_the_bend_above_its_tyres():
    base = circle_config('30 mph', radius_m=40.0)
    rider = replace(base.vehicles[0], kind='motorcycle')
    smooth = with_ride(replace(base, vehicles=(rider,)), 'C')
    scene = SimScene(replace(smooth, road=replace(smooth.road, roughness_m3=0.0)))
    pose = scene.front(scene.vehicles[0], 0.5)
    level = SimScene(base).front(SimScene(base).vehicles[0], 0.5)
    np.testing.assert_allclose(pose.ground_m, level.ground_m, atol=1e-9)
    height_m = rider.clearance_m + rider.front_height_m / 2
    lean = math.atan((30 * MPH_MPS) ** 2 / 40.0 / 9.81)
    inside = (pose.centre_m - pose.ground_m) @ level.axes[:, 1]  # bends to the left
    assert inside == pytest.approx(height_m * math.sin(lean), abs=1e-6)
    assert pose.corners_m[0] - pose.corners_m[3] == pytest.approx(
        rider.front_height_m * pose.axes[:, 2])


@pytest.mark.parametrize('receding', [(), (0,)])
def test_body_tilts_as_its_springs_say(receding):
    base = SimConfig()
    scene = _scene(replace(base, road=replace(base.road, receding=receding)))
    level = SimScene(replace(base, road=replace(base.road, receding=receding)))
    vehicle, still = scene.vehicles[0], level.vehicles[0]
    pose, flat = scene.front(vehicle, 0.4), level.front(still, 0.4)
    attitude = vehicle.attitude(vehicle.place(0.4))
    along = -1 if receding else 1  # of stations, relative to travel
    assert (pose.ground_m - flat.ground_m) @ scene.up == pytest.approx(attitude.rise_m)
    assert along * pose.axes[:, 0] @ flat.axes[:, 2] == pytest.approx(
        math.sin(attitude.pitch_rad), abs=1e-9)
    assert along * pose.axes[:, 1] @ flat.axes[:, 2] == pytest.approx(
        math.sin(attitude.roll_rad) * math.cos(attitude.pitch_rad), abs=1e-9)


def test_truth_does_not_depend_on_the_ride():
    """The speed over ground is that of the place below the front."""
    base = circle_config('30 mph', radius_m=40.0)
    rough, level = (scene.truth(scene.vehicles[0], 0.5, 0)['speed']
                    for scene in (_scene(base), SimScene(base)))
    assert rough == level
