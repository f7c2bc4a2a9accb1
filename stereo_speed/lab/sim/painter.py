# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Paints a scene at a time: only what moves, over a background painted once."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .appearance import BodyLook
from .items import glow, in_order, Item, paint, Visibility
from .light import cloud_tile, Clouds, Sensor
from .planes import Eye, Plane, Texture
from .props import LightConfig
from .scene import FrontPose, SimScene
from .scenery import render_background
from .street import body_box, Ground, parked, Person, pole, Tree, vehicle_item
from .texture import Image
from .view import rig_views
from ...core.records import Array

GLOW_GREY = 700.0  # of a lit lamp's middle, before the exposure
TAIL_GREY = 200.0
POOL_FROM_M, POOL_TO_M, POOL_HALF_M = 1.5, 26.0, 3.0
POOL_GAIN = 2.6


@dataclass(frozen=True, eq=False)
class Shown:
    """
    A vehicle to be painted.

    :param number: of the vehicle.
    :param look: what it looks like.
    :param pose: place of its tracked face.
    """

    number: int
    look: BodyLook
    pose: FrontPose


class Painter:
    """
    Everything of a scene but its vehicles, and how to paint those.

    :param scene: the scene.
    :param rng: source of textures and noise.
    """

    def __init__(self, scene: SimScene, rng: np.random.Generator) -> None:
        texture, props, noise = rng.spawn(3)
        config = scene.config
        self.light = config.light or LightConfig()
        self.ground = Ground(scene)
        views = rig_views(scene.seen_rig)
        self.eyes = (Eye(views[0]), Eye(views[1]))
        self.backgrounds = render_background(scene, views, texture)
        self.sensor = Sensor(config, config.light, noise)
        self.people = [Person(p, props) for p in config.people]
        self.trees = [Tree(t, props) for t in config.trees]
        self.still = [pole(self.ground, p, self.eyes) for p in config.poles]
        cars = [parked(self.ground, p, self.eyes, props) for p in config.parked]
        for car in cars:
            self._shade(self.backgrounds, car.hull_m)
        self.still += cars
        self.clouds: Optional[tuple[Clouds, Clouds]] = None
        if self.light.cloud_depth > 0:
            tile = cloud_tile(props)
            self.clouds = (Clouds(scene, self.eyes[0], self.light, tile),
                           Clouds(scene, self.eyes[1], self.light, tile))
        self._pool = _pool_texture()
        self._seen = (Visibility(self.eyes[0]), Visibility(self.eyes[1]))

    def paint(self, vehicles: Sequence[Shown], times_s: tuple[float, float],
              right_vehicles: Optional[Sequence[Shown]] = None,
              ) -> tuple[tuple[NDArray[np.uint8], NDArray[np.uint8]], dict[int, float]]:
        """
        Paint a pair.

        :param vehicles: in any order.
        :param times_s: exposure times, left and right.
        :param right_vehicles: where they are at the right camera's time, if another.
        :return: left and right image, and the share seen of each vehicle's face: the least of
            both views.
        """
        images, shares = [], []
        shown, items = vehicles, in_order(self._items(vehicles, times_s[0]))
        for side, eye in enumerate(self.eyes):
            if side and right_vehicles is not None:
                shown = right_vehicles
                items = in_order(self._items(shown, times_s[1]))
            images.append(self._view(side, eye, shown, items, times_s[side]))
            shares.append(self._seen[side].shares(items))
        least = {n: min(share, shares[1].get(n, 0.0)) for n, share in shares[0].items()}
        return (images[0], images[1]), least

    def _items(self, vehicles: Sequence[Shown], t_s: float) -> list[Item]:
        moving = [vehicle_item(self.ground, v.look, v.pose, v.number, self.light.headlights)
                  for v in vehicles]
        moving += [person.item(self.ground, t_s) for person in self.people]
        moving += [tree.item(self.ground, t_s) for tree in self.trees]
        return moving + self.still

    def _view(self, side: int, eye: Eye, vehicles: Sequence[Shown], items: list[Item],
              t_s: float) -> NDArray[np.uint8]:
        image = self.backgrounds[side].copy()
        for vehicle in vehicles:
            self._cast(image, eye, vehicle)
        if self.light.headlights:
            for vehicle in vehicles:
                self._light_road(image, eye, vehicle)
        for item in items:
            paint(image, eye, side, item)
            if len(item.lamps_m):
                tail = item.lamp_size_m < 0.2
                glow(image, eye, item, TAIL_GREY if tail else GLOW_GREY)
        if self.clouds is not None:
            image *= self.clouds[side].gain(t_s)
        return self.sensor.expose(image, side, t_s)

    def _cast(self, image: Image, eye: Eye, vehicle: Shown) -> None:
        """Darken the road below and beside a vehicle."""
        box = body_box(vehicle.look, vehicle.pose)
        eye.fill(image, [box[:4]], 0.45, 1.2)
        sun = self.light.sun()
        if sun is None:
            return
        up = vehicle.pose.axes[:, 2]
        body = vehicle.look.body
        outlines = [_shadow(self.ground, box[:4], up, height, share, sun)
                    for height, share in ((body.clearance_m + body.face_m, 0.0),
                                          (body.roof_m, 0.25 if not body.cab_m else 0.0))]
        eye.fill(image, outlines, 1 - self.light.shadow, 0.7)

    def _shade(self, images: Sequence[Image], hull_m: Array) -> None:
        """Darken the road below something that does not move."""
        up = self.ground.up
        low = hull_m @ up
        foot = hull_m[low < low.min() + 0.05]
        feet = foot[_ring(self.ground, foot)]
        for image, eye in zip(images, self.eyes):
            eye.fill(image, [feet], 0.45, 1.2)
            sun = self.light.sun()
            if sun is not None:
                outline = _shadow(self.ground, feet, up, 1.4, 0.0, sun)
                eye.fill(image, [outline], 1 - self.light.shadow, 0.7)

    def _light_road(self, image: Image, eye: Eye, vehicle: Shown) -> None:
        """Lay the pool of the headlights onto the road."""
        pose, look = vehicle.pose, vehicle.look
        front = look.body.length_m if look.rear else 0.0
        along, left, _ = pose.axes.T
        corner = pose.ground_m + along * (front + POOL_FROM_M) - left * POOL_HALF_M
        # Read from above, the vehicle's right at the texture's left: its top is at the vehicle.
        plane = Plane(corner, left * 2 * POOL_HALF_M, along * (POOL_TO_M - POOL_FROM_M),
                      self._pool)
        box = eye.box(eye.project(plane.outline_m))
        if box is None:
            return
        u0, u1, v0, v1 = box
        gain, _ = eye.sample(plane, box)
        image[v0:v1, u0:u1] *= 1 + gain


