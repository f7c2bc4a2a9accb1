# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Textured rectangles, with or without relief, drawn by inverse mapping.

Each sub-pixel's ray goes through the true camera, meets the rectangle's plane or its relief, and
samples the texture averaged over about its own footprint; at edges it has the exact share of the
sub-pixel. Fine rectangles are accurate to well below a hundredth of a pixel.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .surface import Sky, Surface
from .texture import Image, pyramid
from .view import View
from ...core.records import Array

LEVELS = 6
SUB = 4  # sub-pixels across and down each pixel of a fine rectangle
RELIEF_STEPS = 4  # steps of the search for the intersection of a ray with the relief
NEAR_M = 0.6  # nothing nearer to a camera is drawn
_SHIFT = 4  # fractional bits of polygon corners

Box = tuple[int, int, int, int]


@dataclass(frozen=True, eq=False)
class Texture:
    """
    Grey levels and coverage, as an image pyramid with factor 2.

    :param grey: levels of float32 images; with ``alpha``, already multiplied by it.
    :param size: columns and rows of the first level, before padding.
    :param alpha: levels of the coverage, 0 to 1; None where it is 1 everywhere.
    """

    grey: list[Image]
    size: tuple[int, int]
    alpha: Optional[list[Image]] = None

    @classmethod
    def of(cls, grey: Image, alpha: Optional[Image] = None) -> Texture:
        """Build the pyramid of an image (rows, columns) and its coverage."""
        size = (grey.shape[1], grey.shape[0])
        if alpha is None:
            return cls(pyramid(grey, LEVELS), size)
        return cls(pyramid(grey * alpha, LEVELS), size, pyramid(alpha, LEVELS))

    @classmethod
    def plain(cls, grey: float) -> Texture:
        """Make a texture of one grey level."""
        return cls([np.full((2, 2), grey, np.float32)], (2, 2))


@dataclass(frozen=True, eq=False)
class Plane:
    """
    A textured rectangle in the left optical frame.

    :param corner_m: (3,), the texture's top-left corner.
    :param across_m: (3,), vector from there to its top-right corner.
    :param down_m: (3,), vector to its bottom-left corner, perpendicular to ``across_m``.
    :param texture: its texture.
    :param fine: whether to draw with ``SUB`` sub-pixels across a pixel instead of one.
    :param relief_m: (rows, columns), height of its relief over the plane; or None.
    :param surface: its shape and gloss for shading; None for matt and evenly lit.
    :param emits: grey level of a lamp, which adds light and covers nothing; or None.
    """

    corner_m: Array
    across_m: Array
    down_m: Array
    texture: Texture
    fine: bool = False
    relief_m: Optional[Image] = None
    surface: Optional[Surface] = None
    emits: Optional[float] = None

    @cached_property
    def outline_m(self) -> Array:
        """Return its corners (4, 3), clockwise from the top-left one."""
        a, b = self.across_m, self.down_m
        return self.corner_m + np.stack([0 * a, a, a + b, b])

    @cached_property
    def normal(self) -> Array:
        """Return a normal vector (3,), towards the side from which the texture is not mirrored."""
        (a, b, c), (x, y, z) = self.down_m.tolist(), self.across_m.tolist()
        return np.array([b * z - c * y, c * x - a * z, a * y - b * x])  # faster than np.cross


def clip_near(points_m: Array, near_m: float = NEAR_M) -> Array:
    """
    Clip a polygon at a plane in front of the camera.

    :param points_m: (n, 3), corners in the camera's frame.
    :return: (m, 3), corners with z of at least ``near_m``; may be empty.
    """
    z = points_m[:, 2] - near_m
    if (z >= 0).all():
        return points_m
    out = []
    for i in range(len(points_m)):
        j = (i + 1) % len(points_m)
        if z[i] >= 0:
            out.append(points_m[i])
        if (z[i] >= 0) != (z[j] >= 0):
            share = z[i] / (z[i] - z[j])
            out.append(points_m[i] + share * (points_m[j] - points_m[i]))
    return np.array(out).reshape(-1, 3)


