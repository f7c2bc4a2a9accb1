# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Shading and reflections of curved, glossy pieces of a body.

Both depend on the position of the camera: highlights and reflections differ between the views, and
move over the paint while a vehicle drives.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import cv2
import numpy as np

from .texture import Image, octaves
from ...core.records import Array

NODES = (48, 64)  # rows and columns of the grid of normals
HEAD_ON = 0.045  # share that clear lacquer and glass reflect at normal incidence
LOBE = 900.0  # exponent of the sun's specular lobe, about 3 degrees wide
SUN_GREY = 40000.0  # grey level of the sun in a perfect mirror, spread over that lobe
SUN_SHARE, SKY_SHARE = 0.55, 0.3  # shares of the shading that depend on orientation
CROWNS = 512  # trees around the horizon, which are reflected too


@dataclass(frozen=True, eq=False)
class Surface:
    """
    Shape and gloss of a piece.

    :param nodes: (rows, columns, 4) float32 over the piece: components of its unit normal across,
        down and outwards, and the gloss, from 0 matt to 1 lacquer.
    """

    nodes: Image

    @classmethod
    def of(cls, relief_m: Image, size_m: tuple[float, float], gloss: Image) -> Surface:
        """
        Compute the normals of a relief.

        :param relief_m: (rows, columns), height of the relief.
        :param size_m: width and height of the piece, m.
        :param gloss: (rows, columns), 0 to 1.
        """
        rows, columns = NODES
        out = np.asarray(cv2.resize(relief_m, (columns, rows), interpolation=cv2.INTER_AREA))
        down, across = np.gradient(out, size_m[1] / rows, size_m[0] / columns)
        normal = np.stack([-across, -down, np.ones_like(out)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        share = cv2.resize(gloss, (columns, rows), interpolation=cv2.INTER_AREA)
        return cls(np.concatenate([normal, share[..., None]], axis=-1).astype(np.float32))


@dataclass(frozen=True, eq=False)
class Sky:
    """
    The sky that lights objects and is reflected in them, in the left optical frame.

    :param up: (3,), the vertical.
    :param north: (3,), a horizontal direction from which azimuths are counted.
    :param sun: (3,), direction to the sun; None without sun.
    :param ambient: share of daylight; it does not affect lamps.
    :param crowns: (CROWNS,), sines of elevation of the trees around the horizon.
    """

    up: Array
    north: Array
    sun: Optional[Array]
    ambient: float
    crowns: Array

    @classmethod
    def of(cls, up: Array, north: Array, sun: Optional[Array], ambient: float,
           rng: np.random.Generator) -> Sky:
        """Draw the trees around the horizon."""
        crowns = 0.10 + 0.05 * octaves(rng, 1, CROWNS, 2)[0]
        return cls(up, north, sun, ambient, np.clip(crowns, 0.02, 0.3))

    def light(self, normal: Image) -> Image:
        """Return the light, (rows, columns), on normals (rows, columns, 3); 1 is daylight."""
        gain = 1 + SKY_SHARE * (normal @ self.up.astype(np.float32))
        if self.sun is not None:
            gain += SUN_SHARE * (np.maximum(normal @ self.sun.astype(np.float32), 0) - 0.4)
        return np.asarray(self.ambient * gain, np.float32)

    def mirrored(self, normal: Image, ray: Image) -> Image:
        """
        Return the grey levels reflected by perfect lacquer.

        :param normal: (rows, columns, 3), normals of the piece.
        :param ray: (rows, columns, 3), unit rays from the camera.
        """
        facing = -(normal * ray).sum(axis=-1)
        back = ray + 2 * facing[..., None] * normal
        share = HEAD_ON + (1 - HEAD_ON) * np.clip(1 - facing, 0, 1) ** 5
        high = back @ self.up.astype(np.float32)
        east = np.cross(self.up, self.north).astype(np.float32)
        turn = np.arctan2(back @ east, back @ self.north.astype(np.float32))
        crown = np.interp(turn / (2 * np.pi) % 1.0 * CROWNS, np.arange(CROWNS), self.crowns)
        sky = np.clip((high - crown) * 25 + 0.5, 0, 1)
        grey = self.ambient * (60.0 + sky * (120.0 + 60.0 * np.clip(high, 0, 0.5)))
        if self.sun is not None:
            grey = grey + SUN_GREY * np.clip(back @ self.sun.astype(np.float32), 0, 1) ** LOBE
        return np.asarray(share * grey, np.float32)
