# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Effects of lenses on the light before the sensor clips it, and faults of a camera."""
from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .texture import Image
from ...vision.encoding import to_grey, to_light

COARSE = 4  # cell size of the grid on which the halo is computed, px
USUAL_GAMMA = 2.2  # of most cameras, nearly that of sRGB


@dataclass(frozen=True, kw_only=True)
class LensConfig:
    """
    The point spread of both lenses: a core, and a weak, wide halo around bright regions.

    :param core_px: 1-sigma of the core, px.
    :param halo_share: share of the grey level in the halo.
    :param halo_px: 1-sigma of the halo, px.
    :param gamma: the core is that of light, and the cameras write this root of the light; 1 for
        cameras that write the light itself.
    """

    core_px: float = 0.0
    halo_share: float = 0.0
    halo_px: float = 8.0
    gamma: float = 1.0


@dataclass(frozen=True, kw_only=True)
class FaultConfig:
    """
    Faults of the cameras; gain and offset of the right one are in ``SimConfig``.

    :param exposure_step: largest random change of the exposure of a pair, as a share; uniform
        between both signs, the same in both views.
    :param right_defocus_px: 1-sigma of the blur of a defocused right camera, px.
    :param dirt: number of specks on the glass of the right camera.
    :param dirt_depth: largest share of the grey level that a speck blocks.
    :param dirt_px: largest 1-sigma of a speck, px.
    """

    exposure_step: float = 0.0
    right_defocus_px: float = 0.0
    dirt: int = 0
    dirt_depth: float = 0.5
    dirt_px: float = 25.0


SHARP, SOUND = LensConfig(), FaultConfig()


class Optics:
    """
    The optics between a scene and the sensors.

    :param lens: point spread of both lenses.
    :param faults: faults of the cameras.
    :param size: columns and rows of the images.
    :param rng: source of the dirt and the exposures.
    """

    def __init__(self, lens: LensConfig, faults: FaultConfig, size: tuple[int, int],
                 rng: np.random.Generator) -> None:
        self.lens, self.faults = lens, faults
        dirt, self._steps = rng.spawn(2)
        self._clear = _transmission(faults, size, dirt) if faults.dirt else None

    def exposure(self) -> float:
        """Return the exposure of the next pair relative to the nominal one."""
        step = self.faults.exposure_step
        return 1.0 + step * float(self._steps.uniform(-1.0, 1.0)) if step else 1.0

    def spread(self, image: Image, side: int) -> Image:
        """
        Return the light on a sensor.

        :param image: (rows, columns) float32, light before the lens.
        :param side: 0 left, 1 right.
        """
        if side and self._clear is not None:
            image = image * self._clear
        lens = self.lens
        core_px = float(np.hypot(lens.core_px, self.faults.right_defocus_px * side))
        core = image if core_px <= 0 else to_grey(
            _blurred(to_light(image, lens.gamma), core_px), lens.gamma)
        if lens.halo_share <= 0:
            return core
        coarse = cv2.resize(image, None, fx=1 / COARSE, fy=1 / COARSE,
                            interpolation=cv2.INTER_AREA)
        coarse = _blurred(np.asarray(coarse, np.float32), lens.halo_px / COARSE)
        halo = cv2.resize(coarse, image.shape[::-1], interpolation=cv2.INTER_LINEAR)
        return np.asarray(cv2.addWeighted(core, 1 - lens.halo_share, halo, lens.halo_share, 0.0),
                          np.float32)


def _blurred(image: Image, sigma_px: float) -> Image:
    return np.asarray(
        cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), np.float32)


def _transmission(faults: FaultConfig, size: tuple[int, int], rng: np.random.Generator) -> Image:
    """Return the share (rows, columns) of the light that dirty glass lets through."""
    x, y = (np.arange(n, dtype=np.float32) for n in size)
    clear = np.ones((size[1], size[0]), np.float32)
    for _ in range(faults.dirt):
        sigma = faults.dirt_px * rng.uniform(0.3, 1.0)
        depth = faults.dirt_depth * rng.uniform(0.4, 1.0)
        row, column = (np.exp(-np.square((k - rng.uniform(0, n)) / sigma) / 2)
                       for k, n in ((y, size[1]), (x, size[0])))
        # Flat in the middle, soft at the edge.
        clear *= 1 - np.float32(depth) * np.clip(2 * np.outer(row, column), 0, 1)
    return clear
