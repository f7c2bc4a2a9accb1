# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The simulator's geometry: road, motion, truth, site and initial fronts."""
from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest

from stereo_speed.core.errors import InputError
from stereo_speed.lab.sim import (
    circle_config, RIGS, RoadConfig, SimConfig, straight_config, VehicleConfig)
from stereo_speed.lab.sim.kinematics import lateral_m, path_m, path_speed_mps
from stereo_speed.lab.sim.road import Road
from stereo_speed.lab.sim.scene import SimScene
from stereo_speed.lab.sim.sequence import exact_site, initial_fronts, picked_site

CLOTHOID = RoadConfig(curvature_start=0.004, curvature_end=0.035, clothoid_m=40.0, grade=0.03)
RUN_OFF = RoadConfig(curvature_start=0.02, clothoid_m=30.0, clothoid_at_m=10.0,
                     crossfall_start=-0.06, crossfall_end=0.02, turned_about_m=3.7)


@pytest.mark.parametrize('radius', [41.0, -41.0])
def test_circle_by_hand(radius):
    road = Road(RoadConfig(curvature_start=1 / radius, curvature_end=1 / radius))
    quarter = math.pi / 2 * 41.0
    np.testing.assert_allclose(road.position(quarter), [41.0, radius, 0.0], atol=1e-9)
    np.testing.assert_allclose(road.position(0.0, 2.0), [0.0, 2.0, 0.0], atol=1e-12)
    assert float(road.heading(quarter)) == pytest.approx(math.copysign(math.pi / 2, radius))


@pytest.mark.parametrize('config', [
    RoadConfig(), RoadConfig(curvature_start=1 / 41, curvature_end=1 / 41),
    RoadConfig(curvature_start=-1 / 60, curvature_end=-1 / 60), CLOTHOID, RUN_OFF,
    RoadConfig(curvature_start=-0.02, curvature_end=0.02)])
def test_station_inverts_position(config):
    road = Road(config)
    s = np.linspace(-20.0, 60.0, 81)
    for offset in (-3.0, 0.0, 5.5):
        station, found = road.station(road.position(s, np.full_like(s, offset))[:, :2])
        np.testing.assert_allclose(station, s, atol=1e-5)
        np.testing.assert_allclose(found, offset, atol=1e-5)


@pytest.mark.parametrize('config', [RoadConfig(grade=0.1), CLOTHOID, RUN_OFF])
def test_frame_equals_the_derivative(config):
    road = Road(config)
    for s, n in ((3.0, 0.0), (25.0, 3.7), (50.0, -2.0)):
        step = road.position(s + 1e-4, n) - road.position(s - 1e-4, n)
        frame = road.frame(s, n)
        np.testing.assert_allclose(frame[:, 0], step / np.linalg.norm(step), atol=1e-8)
        np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        assert np.linalg.norm(step) / 2e-4 == pytest.approx(
            float(road.length_per_station(s, n)), rel=1e-7)


def test_run_off_by_hand():
    """An arc of 50 m, then a clothoid of 30 m; the line that is not turned stays level."""
    road = Road(RUN_OFF)
    np.testing.assert_allclose(road.heading([0.0, 10.0, 25.0, 40.0, 60.0]),
                               [0.0, 0.2, 0.2 + 0.3 - 0.075, 0.5, 0.5], atol=1e-12)
    np.testing.assert_allclose(road.height([0.0, 20.0, 60.0], 3.7), 0.0, atol=1e-12)
    np.testing.assert_allclose(road.height([0.0, 25.0, 60.0], 1.7), [0.12, 0.04, -0.04])


def test_braking_to_a_stop_by_hand():
    vehicle = VehicleConfig(speed_mps=10.0, accel_mps2=-2.0)
    assert path_m(vehicle, 2.0) == pytest.approx(16.0)
    assert path_speed_mps(vehicle, 2.0) == pytest.approx(6.0)
    assert path_m(vehicle, 9.0) == pytest.approx(25.0)
    assert path_speed_mps(vehicle, 9.0) == 0.0


def test_speed_and_lateral_knots():
    vehicle = VehicleConfig(speed_knots=((0.0, 10.0), (1.0, 10.0), (3.0, 4.0)),
                            lateral_knots=((1.0, 0.0), (3.0, 3.5)), head_start_m=-2.0)
    assert path_m(vehicle, 4.0) == pytest.approx(-2.0 + 10.0 + 14.0 + 4.0)
    assert path_m(vehicle, -1.0) == pytest.approx(-12.0)
    assert [lateral_m(vehicle, t) for t in (0.0, 2.0, 9.0)] == pytest.approx([0.0, 1.75, 3.5])


@pytest.mark.parametrize('config', [
    straight_config(), circle_config(), circle_config(road=CLOTHOID),
    straight_config(road=RoadConfig(grade=-0.05))])
@pytest.mark.parametrize('lane', [0, 1])
def test_true_speed_is_the_path_speed_without_lateral_motion(config, lane):
    config = replace(config, vehicles=(replace(config.vehicles[0], lane=lane),))
    scene = SimScene(config)
    row = scene.truth(scene.vehicles[0], 0.7, config.origin_ns)
    assert row['speed'] == pytest.approx(row['path_speed'], rel=1e-6)


