# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Planes across a lane: interpolated pixels against exact ones, rates against displacements."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.detection.lane_geometry import LaneGeometry
from stereo_speed.lab.sim.config import circle_config, RIGS, straight_config
from stereo_speed.lab.sim.scene import SimScene
from stereo_speed.lab.sim.sequence import picked_site
from stereo_speed.road.lanes import LanePath
from stereo_speed.road.path import StraightPath
from stereo_speed.site.file import load_site
from stereo_speed.site.lane_paths import lane_paths
import yaml

REACH_M = np.linspace(-1.8, 1.8, 121)
HEIGHTS_M = np.linspace(1.25, 0.27, 9)


@pytest.fixture(scope='module', params=[
    straight_config(), circle_config(radius_m=41.0, rig=RIGS['distorted'])],
    ids=['straight', 'distorted'])
def geometry(request, tmp_path_factory):
    scene = SimScene(request.param)
    path = tmp_path_factory.mktemp('site') / 'site.yaml'
    path.write_text(yaml.safe_dump(dict(picked_site(scene, np.random.default_rng(1)))))
    return LaneGeometry(scene.rig, lane_paths(load_site(path), scene.rig)['lane_0'])


@pytest.fixture
def seen_m(geometry):
    seen = geometry.seen(20.0, 4.0, HEIGHTS_M)
    return seen[::max(len(seen) // 5, 1)]


@pytest.mark.parametrize('right', [False, True])
def test_interpolated_pixels_equal_exact_ones(geometry, seen_m, right):
    x = np.full(len(seen_m), 0.2)
    args = seen_m, x, REACH_M, HEIGHTS_M
    uv = geometry.right_pixels(*args, 0 * x) if right else geometry.left_pixels(*args)
    exact = geometry.project(seen_m, 0.2 + REACH_M, HEIGHTS_M)[int(right)]
    assert uv.shape == exact.shape
    assert np.abs(uv - exact).max() < 0.05


def test_points_on_the_road_project_to_the_road(geometry, seen_m):
    rig, path = geometry.rig, geometry.lane.path
    s, x = seen_m[1:2], np.array([0.2])
    reach, heights = np.array([-0.3, 0.0, 0.3]), np.array([0.6, 0.4, 0.2])
    left = geometry.left_pixels(s, x, reach, heights)[0, 1, 1]
    right = geometry.right_pixels(s, x, reach, heights, 0 * s, lying=True)[0, 1, 1]
    point = rig.triangulate(left.astype(float), right.astype(float))
    up = path.frame(s)[0, :, 2]
    assert abs((point - path.position(s)[0]) @ up) < 0.02


@pytest.mark.parametrize('ds_m', [-1.0, 1.0])
def test_rates_describe_the_effect_of_a_wrong_depth(geometry, seen_m, ds_m):
    rig, path = geometry.rig, geometry.lane.path
    s = float(seen_m[2])
    rates = geometry.rates(np.array([s]))
    point = geometry.points(np.array([s]), np.array([0.0]), np.array([0.5]))[0, 0, 0]
    frame = path.frame(np.array(s))
    # the true point lies on the same left ray, ds further along
    true = point * ((point + ds_m * frame[:, 0]) @ frame[:, 0]) / (point @ frame[:, 0])
    assert (true - point) @ frame[:, 2] == pytest.approx(rates.climb[0] * ds_m, rel=0.05)
    pixel = rig.right.project(rig.to_right(true))[0]
    x_m = np.linspace(-1.0, 1.0, 2001)
    row = geometry.project(np.array([s]), x_m, np.array([0.5]))[1][0, 0]
    seen_at = x_m[np.argmin(np.abs(row[:, 0] - pixel[0]))]
    assert seen_at == pytest.approx(rates.shift[0] * ds_m, rel=0.1, abs=2e-3)


@pytest.mark.parametrize('gone_m', [-0.5, 1.0])
def test_forward_motion_slides_in_the_right_view(geometry, seen_m, gone_m):
    rig, s = geometry.rig, float(seen_m[2])
    slide = geometry.rates(np.array([s])).slide[0]
    height = np.array([0.5])
    there = geometry.points(np.array([s + gone_m]), np.array([0.0]), height)[0, 0, 0]
    pixel = rig.right.project(rig.to_right(there))[0]
    x_m = np.linspace(-1.5, 1.5, 3001)
    row = geometry.project(np.array([s]), x_m, height)[1][0, 0]
    seen_at = x_m[np.argmin(np.abs(row[:, 0] - pixel[0]))]
    assert seen_at == pytest.approx(slide * gone_m, rel=0.15, abs=4e-3)


def test_moved_point_equals_the_point_of_the_moved_plane(geometry, seen_m):
    s, x = seen_m[1:2], np.array([0.2])
    place = x, REACH_M, HEIGHTS_M
    ahead = np.array([0.7])
    assert np.array_equal(geometry.right_pixels(s, *place, ahead),
                          geometry.right_pixels(s + ahead, *place, 0 * ahead))
    lying = [geometry.right_pixels(s, *place, a, lying=True) for a in (ahead, 0 * ahead)]
    assert np.abs(lying[0] - lying[1]).max() > 1.0


def test_road_is_met_at_its_height(geometry, seen_m):
    for s in seen_m[1:4]:
        ground = geometry.points(np.array([s]), np.array([0.3]), np.array([0.0]))[0, 0]
        uv = geometry.rig.left.project(ground)[0]
        assert geometry.on_road(uv[0]) == pytest.approx(s, abs=0.02)
        assert geometry.across(float(s), uv)[0] == pytest.approx(0.3, abs=1e-6)


def test_sky_is_not_the_road(geometry):
    assert np.isnan(geometry.on_road(np.array([500.0, -5000.0])))


def test_only_large_enough_fronts_are_visible(geometry):
    near = geometry.seen(60.0, 1.4, HEIGHTS_M)
    far = geometry.seen(20.0, 1.4, HEIGHTS_M)
    assert len(near) < len(far) and set(near) <= set(far)
    assert (geometry.exact_rates(near).px_per_m >= 59.9).all()


@pytest.mark.parametrize('reverse', [False, True], ids=['approaching', 'receding'])
@pytest.mark.parametrize('x_m', [-4.0, 2.0])
def test_body_of_a_vehicle_is_seen_aslant(reverse, x_m):
    """A metre farther away than a place 30 m ahead, the ray to a point is a 31st nearer to it."""
    ahead = np.array([0.0, 0.0, 1.0 if reverse else -1.0])
    start = np.array([3.0, 2.0, 5.0 if reverse else 60.0])
    lane = LanePath('lane', StraightPath(start, ahead, 55.0, np.array([0.0, -1.0, 0.0])), None,
                    np.zeros(2), 0.0)
    s_m = 25.0 if reverse else 30.0
    frame = lane.path.frame(np.array(s_m))
    place = lane.path.position(np.array(s_m)) + x_m * frame[:, 1]
    assert place[2] == 30.0
    seen = (place + [0.0, 0.0, 1.0]) * 30.0 / 31.0  # where it is seen on the plane of the place
    shift_m = LaneGeometry(SimScene(straight_config()).rig, lane).aslant(s_m, x_m)
    assert shift_m == pytest.approx((seen - place) @ frame[:, 1], rel=0.05)