class Eye:
    """
    A view with its cached rays.

    :param view: the view.
    """

    def __init__(self, view: View) -> None:
        self.view = view
        self.centre_m = view.centre_m
        self.size = (view.camera.width_px, view.camera.height_px)

    def _rays(self, box: Box, sub: int) -> tuple[Image, Image]:
        """Return normalised x and y of the rays through the sub-pixels of a box."""
        steps = (np.arange(sub) + 0.5) / sub - 0.5
        u, v = ((np.arange(*ends)[:, None] + steps).ravel() for ends in (box[:2], box[2:]))
        x, y = self.view.normalized(u, v)
        return x.astype(np.float32), y.astype(np.float32)

    @cached_property
    def _coarse_rays(self) -> tuple[Image, Image]:
        """Return the rays through the centres of all pixels."""
        return self._rays((0, self.size[0], 0, self.size[1]), 1)

    def project(self, points_m: Array) -> Array:
        """Return raw pixels (m, 2) of a polygon, clipped near the camera; may be empty."""
        view = self.view
        seen = clip_near(points_m @ view.R.T + view.t)
        if not len(seen):
            return np.zeros((0, 2))
        uv, _ = view.camera.project(seen)
        return uv[np.isfinite(uv).all(axis=1)]

    def box(self, uv: Array, margin_px: int = 2) -> Optional[Box]:
        """Return the half-open column and row range that polygons touch, or None."""
        if len(uv) < 3:
            return None
        width, height = self.size
        u0, v0 = np.clip(np.floor(uv.min(axis=0)) - margin_px, 0, 1e6).astype(int)
        u1, v1 = np.clip(np.ceil(uv.max(axis=0)) + margin_px + 1, 0, self.size).astype(int)
        if u0 >= min(u1, width) or v0 >= min(v1, height):
            return None
        return int(u0), int(u1), int(v0), int(v1)

    def draw(self, image: Image, plane: Plane, sky: Optional[Sky] = None) -> None:
        """
        Draw a plane into an image, in place.

        :param image: (rows, columns) float32.
        :param sky: the light on it; None for plain daylight.
        """
        box = self.box(self.project(plane.outline_m))
        if box is None:
            return
        u0, u1, v0, v1 = box
        colour, alpha = self.sample(plane, box)
        if plane.fine:
            size = (u1 - u0, v1 - v0)
            colour, alpha = (np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA),
                                        np.float32) for part in (colour, alpha))
        target = image[v0:v1, u0:u1]
        if plane.emits is not None:
            target += np.float32(plane.emits) * colour
            return
        colour = self._lit(plane, box, sky, colour, alpha)
        target *= 1 - alpha
        target += colour

    def _lit(self, plane: Plane, box: Box, sky: Optional[Sky], colour: Image,
             alpha: Image) -> Image:
        """Return grey levels (rows, columns) of a plane in the light that falls on it."""
        if sky is None:
            return colour
        if plane.surface is None:
            return colour if sky.ambient == 1 else colour * np.float32(sky.ambient)
        u0, u1, v0, v1 = box
        xn, yn = (rays[v0:v1, u0:u1] for rays in self._coarse_rays)
        sides = [float(np.linalg.norm(side)) for side in (plane.across_m, plane.down_m)]
        x, y, _ = self._meet(replace(plane, relief_m=None), xn, yn, *sides)
        rows, columns = plane.surface.nodes.shape[:2]
        half = np.float32(0.5)
        nodes: Image = np.asarray(cv2.remap(
            plane.surface.nodes, x * np.float32(columns / sides[0]) - half,
            y * np.float32(rows / sides[1]) - half, cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE), np.float32)
        axes = np.stack([plane.across_m / sides[0], plane.down_m / sides[1],
                         plane.normal / (sides[0] * sides[1])])
        normal = nodes[..., :3] @ axes.astype(np.float32)
        ray = np.stack([xn, yn, np.ones_like(xn)], axis=-1) @ self.view.R.astype(np.float32)
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        mirrored = nodes[..., 3] * sky.mirrored(normal, ray)
        return np.asarray(colour * sky.light(normal) + alpha * mirrored, np.float32)

    def sample(self, plane: Plane, box: Box) -> tuple[Image, Image]:
        """
        Sample a plane over a box of pixels.

        :return: grey times coverage, and coverage, (rows, columns) of sub-pixels.
        """
        u0, u1, v0, v1 = box
        if plane.fine:
            xn, yn = self._rays(box, SUB)
        else:
            xn, yn = (rays[v0:v1, u0:u1] for rays in self._coarse_rays)
        width = float(np.linalg.norm(plane.across_m))
        height = float(np.linalg.norm(plane.down_m))
        x, y, ahead = self._meet(plane, xn, yn, width, height)
        steps = [_steps(value) for value in (x, y)]
        cover = _inside(x, width, steps[0]) * _inside(y, height, steps[1])
        cover[~ahead] = 0
        return _textured(plane.texture, x / np.float32(width), y / np.float32(height),
                         (steps[0] / width, steps[1] / height), cover)

    def _meet(self, plane: Plane, xn: Image, yn: Image, width: float,
              height: float) -> tuple[Image, Image, NDArray[np.bool_]]:
        """Return where rays meet the plane, m from its top-left corner, and whether ahead."""
        R = self.view.R
        gap = plane.corner_m - self.centre_m
        normal = plane.normal / (width * height)
        reach = float(gap @ normal)

        def combine(vector: Array) -> Image:
            a, b, c = (np.float32(k) for k in R @ vector)
            return xn * a + (yn * b + c)
        below = combine(normal)
        ahead = below * np.float32(np.sign(reach)) > 1e-6
        # At unit distance of the plane's foot: x = (across.ray reach - across.gap normal.ray)/..
        one = np.float32(1)
        scale = np.asarray(one / np.where(ahead, below, one), np.float32)
        across, down = plane.across_m / width, plane.down_m / height
        x = combine(reach * across - (gap @ across) * normal) * scale
        y = combine(reach * down - (gap @ down) * normal) * scale
        if plane.relief_m is None:
            return x, y, ahead
        rows, columns = plane.relief_m.shape
        slope_x, slope_y = combine(across) * scale, combine(down) * scale
        flat_x, flat_y, half = x, y, np.float32(0.5)
        for _ in range(RELIEF_STEPS):
            out = cv2.remap(plane.relief_m, x * np.float32(columns / width) - half,
                            y * np.float32(rows / height) - half, cv2.INTER_LINEAR,
                            borderMode=cv2.BORDER_REPLICATE)
            x, y = flat_x + out * slope_x, flat_y + out * slope_y
        return x, y, ahead

    def fill(self, image: Image, outlines_m: Sequence[Array], factor: float,
             blur_px: float = 0.0) -> None:
        """
        Darken or brighten the union of polygons, in place.

        :param image: (rows, columns) float32.
        :param outlines_m: corners (n, 3) of each polygon, left optical frame.
        :param factor: factor for the grey levels.
        :param blur_px: width of the soft edge.
        """
        outlines = [uv for uv in map(self.project, outlines_m) if len(uv) >= 3]
        box = self.box(np.concatenate([*outlines, np.zeros((0, 2))]), 2 + int(3 * blur_px))
        if box is None:
            return
        u0, u1, v0, v1 = box
        mask = np.zeros((v1 - v0, u1 - u0), np.uint8)
        for uv in outlines:
            corners = np.clip((uv - [u0, v0]) * 2 ** _SHIFT, -1e6, 1e6)
            cv2.fillPoly(mask, [np.round(corners).astype(np.int32)], 255, cv2.LINE_AA, _SHIFT)
        share = mask.astype(np.float32) * np.float32((factor - 1) / 255)
        if blur_px > 0:
            share = np.asarray(cv2.GaussianBlur(share, (0, 0), blur_px), np.float32)
        image[v0:v1, u0:u1] *= 1 + share


