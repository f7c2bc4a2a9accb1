# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Planes, their order and occlusion; people, trees, clouds and noise."""
from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_speed.lab.sim import (
    DAY, LightConfig, PersonConfig, RoadConfig, SimConfig, straight_config, TreeConfig)
from stereo_speed.lab.sim.appearance import Appearance
from stereo_speed.lab.sim.bodies import BODIES, draw_body_size
from stereo_speed.lab.sim.items import Footprint, in_order, Item, Visibility
from stereo_speed.lab.sim.light import cloud_tile, Clouds, Sensor
from stereo_speed.lab.sim.planes import clip_near, Eye, Plane, Texture
from stereo_speed.lab.sim.scene import Place, SimScene, Vehicle
from stereo_speed.lab.sim.street import Person, Tree, vehicle_item
from stereo_speed.lab.sim.view import rig_views

BACK = 60.0


def test_plain_plane_covers_its_area():
    scene = SimScene(straight_config())
    eye = Eye(rig_views(scene.seen_rig)[0])
    for fine in (False, True):
        plane = Plane(np.array([-1.03, -0.41, 30.0]), np.array([2.0, 0.3, 0.4]),
                      np.cross([2.0, 0.3, 0.4], [0.0, 0.1, -1.0]) / -2.0, Texture.plain(100.0),
                      fine)
        assert abs(plane.across_m @ plane.down_m) < 1e-12
        image = np.zeros((768, 1024), np.float32)
        eye.draw(image, plane)
        area = cv2.contourArea(eye.project(plane.outline_m).astype(np.float32))
        assert float(image.sum()) / 100 == pytest.approx(area, rel=3e-3)


def test_polygons_are_clipped_before_the_camera():
    square = np.array([[0.0, 0, -1], [1, 0, -1], [1, 0, 3], [0, 0, 3]])
    cut = clip_near(square, 1.0)
    np.testing.assert_allclose(sorted(cut[:, 2]), [1, 1, 3, 3])
    np.testing.assert_allclose(sorted(cut[:, 0]), [0, 0, 1, 1])
    assert len(clip_near(square - [0, 0, 9.0])) == 0


@pytest.mark.parametrize('mine, other, wanted', [
    (((20, 25), (0, 2)), ((10, 14), (0, 2)), 1),  # farther in the same lane
    (((10, 14), (0, 2)), ((20, 25), (0, 2)), -1),
    (((10, 25), (4, 6)), ((12, 16), (1, 3)), 1),  # beside a long one, away from the camera
    (((12, 16), (1, 3)), ((10, 25), (4, 6)), -1),
    (((10, 25), (-6, -4)), ((12, 16), (1, 3)), 0),  # the camera looks between them
])
def test_possible_occluders(mine, other, wanted):
    assert Footprint(*mine).behind(Footprint(*other)) == wanted


def test_order_of_painting():
    def item(along, across):
        return Item(Footprint(along, across), [], np.zeros((0, 3)))
    truck, beside, ahead, behind = (item((10, 22), (1, 3.5)), item((14, 18), (5, 7)),
                                    item((4, 8), (1, 3)), item((30, 34), (1, 3)))
    for seed in range(6):
        items = [truck, beside, ahead, behind]
        np.random.default_rng(seed).shuffle(items)
        order = in_order(items)
        assert order.index(behind) < order.index(truck) < order.index(ahead)
        assert order.index(beside) < order.index(truck)


def _item(scene, kind, station, offset, number):
    body = BODIES[kind]
    place = Place(station, offset, 0, 0.0, 0.0)
    appearance = Appearance(body, False, np.random.default_rng(0))
    return vehicle_item(scene, appearance, scene.front(
        Vehicle(number, body, lambda _: place), 0.0), number)


def test_visible_share_of_a_front():
    scene = SimScene(straight_config(camera_side_m=0.0))
    eye = Eye(rig_views(scene.seen_rig)[0])
    far = _item(scene, 'car', 10.0, 0.0, 0)
    hiding = _item(scene, 'truck', 35.0, 0.0, 1)
    beside = _item(scene, 'truck', 35.0, 3.7, 2)
    seen = Visibility(eye)
    assert seen.shares([far])[0] == pytest.approx(1.0, abs=0.06)
    shares = seen.shares(in_order([hiding, far]))
    assert shares[0] == 0.0 and shares[1] == pytest.approx(1.0, abs=0.02)
    assert seen.shares(in_order([beside, far]))[0] == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize('kind', sorted(set(BODIES) - {'motorcycle'}))
