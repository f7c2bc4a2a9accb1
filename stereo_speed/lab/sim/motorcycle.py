# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A motorcycle with its rider: narrow pieces at many depths."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable, Optional

import cv2
import numpy as np

from .appearance import finished, GLASS, RELIEF_BUMPS
from .bodies import BodyConfig
from .planes import Plane, Texture
from .scene import FrontPose
from .solids import beam
from .surface import Surface
from .texture import Canvas, Image, octaves
from ...core.records import Array

TEXEL_M = 0.005
WHEEL_M = 0.31  # radius of the wheels

Drawing = Callable[[Canvas, Canvas], None]


@dataclass(frozen=True, eq=False)
class Piece:
    """
    A piece perpendicular to the road.

    :param ahead_m: position ahead of the plane of fork and headlamp, m; negative is behind.
    :param up_m: height of its upper edge, m.
    :param width_m: its width, m.
    :param height_m: its height, m.
    :param texture: grey levels and cover.
    :param relief_m: its relief, or None.
    :param surface: its shape and gloss, or None.
    :param glow: texture of its lamp's light, or None.
    :param side_m: position of its middle to the left, m.
    """

    ahead_m: float
    up_m: float
    width_m: float
    height_m: float
    texture: Texture
    relief_m: Optional[Image] = None
    surface: Optional[Surface] = None
    glow: Optional[Texture] = None
    side_m: float = 0.0