def _ring(ground: Ground, points_m: Array) -> NDArray[np.intp]:
    """Return the order in which points go round their hull on the ground."""
    flat = (points_m @ ground.scene.left_R_world)[:, :2].astype(np.float32)
    return np.asarray(cv2.convexHull(flat, returnPoints=False)).ravel().astype(np.intp)


def _shadow(ground: Ground, feet_m: Array, up: Array, height_m: float, inset: float,
            sun: tuple[float, float]) -> Array:
    """
    Return the outline (n, 3) of the shadow of an upright prism.

    :param feet_m: (4, 3) its footprint.
    :param inset: share by which its upper side is shorter than the lower.
    :param sun: shift of the shadow per metre of height, along and across the road.
    """
    scene = ground.scene
    shift = height_m * (scene.left_R_world @ np.array([sun[0], sun[1], 0.0]))
    middle = feet_m.mean(axis=0)
    tops = middle + (1 - inset) * (feet_m - middle) + shift
    points = np.concatenate([feet_m, tops])
    return points[_ring(ground, points)]


def _pool_texture() -> Texture:
    """Make the light of two lamps on the road: near the vehicle at the top."""
    y, x = np.mgrid[0:128, 0:64].astype(np.float32)
    x, y = (x + 0.5) / 64 - 0.5, (y + 0.5) / 128
    beams = sum(np.exp(-np.square((x - side * (0.11 + 0.12 * y)) / (0.08 + 0.16 * y)) / 2)
                for side in (-1, 1))
    profile = np.clip(y / 0.08, 0, 1) * np.exp(-2.6 * y) * np.clip((1 - y) / 0.3, 0, 1)
    edge = np.clip((0.5 - np.abs(x)) / 0.12, 0, 1)
    return Texture.of((POOL_GAIN * beams * profile * edge).astype(np.float32))
