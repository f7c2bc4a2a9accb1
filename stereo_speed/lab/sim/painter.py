# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Paint a scene at a time: moving objects over a background that is painted once."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .bodies import BodyConfig
from .items import glow, glow_at, in_order, Item, paint, Visibility
from .light import cloud_tile, Clouds, Sensor
from .optics import Optics
from .planes import Eye, Plane, Texture
from .props import LightConfig, StreetLampConfig
from .scene import FrontPose, SimScene, Vehicle
from .scenery import render_background
from .street import body_box, Looks, looks_of, parked, Person, pole, Tree, vehicle_item
from .surface import Sky
from .sway import swayed
from .texture import Image
from .view import rig_views
from .wet import streak
from ...core.records import Array, RigMotion

Picture = NDArray[np.uint8]

GLOW_GREY = 700.0  # grey level at the centre of a lit lamp, before the exposure
TAIL_GREY = 200.0
POOL_FROM_M, POOL_TO_M, POOL_HALF_M = 1.5, 26.0, 3.0
POOL_GAIN = 2.6
WET_POOL = 0.4  # share of a pool's light that a wet road scatters back
LAMP_M = 0.05  # radius of a headlamp in its reflection on the road
STREET_LAMP_M = 0.15


@dataclass(frozen=True, eq=False)
class Moment:
    """
    The contents of a scene at a time.

    :param fronts: body of each vehicle and pose of its tracked front.
    :param items: all upright objects, in the order of painting.
    """

    fronts: list[tuple[BodyConfig, FrontPose]]
    items: list[Item]