def test_pass_starts_and_ends_as_configured():
    config = straight_config(camera_side_m=0.0, camera_pitch_deg=0.0)
    scene = SimScene(config)
    first = scene.front(scene.vehicles[0], 0.0)
    np.testing.assert_allclose(first.centre_m, [0.0, 4.0 - 0.65, 72.0], atol=1e-9)
    np.testing.assert_allclose(first.axes[:, 0], [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(first.axes[:, 1], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(
        first.corners_m[0] - first.centre_m, [-0.9, -0.4, 0.0], atol=1e-12)


@pytest.mark.parametrize('rig', sorted(RIGS))
def test_rig_is_as_configured(rig):
    scene = SimScene(straight_config(rig=RIGS[rig]))
    assert scene.rig.baseline_m == pytest.approx(0.5)
    assert scene.rig.left.model == RIGS[rig].model
    angle = math.degrees(math.acos((np.trace(scene.rig.R) - 1) / 2))
    assert angle == pytest.approx(0.0 if rig == 'parallel' else 1.8, abs=0.2)


def test_picks_lie_on_their_lines_in_order_of_travel():
    scene = SimScene(circle_config(pick_std_px=0.0, rig=RIGS['distorted']))
    site = picked_site(scene, np.random.default_rng(0))
    assert list(site['lines']) == ['edge_right', 'line_0', 'edge_left']
    for name, offset in scene.road.line_offsets().items():
        stations = np.arange(-6.0, 60.0, 0.0005)
        points = scene.to_left(scene.road.position(stations, np.full_like(stations, offset)))
        for key, line in zip(('left_image', 'right_image'), scene.rig.project(points)[:2]):
            picks = np.array(site['lines'][name][key])
            gaps = np.linalg.norm(line[None] - picks[:, None], axis=2)
            assert len(picks) == 14
            assert np.nanmin(gaps, axis=1).max() < 0.05
            assert (np.diff(np.nanargmin(gaps, axis=1)) > 0).all()


def test_scatter_of_picks_and_initial_fronts():
    scene = SimScene(straight_config())
    rng = np.random.default_rng(3)
    true = picked_site(SimScene(straight_config(pick_std_px=0.0)), np.random.default_rng(1))
    site = picked_site(scene, np.random.default_rng(1))
    # The first line's picks start from the same draw; their scatter is as configured.
    gap = np.subtract(site['lines']['edge_right']['left_image'],
                      true['lines']['edge_right']['left_image'])
    assert 0.15 < gap.std() < 0.45
    quad = np.array(initial_fronts(scene, [0.0], rng)['vehicles'][0]['left_image'])
    corners = scene.rig.project(scene.front(scene.vehicles[0], 0.0).corners_m)[0]
    assert 0.1 < np.abs(quad - corners).max() < 3.5
    assert quad[0, 0] < quad[1, 0] and quad[0, 1] < quad[3, 1]  # clockwise from top-left


def test_exact_site_has_points():
    lines = exact_site(SimScene(straight_config()))['lines']
    points = np.array(lines['edge_left']['points_m']) - lines['edge_right']['points_m']
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 7.4, atol=1e-5)


@pytest.mark.parametrize('make, what', [
    (lambda: SimConfig(road=RoadConfig(lanes=4)), 'road.lanes'),
    (lambda: SimConfig(vehicles=(VehicleConfig(lane=2),)), 'vehicle.lane'),
    (lambda: SimConfig(vehicles=()), 'vehicles'),
    (lambda: SimConfig(start_m=10.0), 'start_m, near_m'),
    (lambda: SimConfig(fps=0.0), 'fps'),
    (lambda: SimScene(circle_config(radius_m=8.0)), 'start_m - near_m')])
def test_impossible_passes_are_refused(make, what):
    with pytest.raises(InputError, match=what):
        make()


@pytest.mark.parametrize('moved, centre_du, centre_dv', [
    ((0.1, 0.0, 0.0), -1.0, 0.0), ((0.0, 0.1, 0.0), 0.0, 1.0), ((0.0, 0.0, 0.1), 0.0, 0.0)])
def test_moved_right_camera_by_hand(moved, centre_du, centre_dv):
    scene = SimScene(straight_config(rig_moved_deg=moved))
    still = SimScene(straight_config())
    np.testing.assert_array_equal(scene.rig.R, still.rig.R)
    np.testing.assert_allclose(-scene.seen_rig.R.T @ scene.seen_rig.t, [0.5, 0.0, 0.0],
                               atol=1e-12)
    shift = 1800.0 * math.tan(math.radians(0.1))
    point = np.array([0.5, 0.0, 50.0])  # on the right camera's axis
    uv = scene.seen_rig.project(point)[1] - still.rig.project(point)[1]
    np.testing.assert_allclose(uv, [centre_du * shift, centre_dv * shift], atol=1e-6)
    off = point + [10.0, 0.0, 0.0]  # 360 px to its right: a clockwise roll lifts it
    uv = scene.seen_rig.project(off)[1] - still.rig.project(off)[1]
    if moved[2]:
        assert uv[1] == pytest.approx(-360.0 * math.sin(math.radians(0.1)))


def test_picks_and_initial_fronts_are_of_the_displaced_camera():
    config = straight_config(pick_std_px=0.0, init_std_px=0.0)
    sites = [picked_site(SimScene(c), np.random.default_rng(0))
             for c in (config, replace(config, rig_moved_deg=(0.0, 0.1, 0.0)))]
    left, right = ([np.array(s['lines']['edge_right'][k]) for s in sites]
                   for k in ('left_image', 'right_image'))
    np.testing.assert_array_equal(*left)
    # Where the line leaves the image moves along; the line itself lies 3.1 px lower.
    v = np.linspace(350.0, 650.0, 5)
    rows = [np.interp(v, *line.T[::-1]) for line in (right[0], right[1] - [0.0, 3.14])]
    np.testing.assert_allclose(*rows, atol=0.1)
    quads = [np.array(initial_fronts(SimScene(c), [0.0], np.random.default_rng(0))[
        'vehicles'][0]['right_image'])
        for c in (config, replace(config, rig_moved_deg=(0.0, 0.1, 0.0)))]
    np.testing.assert_allclose(quads[1] - quads[0], [[0.0, 3.14]] * 4, atol=0.05)
