# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Procedural grey textures: the front of a vehicle, and noise for the ground."""
from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Image = NDArray[np.float32]

TEXEL_M = 0.004  # texel size of the finest level of a front
_DRAW = 2  # texels of the drawing per texel of the finest level


def octaves(rng: np.random.Generator, height: int, width: int, finest: int) -> Image:
    """
    Make noise of equal strength per octave, with standard deviation 1.

    Sizes that are multiples of all cells (powers of two) give a pattern that tiles.

    :param rng: source of randomness.
    :param height: rows.
    :param width: columns.
    :param finest: shortest wavelength is about twice this many texels.
    """
    total = np.zeros((height, width), np.float32)
    cell, count = finest, 0
    while cell * 2 < max(height, width):
        coarse = rng.standard_normal((-(-height // cell), -(-width // cell)), dtype=np.float32)
        rows, columns = (_enlarging(n, cell, size)
                         for n, size in zip(coarse.shape, (height, width)))
        total += rows @ np.pad(coarse, 2, mode='wrap') @ columns.T
        cell, count = cell * 2, count + 1
    total -= total.mean()
    return (total / max(float(total.std()), 1e-6)).astype(np.float32)


def _enlarging(count: int, cell: int, size: int) -> Image:
    """Return the matrix (size, count + 4) that interpolates padded samples cubically."""
    samples = np.eye(count + 4, dtype=np.float32)
    fine = cv2.resize(samples, None, fx=1, fy=cell, interpolation=cv2.INTER_CUBIC)
    return np.asarray(fine[2 * cell:2 * cell + size], np.float32)


class Canvas:
    """A drawing in metres from the front's top-left corner, with 8 fractional bits."""

    def __init__(self, width_m: float, height_m: float, grey: float,
                 texel_m: float = TEXEL_M) -> None:
        self.scale = _DRAW / texel_m
        shape = (round(height_m * self.scale), round(width_m * self.scale))
        self.image = np.full(shape, grey, np.float32)
        self.width_m, self.height_m = width_m, height_m

    def _fixed(self, points_m: ArrayLike) -> NDArray[np.int32]:
        return np.round((np.asarray(points_m) * self.scale - 0.5) * 256).astype(np.int32)

    def polygon(self, points: list[tuple[float, float]], grey: float) -> None:
        """Fill a polygon given in shares of the front's width and height."""
        metres = np.asarray(points) * [self.width_m, self.height_m]
        cv2.fillPoly(self.image, [self._fixed(metres)], float(grey), cv2.LINE_8, 8)

    def box(self, x0: float, y0: float, x1: float, y1: float, grey: float) -> None:
        """Fill a rectangle given in shares of the front's width and height."""
        self.polygon([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], grey)

    def disc(self, x: float, y: float, radius_m: float, grey: float) -> None:
        """Fill a disc whose centre is given in shares of width and height."""
        centre = self._fixed([x * self.width_m, y * self.height_m])
        cv2.circle(self.image, (int(centre[0]), int(centre[1])),
                   round(radius_m * self.scale * 256), float(grey), -1, cv2.LINE_8, 8)


def draw_grille(canvas: Canvas, rng: np.random.Generator, top: float, bottom: float) -> None:
    """Draw a grille between two shares of a front's height."""
    left = rng.uniform(0.24, 0.32)
    canvas.box(left, top, 1 - left, bottom, rng.uniform(20, 45))
    slats = int(rng.integers(3, 6))
    bright = rng.uniform(90, 170)
    for i in range(slats):
        y = top + (bottom - top) * (i + 0.5) / slats
        canvas.box(left + 0.01, y - 0.012, 1 - left - 0.01, y + 0.012, bright)
    if rng.random() < 0.7:  # a badge
        canvas.disc(0.5, (top + bottom) / 2, rng.uniform(0.03, 0.06), rng.uniform(140, 220))


def _draw_lights(canvas: Canvas, rng: np.random.Generator, top: float, bottom: float) -> None:
    width, slant = rng.uniform(0.14, 0.2), rng.uniform(0.0, 0.08)
    grey, rim = rng.uniform(170, 230), rng.uniform(40, 70)
    inner = rng.uniform(0.03, 0.06)
    for side in (0, 1):
        def at(x: float, y: float) -> tuple[float, float]:
            return (x if side == 0 else 1 - x), y
        canvas.polygon([at(0.02, top), at(0.02 + width, top + slant),
                        at(0.02 + width, bottom), at(0.03, bottom)], rim)
        canvas.polygon([at(0.03, top + 0.02), at(0.01 + width, top + slant + 0.02),
                        at(0.01 + width, bottom - 0.02), at(0.04, bottom - 0.02)], grey)
        canvas.disc(*at(0.03 + width * 0.55, (top + slant + bottom) / 2), inner, rim)


def draw_plate(canvas: Canvas, rng: np.random.Generator, y: float) -> None:
    """Draw a number plate centred at a share of a front's height."""
    half = 0.26 / canvas.width_m
    tall = 0.055 / canvas.height_m
    canvas.box(0.5 - half, y - tall, 0.5 + half, y + tall, rng.uniform(200, 235))
    step = 2 * half / 9
    for i in range(8):
        x = 0.5 - half + step * (i + 0.75)
        for _ in range(3):  # strokes of a character
            dx, dy = rng.uniform(0, 0.6 * step), rng.uniform(-0.75, 0.45) * tall
            upright = rng.random() < 0.5
            canvas.box(x + dx, y + dy, x + dx + (0.18 if upright else 0.6) * step,
                       y + dy + (0.75 if upright else 0.2) * tall, 30)


def front_texture(rng: np.random.Generator, width_m: float, height_m: float) -> Image:
    """
    Make the front of a vehicle, as seen by the camera.

    :param rng: source of randomness; each state gives another vehicle.
    :param width_m: width, m.
    :param height_m: height, m.
    :return: (rows, columns) float32 grey levels at ``TEXEL_M``.
    """
    body = rng.uniform(60, 165)
    canvas = Canvas(width_m, height_m, body)
    top = max(0.0, 1 - 0.8 / height_m)  # above this a tall front has its windscreen
    if top > 0.15:
        canvas.polygon([(0.08, 0.06), (0.92, 0.06), (0.96, top - 0.03), (0.04, top - 0.03)],
                       rng.uniform(25, 50))

    def y(share: float) -> float:
        return top + (1 - top) * share
    canvas.box(0, y(0.0), 1, y(0.06), body * 1.15)
    draw_grille(canvas, rng, y(rng.uniform(0.12, 0.2)), y(rng.uniform(0.42, 0.5)))
    _draw_lights(canvas, rng, y(rng.uniform(0.1, 0.2)), y(rng.uniform(0.4, 0.5)))
    canvas.box(0, y(0.54), 1, y(0.57), body * 0.55)
    draw_plate(canvas, rng, y(rng.uniform(0.64, 0.72)))
    canvas.box(0.2, y(0.8), 0.8, y(0.93), rng.uniform(20, 45))
    for x in (0.11, 0.89):
        canvas.disc(x, y(0.84), 0.05, rng.uniform(120, 200))
    rows, columns = round(height_m / TEXEL_M), round(width_m / TEXEL_M)
    image = cv2.resize(canvas.image, (columns, rows), interpolation=cv2.INTER_AREA)
    shade = np.linspace(1.12, 0.82, rows, dtype=np.float32)[:, None]
    image = image * shade + rng.uniform(4, 8) * octaves(rng, rows, columns, 6)
    # Rounded edges and optics: no detail is finer than a few millimetres.
    image = cv2.GaussianBlur(image, (0, 0), 1.5, borderType=cv2.BORDER_REPLICATE)
    return np.clip(image, 5, 250).astype(np.float32)


def pyramid(image: Image, levels: int) -> list[Image]:
    """
    Build an image pyramid by exact area averages.

    :param image: float32; borders are repeated up to a multiple of ``2**levels``.
    :param levels: number of levels beside the first.
    """
    out: list[Image] = [image]
    for _ in range(levels):
        odd = [n % 2 for n in out[-1].shape]
        if any(odd):
            out[-1] = np.pad(out[-1], ((0, odd[0]), (0, odd[1])), mode='edge')
        rows, columns = out[-1].shape
        half = cv2.resize(out[-1], (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
        out.append(np.asarray(half, dtype=np.float32))
    return out
