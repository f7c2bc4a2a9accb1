# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The static background: asphalt with lane markings, verges, a treeline and the sky."""
from __future__ import annotations

import copy
import math
from typing import Optional, Sequence

import cv2
import numpy as np

from .props import LightConfig
from .road import Road
from .scene import SimScene
from .texture import Image, octaves, pyramid
from .view import below, View
from ...core.records import Array

FAR_M = 600.0
BEYOND_M = 40.0  # a curved road is drawn this far beyond the first front
SHOULDER_M = 1.5  # width of the asphalt beyond the outer lines
TILE = 512  # texels of a ground texture
TILE_TEXEL_M = 0.03
LEVELS = 7
WORN_TEXELS = 16  # size of the finest patches of worn paint
WORN_EDGE = 0.5  # width of the transition of worn paint, in standard deviations of the texture
# Ray marching to a surface that may occlude itself; the step is a share of the distance so far.
MARCH_FROM_M, MARCH_STEP, MARCH_ROWS, MARCH_COLUMNS = 6.0, 0.08, 2, 16
SECANTS = 5
TREES_UP = 0.07  # sine of the elevation that no tree's top exceeds
WET_ASPHALT, WET_MARKING = 0.5, 0.6  # shares by which water darkens asphalt and fades markings
LAMP_SHARE = 6e-5  # daylight below a street lamp, per grey level of the lamp
MIRRORED = 0.6  # share of the sky that rough wet asphalt reflects at grazing incidence
GREY = {'asphalt': 85.0, 'grass': 72.0, 'marking': 185.0, 'sky': 150.0, 'trees': 50.0}


class GroundMap:
    """
    Intersection of each pixel's ray of a view with the road's surface.

    :param scene: the scene.
    :param view: the view.

    Attributes, all (rows, columns): ``station`` and ``offset`` in m, their derivatives ``*_x`` and
    ``*_y`` per pixel, ``hit`` the share of the pixel that sees ground, ``road`` whether the road
    may be there; and ``rays`` (rows, columns, 3), unit vectors, world.
    """

    def __init__(self, scene: SimScene, view: View) -> None:
        camera = view.camera
        # One more ray on each side, for the derivatives.
        rays = view.ray_grid(np.arange(-1.0, camera.width_px + 1.0),
                             np.arange(-1.0, camera.height_px + 1.0)) @ scene.left_R_world
        centre = scene.centre_world_m + view.centre_m @ scene.left_R_world
        self.rays = rays[1:-1, 1:-1] / np.linalg.norm(rays[1:-1, 1:-1], axis=-1, keepdims=True)
        flat = np.maximum(np.hypot(rays[..., 0], rays[..., 1]), 1e-9)
        depth = _ground_distance(scene.road, centre, rays, flat)
        xy = centre[:2] + depth[..., None] * rays[..., :2]
        station, offset = scene.road.station(xy)
        self.station, self.station_x, self.station_y = _derivatives(station)
        self.offset, self.offset_x, self.offset_y = _derivatives(offset)
        # No road beyond its range, or where a ray meets a sloping bend twice.
        height = centre[2] + depth * rays[..., 2] - scene.road.height(station, offset)
        far = 0.9 * FAR_M if not scene.road.curved else scene.config.start_m + BEYOND_M
        self.road = ((np.abs(height) < 1e-3) & (depth * flat < far)
                     & (station > scene.road.from_m) & (station < scene.road.to_m))[1:-1, 1:-1]
        slope, slope_x, slope_y = _derivatives(rays[..., 2] / flat)
        horizon = -(centre[2] - float(scene.road.height(scene.end_station_m))) / FAR_M
        self.hit = below(horizon - slope, slope_x, slope_y)
        self.xy = xy[1:-1, 1:-1]


def _derivatives(values: Array) -> tuple[Array, Array, Array]:
    """Strip the border; central differences to the right and downwards."""
    x = (values[1:-1, 2:] - values[1:-1, :-2]) / 2
    y = (values[2:, 1:-1] - values[:-2, 1:-1]) / 2
    return values[1:-1, 1:-1], x, y


def _ground_distance(road: Road, centre: Array, rays: Array, flat: Array) -> Array:
    """Return the multiple of each ray at which it meets the surface, at most ``FAR_M``."""
    if road.folded:
        return _first_meeting(road, centre, rays, flat)
    grade = road.config.grade
    far = FAR_M / flat

    def meet(height: Array, slope: Array) -> Array:
        with np.errstate(divide='ignore'):
            depth = np.where(slope < 0, height / np.minimum(slope, -1e-12), far)
        return np.clip(depth, 0.0, far)
    station, _ = road.station(centre[:2])
    depth = meet(grade * float(station) - centre[2], rays[..., 2])
    if grade == 0:
        return depth
    for _ in range(6):
        xy = centre[:2] + depth[..., None] * rays[..., :2]
        station, offset = road.station(xy)
        station = np.clip(station, road.from_m, road.to_m)
        heading = road.heading(station)
        plan = np.maximum(1.0 - road.curvature(station) * offset, 0.3)
        along = (rays[..., 0] * np.cos(heading) + rays[..., 1] * np.sin(heading)) / plan
        # Newton step: along the ray, the gap to the surface shrinks by grade x along - slope.
        gap = centre[2] + depth * rays[..., 2] - grade * station
        depth = np.clip(depth + gap / np.maximum(grade * along - rays[..., 2], 1e-4), 0.0, far)
    return depth