class Painter:
    """
    Renders a scene with its vehicles.

    :param scene: the scene.
    :param rng: source of textures and noise.
    :param vehicle_rng: source of the vehicles' appearance; each vehicle number has its own.
    """

    def __init__(self, scene: SimScene, rng: np.random.Generator,
                 vehicle_rng: np.random.Generator) -> None:
        texture, props, noise, sky, optics = rng.spawn(5)
        config = scene.config
        self.scene = scene
        self.light = config.light or LightConfig()
        views = rig_views(scene.seen_rig)
        self.eyes = (Eye(views[0]), Eye(views[1]))
        self.backgrounds = render_background(scene, views, texture)
        self.sky = _sky(scene, self.light, sky)
        self.optics = Optics(config.lens, config.faults, self.eyes[0].size, optics)
        self._street_lamps = [self._street_lamp(lamp) for lamp in config.street_lamps]
        self.sensor = Sensor(config, config.light, noise)
        self.moving: list[Person | Tree] = [*(Person(p, props) for p in config.people),
                                            *(Tree(t, props) for t in config.trees)]
        self.still = [pole(scene, p) for p in config.poles]
        cars = [parked(scene, p, props) for p in config.parked]
        for car in cars:
            self._shade(car.hull_m)
        self.still += cars
        self.clouds: Optional[tuple[Clouds, Clouds]] = None
        if self.light.cloud_depth > 0:
            tile = cloud_tile(props)
            self.clouds = (Clouds(scene, self.eyes[0], self.light, tile),
                           Clouds(scene, self.eyes[1], self.light, tile))
        self._pool = _pool_texture()
        self._seen = (Visibility(self.eyes[0]), Visibility(self.eyes[1]))
        self._vehicle_seed = int(vehicle_rng.integers(2 ** 62))
        self._appearances: dict[int, Looks] = {}

    def paint(self, vehicles: Sequence[Vehicle], t_s: float, motion: Optional[RigMotion] = None
              ) -> tuple[tuple[Picture, Picture], dict[int, float]]:
        """
        Paint a pair.

        :param vehicles: the vehicles, in any order.
        :param t_s: exposure time of the left camera.
        :param motion: rig motion; None for a rig at rest.
        :return: left and right image, and the visible share of each vehicle's tracked front: the
            lesser of both views.
        """
        here = {vehicle.number for vehicle in vehicles}
        self._appearances = {n: a for n, a in self._appearances.items() if n in here}
        delay_s = self.scene.config.right_delay_s
        moment, step = self._moment(vehicles, t_s), self.optics.exposure()
        left, in_left = self._view(0, moment, t_s, step, motion)
        if delay_s:
            moment = self._moment(vehicles, t_s + delay_s)
        right, in_right = self._view(1, moment, t_s + delay_s, step, motion)
        return (left, right), {n: min(share, in_right.get(n, 0.0)) for n, share in in_left.items()}

    def _appearance(self, vehicle: Vehicle, rear: bool) -> Looks:
        """Return the appearance of a vehicle, the same as long as it is in the scene."""
        if vehicle.number not in self._appearances:
            rng = np.random.default_rng([self._vehicle_seed, vehicle.number])
            self._appearances[vehicle.number] = looks_of(vehicle.body, rear, rng)
        return self._appearances[vehicle.number]

    def _moment(self, vehicles: Sequence[Vehicle], t_s: float) -> Moment:
        """Return the contents of the scene at a time."""
        fronts = [(v.body, self.scene.front(v, t_s)) for v in vehicles]
        items = [vehicle_item(self.scene, self._appearance(v, pose.rear), pose, v.number,
                              self.light.headlights) for v, (_, pose) in zip(vehicles, fronts)]
        items += [thing.item(self.scene, t_s) for thing in self.moving]
        return Moment(fronts, in_order(items + self.still))

    def _view(self, side: int, moment: Moment, t_s: float, step: float,
              motion: Optional[RigMotion]) -> tuple[Picture, dict[int, float]]:
        """
        Return the image of a view, 0 left or 1 right, and the visible shares of the fronts.

        :param step: exposure of the pair relative to the nominal one.
        :param motion: rig motion; None for a rig at rest.
        """
        image, eye = self.backgrounds[side].copy(), self.eyes[side]
        for body, pose in moment.fronts:
            self._cast(image, eye, body, pose)
        if self.light.headlights:
            for body, pose in moment.fronts:
                if not body.solid or body.lamp_grey > 0:
                    self._light_road(image, eye, body, pose)
        if self.light.wet:
            for item in moment.items:
                for lamp, mirrored in zip(item.lamps_m, item.mirrored_m):
                    streak(image, eye, lamp, mirrored, _lamp_grey(item), LAMP_M, self.light.wet)
            for lamp, mirrored, grey in self._street_lamps:
                streak(image, eye, lamp, mirrored, grey, STREET_LAMP_M, self.light.wet)
        for item in moment.items:
            paint(image, eye, item, self.sky)
            if len(item.lamps_m) and item.lamp_grey is None:
                glow(image, eye, item, _lamp_grey(item))
        if self.clouds is not None:
            image *= self.clouds[side].gain(t_s)
        image = self.optics.spread(swayed(image, side, self.scene.seen_rig, motion), side)
        return (self.sensor.expose(image, side, t_s, step),
                self._seen[side].shares(moment.items))

    def _street_lamp(self, config: StreetLampConfig) -> tuple[Array, Array, float]:
        """Draw a street lamp into the background; return position, mirror image and grey level."""
        foot = self.scene.point(config.station_m, config.offset_m)
        lamp, mirrored = (foot + sign * config.height_m * self.scene.up for sign in (1, -1))
        for image, eye in zip(self.backgrounds, self.eyes):
            glow_at(image, eye, lamp, 2 * STREET_LAMP_M, config.grey)
        return lamp, mirrored, config.grey

    def _cast(self, image: Image, eye: Eye, body: BodyConfig, pose: FrontPose) -> None:
        """Darken the road below and beside a vehicle; a front without a body casts no shadow."""
        if not body.kind:
            return
        feet = body_box(body, pose)[:4]
        prisms = [(body.clearance_m + body.front_m, 0.0),
                  (body.roof_m, 0.25 if not body.cab_m else 0.0)]
        self._darken(image, eye, feet, pose.ground_axes[:, 2], prisms)

    def _shade(self, hull_m: Array) -> None:
        """Darken the road below a static object."""
        up = self.scene.up
        low = hull_m @ up
        foot = hull_m[low < low.min() + 0.05]
        for image, eye in zip(self.backgrounds, self.eyes):
            self._darken(image, eye, foot[_ring(self.scene, foot)], up, [(1.4, 0.0)])

    def _darken(self, image: Image, eye: Eye, feet_m: Array, up: Array,
                prisms: Sequence[tuple[float, float]]) -> None:
        """
        Draw the sun's shadow of upright prisms on the road, and the sky's shadow below them.

        :param feet_m: (n, 3), footprint of the prisms.
        :param prisms: height, m, and the share by which the upper side is shorter, of each.
        """
        eye.fill(image, [feet_m], 0.45, 1.2)
        sun = self.light.sun()
        if sun is not None:
            outlines = [_shadow(self.scene, feet_m, up, height_m, inset, sun)
                        for height_m, inset in prisms]
            eye.fill(image, outlines, 1 - self.light.shadow, 0.7)

    def _light_road(self, image: Image, eye: Eye, body: BodyConfig, pose: FrontPose) -> None:
        """Draw the pool of light of the headlights on the road."""
        ahead_m = POOL_FROM_M + (body.length_m if pose.rear else 0.0)
        along, left, _ = pose.ground_axes.T
        corner = pose.ground_m + along * ahead_m - left * POOL_HALF_M
        # Seen from above, with the vehicle at the top and its right side at the texture's left.
        plane = Plane(corner, left * 2 * POOL_HALF_M, along * (POOL_TO_M - POOL_FROM_M),
                      self._pool)
        box = eye.box(eye.project(plane.outline_m))
        if box is None:
            return
        u0, u1, v0, v1 = box
        gain, _ = eye.sample(plane, box)
        # Relative to the light on the road.
        share = (1 - (1 - WET_POOL) * self.light.wet) / self.light.ambient
        image[v0:v1, u0:u1] *= 1 + np.float32(share) * gain


