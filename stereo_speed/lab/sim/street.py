# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Vehicles on the road and objects beside it, as items to be painted."""
from __future__ import annotations

from typing import Optional, Union

import cv2
import numpy as np

from .appearance import Appearance
from .bodies import BODIES, BodyConfig
from .items import Footprint, Item
from .motorcycle import MotorcycleAppearance
from .planes import Plane, Texture
from .props import ParkedConfig, PersonConfig, PoleConfig, TreeConfig
from .scene import FrontPose, Place, SimScene, Vehicle
from .solids import SolidAppearance
from .texture import Canvas, Image, octaves
from ...core.records import Array

PERSON_TEXEL_M = 0.012
TREE_TEXEL_M = 0.03
STRIDE_M = 1.5  # two steps
NO_LANE = -1  # where vehicles park

Looks = Union[Appearance, MotorcycleAppearance]


def looks_of(body: BodyConfig, rear: bool, rng: np.random.Generator) -> Looks:
    """
    Return the appearance of a vehicle.

    :param rear: whether its rear is tracked.
    :param rng: source of its textures.
    """
    if body.kind == 'motorcycle':
        return MotorcycleAppearance(body, rear, rng)
    return SolidAppearance(body, rng) if body.solid and not rear else Appearance(body, rear, rng)


def footprint(scene: SimScene, points_m: Array) -> Footprint:
    """Return the ground area covered by points (n, 3) of the left optical frame."""
    world = points_m @ scene.left_R_world
    ahead, left = -scene.chord, np.array([scene.chord[1], -scene.chord[0], 0.0])
    along, across = world @ ahead, world @ left
    return Footprint((float(along.min()), float(along.max())),
                     (float(across.min()), float(across.max())))


def billboard(scene: SimScene, foot: Array, width_m: float, height_m: float,
              texture: Texture) -> Item:
    """Return a picture that stands upright on the ground and faces the camera."""
    right = np.cross(foot - (foot @ scene.up) * scene.up, scene.up)
    right *= width_m / np.linalg.norm(right)
    plane = Plane(foot - right / 2 + scene.up * height_m, right, -scene.up * height_m, texture)
    return Item(footprint(scene, foot + np.outer([-0.5, 0.5], right)), [plane], plane.outline_m)


def pole(scene: SimScene, config: PoleConfig) -> Item:
    """Return a pole, shaded as a cylinder."""
    chord = scene.chord
    world = scene.centre_world_m - chord * config.ahead_m + config.right_m * np.array(
        [-chord[1], chord[0], 0.0])
    world[2] = float(scene.road.height(*scene.road.station(world[:2])))
    shade = np.cos(np.linspace(-1.3, 1.1, 16))
    grey = np.tile(config.grey * (0.45 + 0.75 * shade), (16, 1)).astype(np.float32)
    return billboard(scene, scene.to_left(world), 2 * config.radius_m, config.height_m,
                     Texture.of(grey))


def parked(scene: SimScene, config: ParkedConfig, rng: np.random.Generator) -> Item:
    """Return a parked vehicle, whose front is not tracked."""
    appearance = looks_of(BODIES[config.kind], False, rng)
    place = Place(config.station_m, config.offset_m, NO_LANE, 0.0, 0.0)
    pose = scene.front(Vehicle(0, appearance.body, lambda _: place), 0.0)
    return vehicle_item(scene, appearance, pose)


def body_box(body: BodyConfig, pose: FrontPose) -> Array:
    """Return the corners (8, 3) of a level vehicle's box, the four of its footprint first."""
    back, front = (0.0, body.length_m) if pose.rear else (-body.length_m, 0.0)
    half = body.width_m / 2
    return pose.ground_m + np.array([
        (x, y, z) for z in (0.0, body.roof_m)
        for x, y in ((back, -half), (front, -half), (front, half), (back, half))
    ]) @ pose.ground_axes.T


def vehicle_item(scene: SimScene, looks: Looks, pose: FrontPose,
                 number: Optional[int] = None, lit: bool = False) -> Item:
    """
    Return a vehicle at its pose.

    :param pose: pose of its tracked front.
    :param number: number of the vehicle; None for one that is not tracked.
    :param lit: whether its lamps are on.
    """
    body = looks.body
    lamps = looks.lamp_places if lit else np.zeros((0, 3))
    places, up = pose.origin_m + lamps @ pose.axes.T, pose.ground_axes[:, 2]
    mirrored = places - 2 * np.outer((places - pose.ground_m) @ up, up)
    return Item(footprint(scene, body_box(body, pose)[:4]), looks.planes(pose),
                _silhouette(body, pose), vehicle=number,
                front_m=None if number is None else pose.corners_m, lamps_m=places,
                mirrored_m=mirrored, lamp_size_m=0.1 if pose.rear else 0.22,
                lamp_grey=looks.lamp_grey)


def _silhouette(body: BodyConfig, pose: FrontPose) -> Array:
    """Return points (n, 3) whose hull the body fills, except for its wheel arches."""
    if not body.kind:
        return pose.corners_m
    half, low, roof, long = body.width_m / 2, body.clearance_m, body.roof_m, body.length_m
    top = low + body.front_m
    screen = body.cab_m or body.bonnet_m + body.screen_m
    outline = [(0, 0.1), (0, top), (screen, roof), (long - 0.5, roof), (long, low + body.rear_m),
               (long, 0.1)]
    front = long if pose.rear else 0.0
    return pose.origin_m + np.array([(front - back, side, up) for back, up in outline
                                     for side in (-half, half)]) @ pose.axes.T