def _first_meeting(road: Road, centre: Array, rays: Array, flat: Array) -> Array:
    """Return the first intersection of each ray with a surface that may occlude itself."""
    far = FAR_M / flat

    def gap(rays: Array, depth: Array) -> Array:
        xy = centre[:2] + depth[..., None] * rays[..., :2]
        station, offset = road.station(xy)
        station = np.clip(station, road.from_m, road.to_m)
        return np.asarray(centre[2] + depth * rays[..., 2] - road.height(station, offset))
    # march along some of the rays, and continue from the last point above the ground
    some = rays[::MARCH_ROWS, ::MARCH_COLUMNS]
    some_flat = flat[::MARCH_ROWS, ::MARCH_COLUMNS]
    above, last = np.ones(some_flat.shape, dtype=bool), np.full(some_flat.shape, FAR_M)
    for k in range(math.ceil(math.log(FAR_M / MARCH_FROM_M) / math.log(1 + MARCH_STEP))):
        distance = MARCH_FROM_M * (1 + MARCH_STEP) ** k
        below_now = above & (gap(some, distance / some_flat) < 0)
        last[below_now] = distance / (1 + MARCH_STEP)
        above &= ~below_now
    row, column = np.indices(flat.shape)
    depth = last[row // MARCH_ROWS, column // MARCH_COLUMNS] / flat
    before, high = depth, gap(rays, depth)
    depth = np.minimum(depth * (1 + MARCH_STEP / 2), far)
    for _ in range(SECANTS):
        here, step = gap(rays, depth), depth - before
        slope = (here - high) / np.where(step == 0, 1.0, step)
        before, high = depth, here
        most = MARCH_STEP * depth
        depth = np.clip(depth + np.clip(-here / np.minimum(slope, -1e-4), -most, most), 0.0, far)
    return np.asarray(depth)


def _asphalt_coverage(ground: GroundMap, road: Road) -> Array:
    """Return the share of each pixel that is road."""
    left = (road.config.lanes - 0.5) * road.config.lane_width_m + SHOULDER_M
    right = -0.5 * road.config.lane_width_m - SHOULDER_M
    share = (below(left - ground.offset, ground.offset_x, ground.offset_y)
             - below(right - ground.offset, ground.offset_x, ground.offset_y))
    return np.where(ground.road, share, 0.0)


def marking_coverage(ground: GroundMap, road: Road, worn: Optional[list[Image]] = None) -> Array:
    """
    Return the share of each pixel that is lane marking.

    :param worn: texture whose low values are worn paint; None for no wear.
    """
    c = road.config
    total = np.zeros_like(ground.offset)
    near = np.abs(ground.offset_x) + np.abs(ground.offset_y)
    for name, middle in road.line_offsets().items():
        where = np.nonzero((np.abs(ground.offset - middle) < c.marking_width_m / 2 + near)
                           & ground.road)
        gap = middle - ground.offset[where]
        gx, gy = ground.offset_x[where], ground.offset_y[where]
        share = (below(gap + c.marking_width_m / 2, gx, gy)
                 - below(gap - c.marking_width_m / 2, gx, gy))
        if name.startswith('line') or c.dashed_edges:
            period = c.dash_m + c.gap_m
            phase = np.mod(ground.station[where], period)
            gx, gy = ground.station_x[where], ground.station_y[where]
            dash = np.zeros_like(share)
            for start in (0.0, period):
                dash += (below(start + c.dash_m / 2 - phase, gx, gy)
                         - below(start - c.dash_m / 2 - phase, gx, gy))
            reach = np.abs(gx) + np.abs(gy)
            dash = np.where(reach > period, c.dash_m / period, np.clip(dash, 0.0, 1.0))
            share = share * dash
        total[where] = np.maximum(total[where], share)
    if worn is not None:
        level = float(np.quantile(worn[0], c.wear))
        total *= np.clip((_sample_ground([worn], ground)[0] - level) / WORN_EDGE + 0.5, 0.0, 1.0)
    return total


def _sample_ground(textures: Sequence[list[Image]], ground: GroundMap) -> list[Array]:
    """Sample tiled textures of one size by mipmaps, at about the pixel's footprint."""
    footprint = np.sqrt(np.maximum(
        np.hypot(ground.station_x, ground.offset_x)
        * np.hypot(ground.station_y, ground.offset_y), 1e-9)) / TILE_TEXEL_M
    level = np.clip(np.log2(np.maximum(footprint, 1.0)), 0.0, LEVELS)
    out = [np.zeros(level.shape, np.float32) for _ in textures]
    for i, images in enumerate(zip(*textures, strict=True)):
        weight = np.maximum(1.0 - np.abs(level - i), 0.0).astype(np.float32)
        rows = np.nonzero(weight.any(axis=1))[0]
        if not rows.size:
            continue
        band = slice(rows[0], rows[-1] + 1)
        size = images[0].shape[0]
        texel = ground.xy[band] / (TILE_TEXEL_M * 2 ** i) - 0.5
        texel -= size * np.floor(texel / size)  # np.mod, but fast; sizes are powers of 2
        x, y = (texel[..., k].astype(np.float32) for k in (0, 1))
        for image, total in zip(images, out):
            total[band] += weight[band] * cv2.remap(
                image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return out


def _tile(rng: np.random.Generator, finest: int) -> list[Image]:
    return pyramid(octaves(rng, TILE, TILE, finest), LEVELS)


def _plant(sky: Array, rays: Array, crowns: Array, rng: np.random.Generator) -> None:
    """
    Draw a distant row of trees, in place.

    :param sky: (rows, columns) grey levels.
    :param rays: (rows, columns, 3) unit, world.
    :param crowns: (n,), heights of the trees around a quarter of the circle.
    :param rng: source of their leaves.
    """
    rows = np.nonzero((np.abs(rays[..., 2]) < TREES_UP).any(axis=1))[0]
    if not rows.size:
        return
    band = slice(rows[0], rows[-1] + 1)
    rays = rays[band]
    # The crowns are repeated four times around the circle.
    place = np.mod(np.arctan2(rays[..., 1], rays[..., 0]) * (2 / np.pi), 1.0) * crowns.size
    height = 0.012 + 0.006 * np.interp(place, np.arange(crowns.size), crowns)
    share = np.clip((np.clip(height, 0.002, TREES_UP) - rays[..., 2]) * 1800.0 + 0.5, 0.0, 1.0)
    trees = GREY['trees'] + 10 * octaves(rng, share.shape[0], share.shape[1], 2)
    sky[band] += share * (trees - sky[band])


def _lamp_light(scene: SimScene, ground: GroundMap) -> Array:
    """Return the light of the street lamps on the ground, as a share of daylight."""
    total = np.zeros(ground.offset.shape)
    for lamp in scene.config.street_lamps:
        foot = scene.road.position(lamp.station_m, lamp.offset_m)[:2]
        gap = np.square(ground.xy - foot).sum(axis=-1) / lamp.height_m ** 2
        total += lamp.grey * LAMP_SHARE / (1 + gap) ** 1.5
    return total


def render_background(scene: SimScene, views: tuple[View, View],
                      rng: np.random.Generator) -> tuple[Image, Image]:
    """
    Draw the static scene in both views.

    :param scene: the scene.
    :param views: left and right.
    :param rng: source of the textures; both views see the same ones.
    :return: two (rows, columns) float32 images, grey levels.
    """
    asphalt, grass = _tile(rng, 2), _tile(rng, 4)
    worn = _tile(rng.spawn(1)[0], WORN_TEXELS) if scene.road.config.wear else None
    trees = np.random.default_rng(int(rng.integers(2 ** 31)))
    crowns = octaves(trees, 1, 512, 1)[0]
    images = []
    light = scene.config.light or LightConfig()
    for view in views:
        ground = GroundMap(scene, view)
        on_road = _asphalt_coverage(ground, scene.road)
        tar_texture, grass_texture = _sample_ground([asphalt, grass], ground)
        grey = GREY['grass'] + 11.0 * grass_texture
        tar = GREY['asphalt'] + 6.0 * tar_texture
        tar *= 1 - WET_ASPHALT * light.wet
        grey += on_road * (tar - grey)
        paint = marking_coverage(ground, scene.road, worn) * (1 - WET_MARKING * light.wet)
        grey += paint * (GREY['marking'] - grey)
        if light.wet:
            share = MIRRORED * light.wet * (1 - np.abs(ground.rays[..., 2])) ** 5
            grey += on_road * share * (GREY['sky'] - grey)
        sky = GREY['sky'] + 60.0 * np.clip(ground.rays[..., 2], 0.0, 0.5)
        _plant(sky, ground.rays, crowns, copy.deepcopy(trees))  # the same in both views
        grey *= light.ambient + _lamp_light(scene, ground)
        sky *= light.ambient
        images.append((sky + ground.hit * (grey - sky)).astype(np.float32))
    return images[0], images[1]
