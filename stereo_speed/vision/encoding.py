# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
How cameras encode light as grey values, and blur that acts on the light.

Lenses and pixels average light, but most cameras write a root of it.  So a blurred edge between
dark and bright lies further out on the dark side in the image than in the world, by a part of a
pixel that stays the same while a vehicle comes nearer.  Taken for a part of the vehicle, it would
make the vehicle seem to grow more slowly.
"""
from __future__ import annotations

import math
from typing import Sequence

import cv2
import numpy as np

from .sampling import Patches

DARK_SHARE = 0.04  # of full scale; below it, sRGB gets no steeper, as roots do


def blurred(image: Patches, sigma: Sequence[float]) -> Patches:
    """Return an image after a Gaussian low-pass, 1-sigma in px down and across."""
    size = [2 * math.ceil(3 * s) + 1 for s in sigma]
    return np.asarray(cv2.GaussianBlur(image, size[::-1], sigmaX=sigma[1], sigmaY=sigma[0],
                                       borderType=cv2.BORDER_REPLICATE))


def to_light(grey: Patches, gamma: float) -> Patches:
    """
    Return the light of grey levels, up to a factor.

    Levels below 0, which interpolation leaves beside what is bright, have no root and become 0.

    :param grey: (h, w) grey levels.
    :param gamma: grey levels are this root of the light; 1 for a camera that writes light itself,
        of which they are returned as they are.
    """
    return grey if gamma == 1 else np.asarray(
        cv2.pow(np.maximum(grey, np.float32(0)), gamma), np.float32)


def to_grey(light: Patches, gamma: float) -> Patches:
    """Return the grey levels of light; arguments are those of :func:`to_light`."""
    return light if gamma == 1 else np.asarray(cv2.pow(light, 1 / gamma), np.float32)


def light_blurred(grey: Patches, sigma: Sequence[float], gamma: float) -> Patches:
    """
    Return an image as if its light had passed a Gaussian low-pass.

    :param sigma: 1-sigma down and across, px; the others are those of :func:`to_light`.
    """
    return to_grey(blurred(to_light(grey, gamma), sigma), gamma)