def _steps(value: Image) -> float:
    """Return how much a coordinate changes per sub-pixel, in the middle of the box."""
    rows, columns = value.shape
    i, j = rows // 2, columns // 2
    across = value[i, min(j + 1, columns - 1)] - value[i, max(j - 1, 0)]
    down = value[min(i + 1, rows - 1), j] - value[max(i - 1, 0), j]
    return max(float(np.hypot(across, down)) / 2, 1e-9)


def _inside(value: Image, size: float, step: float) -> Image:
    """Return the share of each sub-pixel between 0 and ``size``."""
    half = np.float32(size / 2)
    gap: Image = half - np.abs(value - half)
    gap *= np.float32(1 / step)
    gap += np.float32(0.5)
    # Rectangles narrower than a sub-pixel cover no more than their width.
    np.clip(gap, 0, min(1.0, size / step), out=gap)
    return gap


def _textured(texture: Texture, x: Image, y: Image, steps: tuple[float, float],
              cover: Image) -> tuple[Image, Image]:
    """
    Look up a texture.

    :param x: share of its width.
    :param y: share of its height.
    :param steps: change of both per sub-pixel.
    :param cover: share of each sub-pixel covered by the rectangle.
    """
    columns, rows = texture.size
    # The mean of both directions: less blur at grazing angles, without aliasing.
    footprint = np.sqrt(max(steps[0] * columns, 1.0) * max(steps[1] * rows, 1.0))
    level = float(np.clip(np.log2(footprint), 0, len(texture.grey) - 1))
    np.clip(x, 0, 1, out=x)
    np.clip(y, 0, 1, out=y)
    grey = np.zeros_like(x)
    alpha = np.zeros_like(x) if texture.alpha else None
    for i, weight in ((int(level), 1 - level % 1), (int(level) + 1, level % 1)):
        if weight == 0:
            continue
        half = np.float32(0.5)
        at = (x * np.float32(columns / 2 ** i) - half, y * np.float32(rows / 2 ** i) - half)
        grey += np.float32(weight) * cv2.remap(
            texture.grey[i], *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if alpha is not None and texture.alpha:
            alpha += np.float32(weight) * cv2.remap(
                texture.alpha[i], *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    grey *= cover
    return grey, cover if alpha is None else alpha * cover