@pytest.mark.parametrize('rear', [False, True])
def test_planes_of_bodies_are_closed_rectangles(kind, rear):
    rng = np.random.default_rng(1)
    body = draw_body_size(kind, rng)
    scene = SimScene(straight_config(road=RoadConfig(receding=(0,) if rear else ())))
    place = Place(20.0, 0.0, 0, 10.0, 0.0)
    pose = scene.front(Vehicle(0, body, lambda _: place), 0.0)
    planes = Appearance(body, rear, rng).planes(pose)
    assert pose.rear == rear
    assert planes[-1].fine and planes[-1].normal @ pose.axes[:, 0] * (-1 if rear else 1) > 0
    np.testing.assert_allclose(planes[-1].outline_m, pose.corners_m)
    assert len(planes) == (1 if not kind else 7 if kind == 'truck' else 8)
    ahead = body.length_m / 2 * (1 if rear else -1)
    middle = pose.ground_m + pose.axes @ [ahead, 0.0, body.roof_m / 2]
    for plane in planes:
        assert abs(plane.across_m @ plane.down_m) < 1e-9
        assert not kind or (plane.outline_m.mean(axis=0) - middle) @ plane.normal > 0
    points = np.concatenate([plane.outline_m for plane in planes]) @ pose.axes
    np.testing.assert_allclose(np.ptp(points, axis=0)[:2], [body.length_m, body.width_m],
                               atol=1e-9)


def test_people_walk_and_trees_sway():
    rng = np.random.default_rng(0)
    to_and_fro = Person(PersonConfig(station_m=20.0, speed_mps=2.0, turns_m=5.0), rng)
    places = [to_and_fro.place(t) for t in np.arange(0.0, 20.0, 0.1)]
    assert min(places) == pytest.approx(15.0, abs=0.3)
    assert max(places) == pytest.approx(25.0, abs=0.3)
    assert np.abs(np.diff(places)).max() <= 0.2 + 1e-9
    scene = SimScene(straight_config())
    eye = Eye(rig_views(scene.seen_rig)[0])
    tree = Tree(TreeConfig(station_m=10.0, offset_m=6.0), rng)
    images = []
    for t_s in (0.0, 0.6):
        images.append(np.full((768, 1024), BACK, np.float32))
        eye.draw(images[-1], tree.item(scene, t_s).planes[0])
    assert np.abs(images[0] - images[1]).max() > 8.0


def test_noise_and_exposure_are_as_configured():
    config = SimConfig(noise_grey=3.0, right_gain=0.9, right_offset_grey=5.0, exposure=0.5)
    sensor = Sensor(config, LightConfig(drift=0.1), np.random.default_rng(0))
    image = np.full((768, 1024), 100.0, np.float32)
    left, right = (sensor.expose(image, side, 0.0).astype(float) for side in (0, 1))
    gain = sensor.exposure(0.0)
    assert left.std() == pytest.approx(3.0, rel=0.02)
    assert left.mean() == pytest.approx(100 * gain, abs=0.05)
    assert right.mean() == pytest.approx(90 * gain + 2.5, abs=0.05)
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.01
    gains = [sensor.exposure(t) for t in np.arange(0, 300.0, 1.0)]
    assert 0.45 <= min(gains) < 0.48 and 0.52 < max(gains) <= 0.55


def test_clouds_shade_the_ground_equally_in_both_views():
    scene = SimScene(straight_config(light=DAY))
    tile = cloud_tile(np.random.default_rng(3))
    eyes = [Eye(view) for view in rig_views(scene.seen_rig)]
    clouds = [Clouds(scene, eye, DAY, tile) for eye in eyes]
    gains = np.array([[c.gain(t) for c in clouds] for t in (0.0, 20.0, 40.0)])
    assert gains.min() >= 1 - DAY.cloud_depth - 1e-6 and gains.max() <= 1.0
    assert gains.min() < 0.75 and np.abs(gains[0, 0] - gains[1, 0]).max() > 0.2
    assert np.abs(gains[0, 0, 0] - 1.0).max() == 0.0  # the sky's top row
    points = np.array([scene.to_left(scene.road.position(s, 0.0)) for s in (5.0, 25.0, 50.0)])
    left, right = (eye.project(points).round().astype(int) for eye in eyes)
    np.testing.assert_allclose(gains[:, 0, left[:, 1], left[:, 0]],
                               gains[:, 1, right[:, 1], right[:, 0]], atol=0.03)
