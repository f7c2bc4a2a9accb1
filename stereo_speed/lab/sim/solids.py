# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Vehicles with non-planar fronts: curved and stepped, with bonnet, windscreen and lamps."""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Callable

import cv2
import numpy as np

from .appearance import Appearance, finished, GLASS, RELIEF_BUMPS
from .bodies import BodyConfig
from .planes import Plane, Texture
from .scene import FrontPose
from .surface import Surface
from .texture import Canvas, draw_grille, draw_plate, Image, octaves, TEXEL_M
from ...core.records import Array

SHAPE_M = 0.01  # cell size of the grids of relief and gloss
LOW_M = 0.8  # above this height a front has its windscreen
# Low beams: 1-sigma of their vertical and horizontal spread, degrees, and scattered share.
BEAM_DEG, BEAM_FLOOR = (3.5, 14.0), 0.08
MATT = 0.12  # gloss of grilles and plastics relative to that of paint
PLAIN_SHADE = 0.04  # shading from top to bottom of pieces that are lit by their shape

At = Callable[[float, float, float], Array]


@dataclass(frozen=True, kw_only=True)
class Front:
    """
    The appearance and shape of a front.

    :param grey: (rows, columns), grey levels.
    :param lamps: (rows, columns), share of the lamps' light emitted there.
    :param relief_m: (rows, columns), height relative to its foremost plane; not positive.
    :param gloss: (rows, columns), 0 to 1.
    :param lamp_up_m: height of the lamps above the lower edge, m.
    :param lamp_side_m: distance of their centres from the middle of the front, m.
    """

    grey: Image
    lamps: Image
    relief_m: Image
    gloss: Image
    lamp_up_m: float
    lamp_side_m: float


def _between(value: Image, low: float, high: float, edge: float) -> Image:
    """Return 1 between two values and 0 outside, with soft edges."""
    return np.asarray(np.clip((value - low) / edge + 0.5, 0, 1)
                      * np.clip((high - value) / edge + 0.5, 0, 1), np.float32)


