# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Appearance of vehicles: the textured planes of their bodies."""
from __future__ import annotations

from typing import Callable, Optional

import cv2
import numpy as np

from .bodies import BodyConfig
from .planes import Plane, Texture
from .scene import FrontPose
from .texture import Canvas, front_texture, Image, octaves
from ...core.records import Array

TEXEL_M = 0.01  # texel size of all planes except front and rear
DIRT = 4  # size of the finest dirt, texels
RELIEF_BUMPS = 12  # number of bumps of the finest relief across a front
GLASS = (24.0, 48.0)  # darkest and brightest grey level of a pane


def finished(canvas: Canvas, rng: np.random.Generator, texel_m: float, shade: float = 0.15,
             grain: float = 4.0) -> Image:
    """Reduce a drawing to its texels, with shading from top to bottom and some dirt."""
    rows, columns = (max(round(side / texel_m), 2)
                     for side in (canvas.height_m, canvas.width_m))
    image = cv2.resize(canvas.image, (columns, rows), interpolation=cv2.INTER_AREA)
    image = image * np.linspace(1 + shade, 1 - shade, rows, dtype=np.float32)[:, None]
    coarse = octaves(rng, -(-rows // DIRT) + 1, -(-columns // DIRT) + 1, 1)
    dirt = cv2.resize(coarse, None, fx=DIRT, fy=DIRT, interpolation=cv2.INTER_LINEAR)
    image += np.float32(grain) * np.asarray(dirt, np.float32)[:rows, :columns]
    image = cv2.GaussianBlur(image, (0, 0), 1.0, borderType=cv2.BORDER_REPLICATE)
    return np.clip(image, 5, 250).astype(np.float32)


def rear_texture(rng: np.random.Generator, width_m: float, height_m: float,
                 paint: float) -> Image:
    """
    Make the rear of a vehicle, as seen by the camera behind it.

    :param rng: source of randomness.
    :param width_m: width, m.
    :param height_m: height, m.
    :param paint: grey level of the body.
    """
    canvas = Canvas(width_m, height_m, paint)
    top = max(0.0, 1 - 0.85 / height_m)  # above this a tall rear has doors
    if top > 0.3:
        for x0, x1 in ((0.07, 0.47), (0.53, 0.93)):
            canvas.box(x0, 0.08, x1, max(top * 0.6, 0.2), rng.uniform(*GLASS))
        canvas.box(0.495, 0.03, 0.505, 0.95, paint * 0.4)

    def y(share: float) -> float:
        return top + (1 - top) * share
    canvas.box(0, y(0.0), 1, y(0.05), paint * 1.15)
    lamp, tall = rng.uniform(0.09, 0.17), rng.uniform(0.18, 0.32)
    upper = rng.uniform(0.1, 0.22)
    for side in (0.0, 1.0):
        x0, x1 = sorted((abs(side - 0.02), abs(side - 0.02 - lamp)))
        canvas.box(x0, y(upper), x1, y(upper + tall), rng.uniform(48, 75))
        x0, x1 = sorted((abs(side - 0.03), abs(side - 0.02 - lamp * 0.55)))
        canvas.box(x0, y(upper + 0.02), x1, y(upper + tall * 0.5), rng.uniform(110, 170))
    half, tall = 0.26 / width_m, 0.055 / height_m
    plate = y(rng.uniform(0.36, 0.5))
    canvas.box(0.5 - half, plate - tall, 0.5 + half, plate + tall, rng.uniform(190, 230))
    for x in np.linspace(0.5 - 0.8 * half, 0.5 + 0.8 * half, 7):
        canvas.box(x, plate - 0.6 * tall, x + 0.06 * half, plate + 0.5 * tall, 35)
    canvas.box(0.0, y(0.66), 1.0, y(0.69), paint * 0.5)
    canvas.box(0.04, y(0.76), 0.96, y(0.9), rng.uniform(25, 60))
    canvas.disc(0.5, y(0.2), rng.uniform(0.03, 0.05), rng.uniform(150, 220))
    return finished(canvas, rng, 0.004, grain=6.0)


def _side(rng: np.random.Generator, body: BodyConfig, paint: float) -> Texture:
    """Make the left side; the front is at the texture's left."""
    canvas = Canvas(body.length_m, body.roof_m, paint * 0.72, TEXEL_M)
    mask = Canvas(body.length_m, body.roof_m, 0.0, TEXEL_M)

    def at(back_m: float, up_m: float) -> tuple[float, float]:
        return back_m / body.length_m, 1 - up_m / body.roof_m
    L, low, roof = body.length_m, body.clearance_m, body.roof_m
    top = low + body.front_m
    if body.cab_m:
        outline = [at(0, low), at(0, top), at(body.cab_m, top), at(body.cab_m, roof), at(L, roof),
                   at(L, low)]
        canvas.box(*at(0.45, top - 0.35), *at(body.cab_m - 0.35, top - 1.0), rng.uniform(*GLASS))
        canvas.polygon([at(body.cab_m, 1.1), at(L, 1.1), at(L, roof), at(body.cab_m, roof)],
                       rng.uniform(70, 190))
    else:
        screen, back = body.bonnet_m + body.screen_m, L - (0.5 if body.kind == 'car' else 0.1)
        outline = [at(0, low), at(0, top), at(body.bonnet_m, top + 0.1), at(screen, roof),
                   at(back - 0.1, roof), at(L, low + body.rear_m), at(L, low)]
        glass, sill, head = rng.uniform(*GLASS), roof - 0.48, roof - 0.08
        if body.kind == 'van':
            canvas.polygon([at(screen - 0.35, sill), at(screen + 0.05, head),
                            at(screen + 0.8, head), at(screen + 0.8, sill)], glass)
        else:
            middle = (screen + back) / 2
            canvas.polygon([at(screen - 0.3, sill), at(screen + 0.08, head),
                            at(middle - 0.05, head), at(middle - 0.05, sill)], glass)
            canvas.polygon([at(middle + 0.05, sill), at(middle + 0.05, head),
                            at(back - 0.2, head), at(back + 0.05, sill)], glass)
        for x in (screen - 0.2, (screen + back) / 2, back - 0.3):
            canvas.box(*at(x - 0.01, low + 0.1), *at(x + 0.01, sill), paint * 0.4)
    canvas.box(*at(0, low + 0.28), *at(L, low + 0.2), paint * 0.5)
    mask.polygon(outline, 1.0)
    wheel = 0.31 if not body.cab_m else 0.48
    for x in ((0.85, L - 0.85) if not body.cab_m else (1.1, L - 2.3, L - 1.2)):
        for picture, level in ((mask, 1.0), (canvas, 20.0)):
            picture.disc(*at(x, wheel), wheel, level)
        canvas.disc(*at(x, wheel), 0.55 * wheel, rng.uniform(60, 130))
    grey = finished(canvas, rng, TEXEL_M)
    alpha = cv2.resize(mask.image, grey.shape[::-1], interpolation=cv2.INTER_AREA)
    return Texture.of(grey, np.asarray(alpha, np.float32))


def _flipped(texture: Texture) -> Texture:
    """Mirror a texture left to right."""
    columns, rows = texture.size
    alpha = texture.alpha or [np.ones_like(texture.grey[0])]
    share = alpha[0][:rows, :columns]
    grey = texture.grey[0][:rows, :columns] / np.maximum(share, 1e-3)
    return Texture.of(np.ascontiguousarray(grey[:, ::-1]), np.ascontiguousarray(share[:, ::-1]))


def _sheet(rng: np.random.Generator, width_m: float, length_m: float, paint: float,
           frame: Optional[float] = None) -> Texture:
    """Make a bonnet or roof, or a pane in its frame with the sky's reflections."""
    canvas = Canvas(width_m, max(length_m, 0.05), paint if frame is None else frame, 2 * TEXEL_M)
    if frame is not None:
        canvas.polygon([(0.1, 0.06), (0.9, 0.06), (0.96, 0.95), (0.04, 0.95)], paint)
        x = rng.uniform(0.1, 0.5)
        canvas.polygon([(x, 0.1), (x + 0.25, 0.1), (x + 0.12, 0.9), (x - 0.03, 0.9)],
                       paint * rng.uniform(1.2, 2.2))
    else:
        canvas.box(0.03, 0.04, 0.035, 0.96, paint * 0.7)
        canvas.box(0.965, 0.04, 0.97, 0.96, paint * 0.7)
    return Texture.of(finished(canvas, rng, 2 * TEXEL_M, 0.06, 2.0))


class Appearance:
    """
    The appearance of a vehicle.

    :param body: its size and finish; a body without a kind is only a front.
    :param rear: whether its rear is tracked instead of its front.
    :param rng: source of its textures.

    ``lamp_places`` (n, 3) are its lamps, in m ahead of the tracked front, to the left and above
    the road; ``lamp_grey`` is their grey level if drawn with the planes, else None.
    """

    lamp_places: Array
    lamp_grey: Optional[float]
    relief_m: Optional[Image]

    def __init__(self, body: BodyConfig, rear: bool, rng: np.random.Generator) -> None:
        self._measure(body, rear)
        image = front_texture(rng, body.width_m, body.front_m)
        paint = float(np.median(image)) if body.kind != 'truck' else rng.uniform(60, 170)
        if rear:
            image = rear_texture(rng, body.width_m, body.rear_m, paint)
        self.tracked = self._contrasted(image)
        if body.kind:
            self._dress(rng, paint)
        rows, columns = image.shape
        if body.relief_m:
            bumps = octaves(rng, rows, columns, max(rows, columns) // RELIEF_BUMPS)
            self.relief_m = np.float32(body.relief_m) * bumps

    def _measure(self, body: BodyConfig, rear: bool) -> None:
        """Set the attributes that depend only on the size."""
        self.body, self.rear = body, rear
        side = body.width_m / 2 - 0.25
        up = body.clearance_m + (0.35 if rear else 0.42)
        self.lamp_places = np.array([(0.0, -side, up), (0.0, side, up)])
        self.lamp_grey = None
        self.relief_m = None

    def _contrasted(self, image: Image) -> Texture:
        """Return a front with the configured contrast."""
        mean = image.mean()
        return Texture.of(np.clip(mean + self.body.contrast * (image - mean), 5, 250))

    def _dress(self, rng: np.random.Generator, paint: float) -> None:
        """Make all textures except the tracked front."""
        body = self.body
        left = _side(rng, body, paint)
        self.sides = (_flipped(left), left)  # right and left
        width = body.width_m
        self.roof = _sheet(rng, width, body.length_m, paint * 1.08)
        self.bonnet = _sheet(rng, width, max(body.bonnet_m, 0.5), paint * 1.03)
        self.screen = _sheet(rng, width, 1.0, rng.uniform(*GLASS), paint * 0.8)
        self.load = Texture.plain(paint * 0.9)
        self.under = Texture.plain(22.0)

    def planes(self, pose: FrontPose) -> list[Plane]:
        """
        Return the planes of the body in the order of drawing, the tracked front last.

        :param pose: pose of the tracked front.
        """
        body, rear = self.body, self.rear
        corners = pose.corners_m
        tracked = Plane(corners[0], corners[1] - corners[0], corners[3] - corners[0],
                        self.tracked, True, self.relief_m)
        if not body.kind:
            return [tracked]
        # Coordinates from the front, even if the rear is tracked: back, left, up.
        front = body.length_m if rear else 0.0

        def at(back: float, left: float, up: float) -> Array:
            return np.asarray(pose.origin_m + pose.axes @ np.array([front - back, left, up]))
        along, left, up = pose.axes.T
        half, low, roof, long = body.width_m / 2, body.clearance_m, body.roof_m, body.length_m
        # The image's left is the right side of an approaching vehicle.
        side = half - 0.1 if rear else 0.1 - half
        return [
            Plane(at(long, -half, roof), along * long, -up * roof, self.sides[0]),
            Plane(at(0, half, roof), -along * long, -up * roof, self.sides[1]),
            Plane(at(long if rear else 0, side, low), -left * 2 * side, -up * 0.8 * low,
                  self.under), *self._tops(at), tracked]

    def _tops(self, at: Callable[[float, float, float], Array]) -> list[Plane]:
        """Return roof, windscreen and bonnet, or the parts above a receding vehicle's rear."""
        body = self.body
        half, long, roof = body.width_m / 2, body.length_m, body.roof_m
        top = body.clearance_m + body.front_m

        def sloping(back0: float, up0: float, back1: float, up1: float, texture: Texture,
                    ) -> Plane:
            """Return the plane from the upper edge (0) to the lower one (1)."""
            corner = at(back0, -half, up0)
            return Plane(corner, at(back0, half, up0) - corner, at(back1, -half, up1) - corner,
                         texture)
        if body.cab_m:
            return [sloping(long, roof, body.cab_m, roof, self.roof),
                    sloping(body.cab_m, roof, body.cab_m, top, self.load),
                    sloping(body.cab_m, top, 0, top, self.roof)]
        screen = body.bonnet_m + body.screen_m
        end = long - (0.6 if body.kind == 'car' else 0.2)
        corner = at(end, half, roof)
        rear = Plane(corner, at(end, -half, roof) - corner,
                     at(long, half, body.clearance_m + body.rear_m) - corner, self.screen)
        return [rear, sloping(end, roof, screen, roof, self.roof),
                sloping(screen, roof, body.bonnet_m, top + 0.1, self.screen),
                sloping(body.bonnet_m, top + 0.1, 0, top, self.bonnet)]
