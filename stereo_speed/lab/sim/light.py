# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Changing light: shadows of clouds, exposure, and sensor noise."""
from __future__ import annotations

from typing import Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from .config import SimConfig
from .planes import Eye
from .props import LightConfig
from .scene import SimScene
from .texture import Image, octaves

CELL_PX = 16  # cell size of the grid on which a cloud's shadow is computed
TILE = 256
NOISE_BEYOND_PX = 512  # how much larger the stored noise is than the image, each way


class Clouds:
    """
    Shadows of clouds that drift over the ground.

    :param scene: the scene.
    :param eye: the view.
    :param light: their depth, size and speed.
    :param tile: (TILE, TILE), pattern that tiles, with standard deviation 1.
    """

    def __init__(self, scene: SimScene, eye: Eye, light: LightConfig, tile: Image) -> None:
        self.light, self.tile, self.size = light, tile, eye.size
        width, height = eye.size
        # Cells are placed as by cv2.resize.
        columns, rows = -(-width // CELL_PX), -(-height // CELL_PX)
        u = (np.arange(columns) + 0.5) * width / columns - 0.5
        v = (np.arange(rows) + 0.5) * height / rows - 0.5
        rays = eye.view.ray_grid(u, v) @ scene.left_R_world
        down = np.maximum(-rays[..., 2] / np.hypot(rays[..., 0], rays[..., 1]), 1e-6)
        reach = np.minimum(scene.config.camera_height_m / down, 800.0)
        flat = rays[..., :2] / np.hypot(rays[..., 0], rays[..., 1])[..., None]
        self.xy = scene.centre_world_m[:2] + reach[..., None] * flat
        self.ground = np.clip(down / 0.01 - 0.3, 0.0, 1.0)

    def gain(self, t_s: float) -> Image:
        """Return the share of light (rows, columns) in a view."""
        scale = TILE / (8 * self.light.cloud_m)  # eight clouds per tile
        x, y = (np.mod((self.xy[..., k] - self.light.wind_mps[k] * t_s) * scale, TILE)
                .astype(np.float32) for k in (0, 1))
        pattern = cv2.remap(self.tile, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        share = np.clip((pattern - 0.2) / 0.6, 0.0, 1.0)
        gain = 1 - self.light.cloud_depth * self.ground * share * share * (3 - 2 * share)
        return np.asarray(cv2.resize(gain.astype(np.float32), self.size,
                                     interpolation=cv2.INTER_LINEAR))


class Sensor:
    """
    Turns ideal images into counts.

    :param config: exposure, noise, gain and offset of the right camera.
    :param light: drift of the exposure; None for none.
    :param rng: source of the noise, which is made once; each image uses another part of it.
    """

    def __init__(self, config: SimConfig, light: Optional[LightConfig],
                 rng: np.random.Generator) -> None:
        self.config, self.light, self.rng = config, light, rng
        self.phase = rng.uniform(0.0, 2 * np.pi, 2)
        self.stock = rng.standard_normal(
            (config.rig.height_px + NOISE_BEYOND_PX, config.rig.width_px + NOISE_BEYOND_PX),
            dtype=np.float32)

    def exposure(self, t_s: float) -> float:
        """Return the brightness at a time."""
        if self.light is None:
            return self.config.exposure
        angle = 2 * np.pi * t_s / self.light.drift_period_s + self.phase
        wave = 0.65 * np.sin(angle[0]) + 0.35 * np.sin(4.3 * angle[1])
        return self.config.exposure * float(1 + self.light.drift * wave)

    def expose(self, image: Image, side: int, t_s: float,
               step: float = 1.0) -> NDArray[np.uint8]:
        """
        Take an image.

        :param image: (rows, columns) float32 grey levels in daylight.
        :param side: 0 left, 1 right.
        :param step: exposure of the pair relative to the nominal one.
        """
        c = self.config
        gain, offset = (c.right_gain, c.right_offset_grey) if side else (1.0, 0.0)
        row, column = (int(k) for k in self.rng.integers(0, NOISE_BEYOND_PX, 2))
        grain = self.stock[row:row + c.rig.height_px, column:column + c.rig.width_px]
        counts = cv2.addWeighted(image, gain * step * self.exposure(t_s), grain, c.noise_grey,
                                 offset * self.config.exposure, dtype=cv2.CV_8U)
        return np.asarray(counts, dtype=np.uint8)


def cloud_tile(rng: np.random.Generator) -> Image:
    """Make the pattern of the clouds."""
    return octaves(rng, TILE, TILE, 8)