def draw_front(rng: np.random.Generator, body: BodyConfig, paint: float) -> Front:
    """
    Draw a front with its shape.

    :param rng: source of randomness.
    :param body: its size.
    :param paint: grey level of the paint.
    """
    wide, tall = body.width_m, body.front_m
    top_m = max(0.0, tall - LOW_M)  # above this, a tall front has its windscreen
    canvas, glow = (Canvas(wide, tall, grey) for grey in (paint, 0.0))
    x, y = np.meshgrid(((np.arange(round(wide / SHAPE_M)) + 0.5) * SHAPE_M - wide / 2),
                       (np.arange(round(tall / SHAPE_M)) + 0.5) * SHAPE_M)
    x, y = x.astype(np.float32), y.astype(np.float32)
    low_m = tall - top_m  # height of the part below the windscreen

    def at(share: float) -> float:
        return top_m + low_m * share
    gloss = np.ones_like(x)
    bow_m, lean_m = rng.uniform(0.04, 0.12), rng.uniform(0.03, 0.10)
    relief = -bow_m * np.abs(2 * x / wide) ** 2.5
    if top_m > 0.25:
        _windscreen(canvas, rng, top_m / tall)
        relief -= rng.uniform(0.04, 0.14) * np.clip(1 - y / top_m, 0, 1)
    relief -= lean_m * np.clip((at(0.55) - y) / (0.55 * low_m), 0, 1)
    relief += rng.uniform(0.03, 0.07) * _between(y, at(0.55), at(0.9), 0.05)
    grille = at(rng.uniform(0.14, 0.2)), at(rng.uniform(0.42, 0.5))
    draw_grille(canvas, rng, grille[0] / tall, grille[1] / tall)
    inside = _between(y, *grille, 0.03) * _between(np.abs(x), -1.0, 0.22 * wide, 0.03)
    relief, gloss = relief - 0.035 * inside, gloss - (1 - MATT) * inside
    intake = at(0.78), at(0.92)
    canvas.box(0.14, intake[0] / tall, 0.86, intake[1] / tall, rng.uniform(15, 35))
    inside = _between(y, *intake, 0.03) * _between(np.abs(x), -1.0, 0.36 * wide, 0.03)
    relief, gloss = relief - 0.04 * inside, gloss - (1 - MATT) * inside
    canvas.box(0, at(0.54) / tall, 1, at(0.565) / tall, paint * 0.5)
    draw_plate(canvas, rng, at(rng.uniform(0.62, 0.7)) / tall)
    side_m, up_m, inside = _lamps(canvas, glow, rng, x, y, at(rng.uniform(0.22, 0.36)))
    relief += rng.uniform(0.0, 0.03) * inside
    # Rounded edges, which reflect light from all directions.
    for gap, depth, radius in ((y, 0.06, 0.03), (wide / 2 - np.abs(x), 0.08, 0.035),
                               (tall - y, 0.05, 0.03)):
        relief -= depth * np.exp(-gap / radius)
    if body.relief_m:
        relief += body.relief_m * octaves(
            rng, x.shape[0], x.shape[1], max(x.shape) // RELIEF_BUMPS)
    relief = np.asarray(cv2.GaussianBlur(relief, (0, 0), 1.5), np.float32)
    grey = finished(canvas, rng, TEXEL_M, PLAIN_SHADE, 3.0)
    lamps = cv2.resize(glow.image, grey.shape[::-1], interpolation=cv2.INTER_AREA)
    return Front(grey=grey, lamps=np.asarray(lamps, np.float32),
                 relief_m=relief - relief.max(), gloss=np.asarray(gloss, np.float32),
                 lamp_up_m=tall - up_m, lamp_side_m=side_m)


def _windscreen(canvas: Canvas, rng: np.random.Generator, low: float) -> None:
    """Draw the windscreen of a tall front, with its lower edge at a share of the height."""
    high = rng.uniform(0.05, 0.12) if canvas.height_m < 2 else rng.uniform(0.14, 0.22)
    canvas.polygon([(0.07, high), (0.93, high), (0.96, low - 0.03), (0.04, low - 0.03)],
                   rng.uniform(*GLASS))
    for x in rng.uniform((0.2, 0.65), (0.35, 0.8)):  # people, and papers behind the pane
        canvas.disc(x, low - 0.5 * (low - high), 0.12, rng.uniform(45, 80))
    x = rng.uniform(0.1, 0.8)
    canvas.box(x, low - 0.1, x + 0.1, low - 0.05, rng.uniform(90, 200))
    if high > 0.13:  # a sign, a destination, a maker's name
        canvas.box(0.15, 0.03, 0.85, high - 0.03, rng.uniform(25, 70))
        for x in np.arange(0.2, 0.78, 0.07):
            canvas.box(x, 0.05, x + rng.uniform(0.02, 0.05), high - 0.05, rng.uniform(120, 210))


def _lamps(canvas: Canvas, glow: Canvas, rng: np.random.Generator, x: Image, y: Image,
           middle_m: float) -> tuple[float, float, Image]:
    """Draw the lamps and their light; return their position, m, and a mask of them."""
    wide, tall = canvas.width_m, canvas.height_m
    half, high = rng.uniform(0.11, 0.19), rng.uniform(0.045, 0.08)
    side_m = wide / 2 - rng.uniform(0.07, 0.11) - half
    lens, even = rng.uniform(150, 225), float(rng.choice([1.0, 0.15]))
    radius = rng.uniform(0.03, 0.045)
    for side in (-1, 1):
        cx = 0.5 + side * side_m / wide
        for grow, grey in ((0.03, 25.0), (0.0, lens)):
            canvas.box(cx - (half + grow) / wide, (middle_m - high - grow) / tall,
                       cx + (half + grow) / wide, (middle_m + high + grow) / tall, grey)
        glow.box(cx - (half - 0.01) / wide, (middle_m - high + 0.01) / tall,
                 cx + (half - 0.01) / wide, (middle_m + high - 0.01) / tall, even)
        for share in (-0.45, 0.45):
            at = cx + share * half / wide, middle_m / tall
            canvas.disc(*at, radius, 0.7 * lens)
            glow.disc(*at, radius, 1.0)
    inside = (_between(y, middle_m - high, middle_m + high, 0.03)
              * _between(np.abs(x), side_m - half, side_m + half, 0.03))
    return side_m, middle_m, inside


def beam(pose: FrontPose, at_m: Array) -> float:
    """Return the share of a headlamp's light towards the camera, 1 straight ahead."""
    ahead, left, up = -at_m @ pose.axes
    tilt, turn = (math.degrees(math.atan2(k, abs(ahead))) for k in (up, left))
    share = math.exp(-((tilt / BEAM_DEG[0]) ** 2 + (turn / BEAM_DEG[1]) ** 2) / 2)
    return BEAM_FLOOR + (1 - BEAM_FLOOR) * share


class SolidAppearance(Appearance):
    """
    The appearance of a vehicle with a non-planar front.

    :param body: its size, lamps and gloss.
    :param rng: source of its textures.
    """

    def __init__(self, body: BodyConfig, rng: np.random.Generator) -> None:
        self._measure(body, False)
        paint = float(rng.choice([rng.uniform(25, 60), rng.uniform(60, 130),
                                  rng.uniform(130, 180)]))
        self._dress(rng, paint)
        front = draw_front(rng, body, paint)
        self.tracked = self._contrasted(front.grey)
        self.relief_m = front.relief_m
        wide = body.width_m
        self._surface = Surface.of(front.relief_m, (wide, body.front_m), body.gloss * front.gloss)
        self._glow = Texture.of(front.lamps)
        up = body.clearance_m + front.lamp_up_m
        self.lamp_places = np.array([(0.0, side * front.lamp_side_m, up) for side in (-1, 1)])
        self.lamp_grey = body.lamp_grey
        self._hood = _sheet_of(rng, wide, max(body.bonnet_m, 0.3), paint)
        self._pane = _pane_of(rng, wide, 0.9, paint)
        self._hood_surface = _crowned(wide, max(body.bonnet_m, 0.3), 0.03, body.gloss)
        self._pane_surface = _crowned(wide, 0.9, 0.08, body.gloss)
        self._trim, self._tyre = Texture.plain(0.6 * paint), Texture.plain(16.0)

    def planes(self, pose: FrontPose) -> list[Plane]:
        """Return the pieces in the order of drawing, the tracked front and its lamps last."""
        *behind, tracked = super().planes(pose)
        tracked = replace(tracked, surface=self._surface)
        planes = [*behind, *self._wheels(pose), tracked]
        if self.body.lamp_grey > 0:
            planes.append(replace(tracked, texture=self._glow, surface=None,
                                  emits=self.body.lamp_grey * beam(pose, pose.centre_m)))
        return planes

    def _wheels(self, pose: FrontPose) -> list[Plane]:
        """Return the visible parts of the front wheels, and the mirrors."""
        body = self.body
        half, low = body.width_m / 2, body.clearance_m
        tall = body.front_m > 1.5
        mirror = (0.2, low + 1.9, 0.22, 0.5) if tall else (
            body.bonnet_m + 0.3, low + min(body.front_m, 0.95) + 0.02, 0.2, 0.14)
        out = []
        for side in (-1, 1):
            for back, up, middle, wide, high, texture in (
                    (0.5, low + 0.1, half - 0.15, 0.22, low + 0.1, self._tyre),
                    (mirror[0], mirror[1] + mirror[3], half + mirror[2] / 2 + 0.03, *mirror[2:],
                     self._trim)):
                corner = pose.origin_m + pose.axes @ np.array(
                    [-back, side * middle - wide / 2, up])
                out.append(Plane(corner, pose.axes[:, 1] * wide, -pose.axes[:, 2] * high,
                                 texture))
        return out

    def _tops(self, at: At) -> list[Plane]:
        """Return roof, windscreen and bonnet with their shape and gloss."""
        tops = super()._tops(at)
        if self.body.cab_m or self.body.bonnet_m <= 0:
            return tops
        rear, roof, screen, hood = tops
        return [rear, roof,
                replace(screen, texture=self._pane, fine=True, surface=self._pane_surface),
                replace(hood, texture=self._hood, fine=True, surface=self._hood_surface)]


def _crowned(width_m: float, length_m: float, crown_m: float, gloss: float) -> Surface:
    """Return the shape of a sheet that is curved across and rounded at its lower edge."""
    x, y = np.meshgrid(np.linspace(-1, 1, 64), (np.arange(48) + 0.5) / 48 * length_m)
    relief = -crown_m * x ** 2 - 0.04 * np.exp((y - length_m) / 0.05)
    return Surface.of(relief.astype(np.float32), (width_m, length_m),
                      np.full(relief.shape, gloss, np.float32))


def _sheet_of(rng: np.random.Generator, width_m: float, length_m: float,
              paint: float) -> Texture:
    """Draw a bonnet with its creases and gaps."""
    canvas = Canvas(width_m, length_m, paint, SHAPE_M)
    inset, crease = rng.uniform(0.04, 0.08), rng.uniform(0.15, 0.35)
    for x0, x1, width, grey in ((inset, inset, 0.006, 0.45), (crease, crease + 0.05, 0.01, 1.2)):
        for mirrored in (False, True):
            ends = [(x1 - width, 0.0), (x1 + width, 0.0), (x0 + width, 1.0), (x0 - width, 1.0)]
            canvas.polygon([(1 - x, y) if mirrored else (x, y) for x, y in ends], paint * grey)
    canvas.box(0.05, 0.0, 0.95, 0.06, 22.0)  # wipers
    return Texture.of(finished(canvas, rng, SHAPE_M, PLAIN_SHADE, 2.0))


def _pane_of(rng: np.random.Generator, width_m: float, length_m: float, paint: float) -> Texture:
    """Draw a windscreen between its pillars, with the people behind it."""
    canvas, cover = (Canvas(width_m, length_m, grey, SHAPE_M) for grey in (0.8 * paint, 0.0))
    glass = rng.uniform(*GLASS)
    canvas.polygon([(0.11, 0.05), (0.89, 0.05), (0.95, 1.0), (0.05, 1.0)], glass)
    for x in (0.3, 0.7):
        canvas.disc(x, 0.42, 0.09, glass + rng.uniform(8, 40))
        canvas.box(x - 0.1, 0.5, x + 0.1, 0.8, glass + rng.uniform(5, 30))
    canvas.box(0.46, 0.06, 0.54, 0.16, 18.0)
    canvas.box(0.05, 0.86, 0.95, 0.94, glass + rng.uniform(5, 15))
    cover.polygon([(0.05, 0.0), (0.95, 0.0), (1.0, 1.0), (0.0, 1.0)], 1.0)
    grey = finished(canvas, rng, SHAPE_M, PLAIN_SHADE, 2.0)
    alpha = cv2.resize(cover.image, grey.shape[::-1], interpolation=cv2.INTER_AREA)
    return Texture.of(grey, np.asarray(alpha, np.float32))
