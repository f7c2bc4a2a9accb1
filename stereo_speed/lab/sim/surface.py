# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How light falls on curved, glossy pieces of a body, and what they mirror.

Both depend on where the camera is: highlights and reflections differ between the views, and slide
over the paint while a vehicle drives.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import cv2
import numpy as np

from .texture import Image, octaves
from ...core.records import Array

NODES = (48, 64)  # rows and columns of the grid of normals
HEAD_ON = 0.045  # share that clear lacquer and glass mirror when looked at squarely
LOBE = 900.0  # exponent of the sun's highlight about its mirror direction: about 3 degrees
SUN_GREY = 40000.0  # of the sun's image in a perfect mirror, spread over that lobe
SUN_SHARE, SKY_SHARE = 0.55, 0.3  # of the shading that depends on how a piece is turned
CROWNS = 512  # of the trees around the horizon, which are mirrored too


@dataclass(frozen=True, eq=False)
class Surface:
    """
    Shape and gloss of a piece.

    :param nodes: (rows, columns, 4) float32 over the piece: its normal along its across and down
        directions and out of it, of length 1, and the gloss, 0 matt to 1 lacquer.
    """

    nodes: Image

    @classmethod
    def of(cls, relief_m: Image, size_m: tuple[float, float], gloss: Image) -> Surface:
        """
        Take normals from a relief.

        :param relief_m: (rows, columns) how far it stands out.
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
    What shines on things and is mirrored in them, in the left optical frame.

    :param up: (3,) the vertical.
    :param north: (3,) a level direction from which azimuths count.
    :param sun: (3,) direction to the sun; None without.
    :param ambient: share of daylight; lamps are not subject to it.
    :param crowns: (CROWNS,) sines of elevation of the trees around the horizon.
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
        """Return what shines (rows, columns) on normals (rows, columns, 3); 1 is daylight."""
        gain = 1 + SKY_SHARE * (normal @ self.up.astype(np.float32))
        if self.sun is not None:
            gain += SUN_SHARE * (np.maximum(normal @ self.sun.astype(np.float32), 0) - 0.4)
        return np.asarray(self.ambient * gain, np.float32)

    def mirrored(self, normal: Image, ray: Image) -> Image:
        """
        Return the grey levels that a perfect lacquer mirrors.

        :param normal: (rows, columns, 3) of the piece.
        :param ray: (rows, columns, 3) from the camera, of length 1.
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