class MotorcycleAppearance:
    """
    The appearance of a motorcycle and its rider, from ahead or from behind.

    :param body: size, lamps and gloss; heights scale with ``roof_m``, widths with ``width_m``.
    :param rear: whether it is seen from behind; its tracked plane is then that of lamp and plate.
    :param rng: source of its textures.
    """

    def __init__(self, body: BodyConfig, rear: bool, rng: np.random.Generator) -> None:
        self.body, self.rear = body, rear
        self.lamp_grey: Optional[float] = body.lamp_grey
        self._rng = rng
        self._tall, self._wide = body.roof_m / 1.62, body.width_m / 0.8
        self._jacket, self._helmet = rng.uniform(20, 110), rng.uniform(25, 220)
        self._paint = float(rng.choice([rng.uniform(20, 60), rng.uniform(60, 190)]))
        lamp_up = (0.62 if rear else 0.86) * self._tall
        self.lamp_places: Array = np.array([(0.0, 0.0, lamp_up)])
        self._pieces = self._seen_from_behind() if rear else self._seen_from_ahead()

    def planes(self, pose: FrontPose) -> list[Plane]:
        """Return the pieces in the order of drawing, the farthest first."""
        sign = -1 if self.rear else 1
        ahead, left, up = pose.axes.T
        # The image's left is the right side of an approaching vehicle, the left of a receding one.
        out = []
        for piece in self._pieces:
            across = left * sign * piece.width_m
            middle = pose.origin_m + ahead * sign * piece.ahead_m + left * piece.side_m
            corner = middle - across / 2 + up * piece.up_m
            down = -up * piece.height_m
            out.append(Plane(corner, across, down, piece.texture, True, piece.relief_m,
                             piece.surface))
            if piece.glow is not None and self.body.lamp_grey > 0:
                share = 0.1 if self.rear else beam(pose, corner)
                out.append(Plane(corner, across, down, piece.glow, True, piece.relief_m,
                                 emits=self.body.lamp_grey * share))
        return out

    def _piece(self, ahead_m: float, up_m: float, width_m: float, height_m: float, grey: float,
               draw: Drawing, round_m: float = 0.0, gloss: float = 0.0, side_m: float = 0.0,
               bumps_m: float = 0.0, glow: Optional[Drawing] = None) -> Piece:
        """
        Draw a piece; heights and widths are in metres for an average rider.

        :param round_m: how far its middle protrudes from its edges.
        """
        wide, tall = width_m * self._wide, height_m * self._tall
        canvas, cover = (Canvas(wide, tall, level, TEXEL_M) for level in (grey, 0.0))
        draw(canvas, cover)
        image = finished(canvas, self._rng, TEXEL_M, 0.1, 5.0)
        mean = image.mean()
        image = np.clip(mean + self.body.contrast * (image - mean), 5, 250).astype(np.float32)
        size = image.shape[::-1]
        alpha = np.asarray(cv2.resize(cover.image, size, interpolation=cv2.INTER_AREA), np.float32)
        y, x = np.mgrid[-1:1:image.shape[0] * 1j, -1:1:image.shape[1] * 1j].astype(np.float32)
        relief = -np.float32(round_m) * (np.square(x) + 0.4 * np.square(y))
        if bumps_m:
            relief += np.float32(bumps_m) * octaves(
                self._rng, relief.shape[0], relief.shape[1], max(relief.shape) // RELIEF_BUMPS)
        shine = None
        if glow is not None:
            light = Canvas(wide, tall, 0.0, TEXEL_M)
            glow(light, light)
            shine = Texture.of(np.asarray(
                cv2.resize(light.image, size, interpolation=cv2.INTER_AREA), np.float32))
        surface = Surface.of(relief, (wide, tall),
                             np.full(relief.shape, gloss * self.body.gloss, np.float32))
        return Piece(ahead_m, up_m * self._tall, wide, tall, Texture.of(image, alpha), relief,
                     surface, shine, side_m * self._wide)

    def _rider(self, ahead_m: float, behind: bool) -> list[Piece]:
        """Return torso, arms and helmet, with the torso at a position ahead."""
        rng, toward = self._rng, 1 if not behind else -1
        stripe = rng.uniform(20, 230)

        def torso(canvas: Canvas, cover: Canvas) -> None:
            cover.polygon([(0.2, 0.0), (0.8, 0.0), (1.0, 0.25), (0.88, 1.0), (0.12, 1.0),
                           (0.0, 0.25)], 1.0)
            canvas.box(0.0, 0.34, 1.0, 0.42, stripe)
            canvas.box(0.485, 0.0, 0.515, 1.0, 0.5 * self._jacket)
            for side in (0.3, 0.7):
                canvas.box(side - 0.08, 0.5, side + 0.08, 0.54, 1.6 * self._jacket)

        def limb(canvas: Canvas, cover: Canvas) -> None:
            cover.box(0.0, 0.0, 1.0, 1.0, 1.0)
            canvas.box(0.0, 0.62, 1.0, 0.72, stripe)

        def helmet(canvas: Canvas, cover: Canvas) -> None:
            cover.disc(0.5, 0.5, 0.5 * cover.height_m, 1.0)
            if not behind:
                canvas.polygon([(0.12, 0.4), (0.88, 0.4), (0.8, 0.68), (0.2, 0.68)],
                               rng.uniform(*GLASS))
            canvas.box(0.42, 0.0, 0.58, 0.3, rng.uniform(20, 230))
        arms = [self._piece(ahead_m + toward * 0.3, 1.22, 0.11, 0.38, 0.9 * self._jacket, limb,
                            0.04, side_m=side) for side in (-0.31, 0.31)]
        return [self._piece(ahead_m, 1.38, 0.52, 0.62, self._jacket, torso, 0.12, 0.1), *arms,
                self._piece(ahead_m + toward * 0.15, 1.62, 0.26, 0.27, self._helmet, helmet, 0.11,
                            0.9)]

    def _wheel(self, ahead_m: float) -> Piece:
        """Return a tyre seen along the road, with its foremost point at a position ahead."""
        def tyre(canvas: Canvas, cover: Canvas) -> None:
            cover.box(0.08, 0.0, 0.92, 1.0, 1.0)
            for y in np.arange(0.05, 1.0, 0.06):
                canvas.box(0.2, y, 0.8, y + 0.015, 10.0)
        piece = self._piece(ahead_m, 2 * WHEEL_M, 0.13, 2 * WHEEL_M, 30.0, tyre)
        rows = piece.texture.size[1]
        height = (np.arange(rows) + 0.5) / rows * 2 - 1
        depth = WHEEL_M * (np.sqrt(np.maximum(1 - 0.92 * height ** 2, 0.02)) - 1)
        relief = np.repeat(depth.astype(np.float32)[:, None], piece.texture.size[0], axis=1)
        return replace(piece, relief_m=relief)

    def _seen_from_ahead(self) -> list[Piece]:
        rng, paint = self._rng, self._paint

        def knees(canvas: Canvas, cover: Canvas) -> None:
            for x in (0.14, 0.86):
                cover.box(x - 0.12, 0.0, x + 0.12, 1.0, 1.0)
                canvas.box(x - 0.12, 0.7, x + 0.12, 1.0, 25.0)
            cover.box(0.3, 0.1, 0.7, 0.8, 1.0)
            canvas.box(0.3, 0.1, 0.7, 0.8, 0.7 * paint)

        def bars(canvas: Canvas, cover: Canvas) -> None:
            for side in (0.0, 0.8):
                cover.box(side, 0.55, side + 0.2, 0.85, 1.0)  # grips and gloves
                cover.box(side + 0.02, 0.0, side + 0.18, 0.36, 1.0)  # mirrors
                canvas.box(side + 0.02, 0.0, side + 0.18, 0.36, rng.uniform(20, 60))
            for x in (0.16, 0.8):
                cover.box(x, 0.3, x + 0.04, 0.6, 1.0)
            cover.box(0.0, 0.66, 1.0, 0.76, 1.0)

        def fork(canvas: Canvas, cover: Canvas) -> None:
            for x in (0.0, 0.76):
                cover.box(x, 0.0, x + 0.24, 1.0, 1.0)
                canvas.box(x + 0.05, 0.0, x + 0.13, 1.0, 170.0)

        def fairing(canvas: Canvas, cover: Canvas) -> None:
            cover.polygon([(0.3, 0.0), (0.7, 0.0), (0.86, 0.35), (1.0, 0.55), (0.8, 0.9),
                           (0.62, 1.0), (0.38, 1.0), (0.2, 0.9), (0.0, 0.55), (0.14, 0.35)], 1.0)
            canvas.polygon([(0.32, 0.02), (0.68, 0.02), (0.82, 0.36), (0.18, 0.36)],
                           rng.uniform(45, 90))  # the tinted screen
            canvas.box(0.24, 0.5, 0.76, 0.74, 25.0)
            canvas.box(0.27, 0.52, 0.73, 0.72, rng.uniform(140, 210))
            for x in (0.04, 0.84):
                canvas.box(x, 0.5, x + 0.12, 0.58, rng.uniform(120, 200))
            canvas.box(0.46, 0.78, 0.54, 0.86, rng.uniform(100, 220))

        def light(canvas: Canvas, _: Canvas) -> None:
            canvas.box(0.27, 0.53, 0.73, 0.71, 0.2)
            canvas.disc(0.5, 0.62, 0.05, 1.0)

        def guard(canvas: Canvas, cover: Canvas) -> None:
            cover.polygon([(0.15, 0.0), (0.85, 0.0), (1.0, 1.0), (0.0, 1.0)], 1.0)
        boxes = []
        if rng.random() < 0.4:
            boxes = [self._piece(-1.5, 0.92, 0.28, 0.42, 45.0, _filled, 0.05, 0.3, side)
                     for side in (-0.32, 0.32)]
        return [*boxes, *self._rider(-0.95, False),
                self._piece(-0.6, 0.84, 0.6, 0.5, self._jacket, knees, 0.06),
                self._piece(-0.22, 1.26, 0.8, 0.36, 28.0, bars),
                self._wheel(0.5),
                self._piece(0.02, 0.72, 0.3, 0.42, 60.0, fork, 0.02),
                self._piece(0.36, 0.68, 0.17, 0.2, paint, guard, 0.04, 0.8),
                self._piece(0.0, 1.24, 0.5, 0.62, paint, fairing, 0.14, 1.0,
                            bumps_m=self.body.relief_m, glow=light)]

    def _seen_from_behind(self) -> list[Piece]:
        rng = self._rng

        def tail(canvas: Canvas, cover: Canvas) -> None:
            cover.polygon([(0.2, 0.0), (0.8, 0.0), (0.7, 0.4), (0.7, 1.0), (0.3, 1.0),
                           (0.3, 0.4)], 1.0)
            canvas.box(0.32, 0.05, 0.68, 0.25, rng.uniform(60, 110))
            canvas.box(0.3, 0.45, 0.7, 0.95, rng.uniform(180, 225))
            for x in (0.36, 0.48, 0.6):
                canvas.box(x, 0.52, x + 0.06, 0.88, 35.0)

        def light(canvas: Canvas, _: Canvas) -> None:
            canvas.box(0.34, 0.07, 0.66, 0.23, 1.0)
        panniers = [self._piece(-0.1, 0.86, 0.26, 0.4, 45.0, _filled, 0.04, 0.3, side)
                    for side in (-0.3, 0.3)]
        return [self._piece(-1.3, 1.26, 0.8, 0.2, 28.0, _filled), *self._rider(-0.55, True),
                self._wheel(0.05), *panniers,
                self._piece(0.0, 0.72, 0.45, 0.4, self._paint, tail, 0.03, 0.6,
                            bumps_m=self.body.relief_m, glow=light)]


def _filled(canvas: Canvas, cover: Canvas) -> None:
    """Fill a whole piece, with a dark band."""
    cover.box(0.0, 0.0, 1.0, 1.0, 1.0)
    canvas.box(0.0, 0.42, 1.0, 0.48, 20.0)