class Person:
    """
    A walking person with swinging legs and arms.

    :param config: configuration of the person.
    :param rng: source of the clothes.
    """

    def __init__(self, config: PersonConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.greys = rng.uniform((30, 25, 90), (180, 110, 160))  # coat, trousers, skin
        self.phase = float(rng.uniform(0, 2 * np.pi))

    def place(self, t_s: float) -> float:
        """Return the station, m, at a time."""
        c = self.config
        gone = c.speed_mps * t_s
        if c.turns_m is None:
            return c.station_m + gone
        # Back and forth between both ends.
        return c.station_m + abs((gone + c.turns_m) % (4 * c.turns_m) - 2 * c.turns_m) - c.turns_m

    def item(self, scene: SimScene, t_s: float) -> Item:
        """Return the picture at a time."""
        c = self.config
        width = 0.62 * c.height_m
        angle = 2 * np.pi * c.speed_mps * t_s / STRIDE_M + self.phase
        grey, alpha = (Canvas(width, c.height_m, level, PERSON_TEXEL_M)
                       for level in (float(self.greys[0]), 0.0))
        swing = 0.16 * np.sin(angle)
        parts = [([(0.42, 0.5), (0.5, 0.5), (0.53 + swing, 1.0), (0.44 + swing, 1.0)], 1),
                 ([(0.5, 0.5), (0.58, 0.5), (0.55 - swing, 1.0), (0.46 - swing, 1.0)], 1),
                 ([(0.36, 0.19), (0.42, 0.2), (0.42 - swing, 0.52), (0.35 - swing, 0.52)], 0),
                 ([(0.58, 0.2), (0.64, 0.19), (0.65 + swing, 0.52), (0.58 + swing, 0.52)], 0),
                 ([(0.38, 0.17), (0.62, 0.17), (0.6, 0.54), (0.4, 0.54)], 0)]
        for outline, cloth in parts:
            grey.polygon(outline, float(self.greys[cloth]))
            alpha.polygon(outline, 1.0)
        for canvas, level in ((grey, float(self.greys[2])), (alpha, 1.0)):
            canvas.disc(0.5, 0.085, 0.075 * c.height_m, level)
        half = (grey.image.shape[1] // 2, grey.image.shape[0] // 2)
        texture = Texture.of(*(np.asarray(cv2.resize(canvas.image, half,
                                                     interpolation=cv2.INTER_AREA), np.float32)
                               for canvas in (grey, alpha)))
        return billboard(scene, scene.point(self.place(t_s), c.offset_m), width, c.height_m,
                         texture)


class Tree:
    """
    A tree whose crown sways, more at the top, and whose leaves flutter.

    :param config: configuration of the tree.
    :param rng: source of its shape.
    """

    def __init__(self, config: TreeConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.width_m = 0.75 * config.height_m
        rows, columns = (round(side / TREE_TEXEL_M) for side in (config.height_m, self.width_m))
        y, x = np.mgrid[0:rows, 0:columns].astype(np.float32)
        x, y = (x + 0.5) / columns, (y + 0.5) / rows
        rim = 0.16 * octaves(rng, rows, columns, 6)
        crown = 1 - np.hypot((x - 0.5) / 0.4, (y - 0.4) / 0.34) + 0.8 * rim
        alpha = np.clip(crown * 9, 0, 1)
        alpha = np.maximum(alpha, (np.abs(x - 0.5) < 0.025 + 0.01 * y) & (y > 0.5))
        grey = np.clip(58 - 26 * (y - 0.3) + 13 * octaves(rng, rows, columns, 4), 12, 120)
        self.grey, self.alpha = grey.astype(np.float32), alpha.astype(np.float32)
        self.flutter = octaves(rng, rows, columns, 16)
        self.place = (x * columns - 0.5, y * rows - 0.5, np.clip(1 - y, 0, 1) ** 1.5)
        self.phase = float(rng.uniform(0, 2 * np.pi))

    def item(self, scene: SimScene, t_s: float) -> Item:
        """Return the picture at a time."""
        c = self.config
        angle = 2 * np.pi * t_s / c.period_s + self.phase
        swing = c.sway_m / TREE_TEXEL_M * (0.7 * np.sin(angle) + 0.3 * np.sin(2.7 * angle + 1.0))
        leaves = 1.2 * np.sin(6.1 * angle)
        x, y, high = self.place
        at = ((x - np.float32(swing) * high + np.float32(leaves) * self.flutter).astype(
            np.float32), y)
        grey, alpha = (_moved(picture, at) for picture in (self.grey, self.alpha))
        return billboard(scene, scene.point(c.station_m, c.offset_m), self.width_m, c.height_m,
                         Texture.of(grey, alpha))


def _moved(picture: Image, at: tuple[Image, Image]) -> Image:
    return np.asarray(cv2.remap(picture, *at, cv2.INTER_LINEAR,
                                borderMode=cv2.BORDER_CONSTANT, borderValue=0.0), np.float32)
