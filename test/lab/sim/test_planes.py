# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The fast drawing agrees with the exact one; what hides what; what is seen of a face."""
from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_speed.lab.sim import (
    circle_config, DAY, LightConfig, PersonConfig, RIGS, SimConfig, straight_config, TreeConfig)
from stereo_speed.lab.sim.appearance import BODIES, BodyLook, draw_body_size
from stereo_speed.lab.sim.items import Footprint, in_order, Item, sprite_of, Visibility
from stereo_speed.lab.sim.light import cloud_tile, Clouds, Sensor
from stereo_speed.lab.sim.planes import clip_near, Eye, Plane, Texture
from stereo_speed.lab.sim.render import draw_front, VehicleLook
from stereo_speed.lab.sim.scene import FrontPose, SimScene
from stereo_speed.lab.sim.street import Ground, Person, Tree, vehicle_item
from stereo_speed.lab.sim.view import rig_views

BACK = 60.0


def _shift(image, reference):
    mean = (image + reference) / 2
    gy, gx = np.gradient(mean)
    terms = np.stack([gx.ravel(), gy.ravel(), np.ones(gx.size), mean.ravel()], axis=1)
    return -np.linalg.lstsq(terms, (image - reference).ravel(), rcond=None)[0][:2]


@pytest.mark.parametrize('rig', ['parallel', 'distorted', 'equidistant'])
@pytest.mark.parametrize('make', [straight_config, circle_config])
def test_fast_front_agrees_with_the_exact_one(make, rig):
    scene = SimScene(make(rig=RIGS[rig]))
    vehicle = scene.config.vehicles[0]
    look = VehicleLook(vehicle, np.random.default_rng(5))
    shifts = []
    for view in rig_views(scene.seen_rig):
        eye = Eye(view)
        for t_s in (0.0, 1.4):
            pose = scene.front(vehicle, t_s)
            corners = pose.corners_m
            size = tuple(round(side / 0.004) for side in (1.8, 0.8))
            plane = Plane(corners[0], corners[1] - corners[0], corners[3] - corners[0],
                          Texture(look.levels, size), True)
            images = [np.full((768, 1024), BACK, np.float32) for _ in range(2)]
            eye.draw(images[0], plane)
            draw_front(images[1], view, look, pose)
            u0, u1, v0, v1 = eye.box(eye.project(corners), 4)
            crops = [image[v0:v1, u0:u1].astype(float) for image in images]
            shifts.append(_shift(*crops))
            assert np.abs(crops[0] - crops[1]).mean() < 2.5  # a little softer
    shifts = np.array(shifts).reshape(2, 2, 2)  # view, time, across and down
    assert np.abs(shifts).max() < 0.015
    assert np.abs(shifts[0] - shifts[1])[:, 0].max() < 7e-3  # disparity


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


def test_polygons_are_cut_before_the_camera():
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
def test_what_may_hide_what(mine, other, wanted):
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


def _pose(ground, station, offset, body):
    foot, axes = ground.at(station, offset), ground.axes(station, offset)
    left, up = axes[:, 1] * body.width_m / 2, axes[:, 2] * body.face_m / 2
    centre = foot + axes[:, 2] * (body.clearance_m + body.face_m / 2)
    corners = centre + np.stack([up - left, up + left, left - up, -left - up])
    return FrontPose(centre, axes, corners, foot)


def test_share_seen_of_a_face():
    scene = SimScene(straight_config(camera_side_m=0.0))
    ground, eye = Ground(scene), Eye(rig_views(scene.seen_rig)[0])
    rng = np.random.default_rng(0)
    car, truck = (BodyLook(BODIES[kind], False, rng) for kind in ('car', 'truck'))
    far = vehicle_item(ground, car, _pose(ground, 10.0, 0.0, car.body), 0)
    hiding = vehicle_item(ground, truck, _pose(ground, 35.0, 0.0, truck.body), 1)
    beside = vehicle_item(ground, truck, _pose(ground, 35.0, 3.7, truck.body), 2)
    seen = Visibility(eye)
    assert seen.shares([far])[0] == pytest.approx(1.0, abs=0.06)
    shares = seen.shares(in_order([hiding, far]))
    assert shares[0] == 0.0 and shares[1] == pytest.approx(1.0, abs=0.02)
    assert seen.shares(in_order([beside, far]))[0] == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize('kind', sorted(BODIES))
@pytest.mark.parametrize('rear', [False, True])
def test_faces_of_bodies_are_rectangles_that_close(kind, rear):
    rng = np.random.default_rng(1)
    body = draw_body_size(kind, rng)
    look = BodyLook(body, rear, rng)
    pose = FrontPose(np.zeros(3), np.eye(3), np.zeros((4, 3)), np.zeros(3))
    planes = look.planes(pose)
    middle = np.array([body.length_m / 2 * (1 if rear else -1), 0.0, body.roof_m / 2])
    for plane in planes:
        assert abs(plane.across_m @ plane.down_m) < 1e-9
        outward = plane.outline_m.mean(axis=0) - middle
        assert outward @ plane.normal > 0
    assert planes[-1].fine and planes[-1].normal @ [1.0 if not rear else -1.0, 0, 0] > 0
    points = np.concatenate([plane.outline_m for plane in planes])
    np.testing.assert_allclose(np.ptp(points, axis=0)[:2], [body.length_m, body.width_m])


def test_sprite_is_the_picture():
    scene = SimScene(straight_config())
    ground, eye = Ground(scene), Eye(rig_views(scene.seen_rig)[0])
    item = Person(PersonConfig(), np.random.default_rng(0)).item(ground, 0.3)
    image = np.full((768, 1024), BACK, np.float32)
    other = image.copy()
    sprite_of(eye, item).paint(image)
    for plane in item.planes:
        eye.draw(other, plane)
    np.testing.assert_allclose(image, other, atol=1e-2)
    assert np.abs(image - BACK).max() > 20


def test_people_walk_and_trees_sway():
    rng = np.random.default_rng(0)
    to_and_fro = Person(PersonConfig(station_m=20.0, speed_mps=2.0, turns_m=5.0), rng)
    places = [to_and_fro.place(t) for t in np.arange(0.0, 20.0, 0.1)]
    assert min(places) == pytest.approx(15.0, abs=0.3)
    assert max(places) == pytest.approx(25.0, abs=0.3)
    assert np.abs(np.diff(places)).max() <= 0.2 + 1e-9
    scene = SimScene(straight_config())
    ground, eye = Ground(scene), Eye(rig_views(scene.seen_rig)[0])
    tree = Tree(TreeConfig(station_m=10.0, offset_m=6.0), rng)
    images = []
    for t_s in (0.0, 0.6):
        images.append(np.full((768, 1024), BACK, np.float32))
        eye.draw(images[-1], tree.item(ground, t_s).planes[0])
    assert np.abs(images[0] - images[1]).max() > 8.0


def test_noise_and_exposure_are_as_asked():
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


def test_clouds_shade_the_ground_in_both_views_alike():
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