def _lamp_grey(item: Item) -> float:
    """Return the grey level of an item's lamps."""
    if item.lamp_grey is not None:
        return item.lamp_grey
    return TAIL_GREY if item.lamp_size_m < 0.2 else GLOW_GREY


def _sky(scene: SimScene, light: LightConfig, rng: np.random.Generator) -> Sky:
    """Return the sky that lights the objects, in the left optical frame."""
    along, left = scene.chord, np.array([-scene.chord[1], scene.chord[0], 0.0])
    axes = scene.left_R_world @ np.stack([along, left, [0.0, 0.0, 1.0]], axis=1)
    sun = light.to_sun()
    return Sky.of(scene.up, axes[:, 0], None if sun is None else axes @ np.array(sun),
                  light.ambient, rng)


def _ring(scene: SimScene, points_m: Array) -> NDArray[np.intp]:
    """Return the indices of points in order around their hull on the ground."""
    flat = (points_m @ scene.left_R_world)[:, :2].astype(np.float32)
    return np.asarray(cv2.convexHull(flat, returnPoints=False)).ravel().astype(np.intp)


def _shadow(scene: SimScene, feet_m: Array, up: Array, height_m: float, inset: float,
            sun: tuple[float, float]) -> Array:
    """
    Return the outline (n, 3) of the shadow of an upright prism.

    :param feet_m: (4, 3), its footprint.
    :param inset: share by which its upper side is shorter than the lower.
    :param sun: shift of the shadow per metre of height, along and across the road.
    """
    shift = height_m * (scene.left_R_world @ np.array([sun[0], sun[1], 0.0]))
    middle = feet_m.mean(axis=0)
    tops = middle + (1 - inset) * (feet_m - middle) + shift
    points = np.concatenate([feet_m, tops])
    return points[_ring(scene, points)]


def _pool_texture() -> Texture:
    """Make the light of two lamps on the road, with the vehicle at the top."""
    y, x = np.mgrid[0:128, 0:64].astype(np.float32)
    x, y = (x + 0.5) / 64 - 0.5, (y + 0.5) / 128
    beams = sum(np.exp(-np.square((x - side * (0.11 + 0.12 * y)) / (0.08 + 0.16 * y)) / 2)
                for side in (-1, 1))
    profile = np.clip(y / 0.08, 0, 1) * np.exp(-2.6 * y) * np.clip((1 - y) / 0.3, 0, 1)
    edge = np.clip((0.5 - np.abs(x)) / 0.12, 0, 1)
    return Texture.of((POOL_GAIN * beams * profile * edge).astype(np.float32))
