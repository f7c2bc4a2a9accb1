# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The grey levels of cameras, and conversion to 8 bits, which most of OpenCV requires."""
from __future__ import annotations

from typing import Any, Iterable

import cv2
import numpy as np
from numpy.typing import NDArray


_BITS = 8, 10, 12, 14, 16  # of cameras; those of 10 to 14 bits write them into 16


def white_level(images: Iterable[NDArray[Any]]) -> int:
    """
    Return the largest grey level that the camera of some images can write, where they clip.

    :param images: (H, W) uint8 or uint16, all of one type; of uint16 their brightest pixel tells
        the bits of the camera.
    """
    brightest = 0
    for image in images:
        if image.dtype == np.uint8:
            return 255
        brightest = max(brightest, int(image.max(initial=0)))
    return next(white for white in ((1 << bits) - 1 for bits in _BITS) if brightest <= white)


def to_eight_bits(image: NDArray[Any]) -> NDArray[np.uint8]:
    """
    Return a grey image as 8 bits.

    White is the largest number with as many bits as the brightest pixel has, and at least eight.
    Rounded up to whole bits, the scale is the same for all images of a camera, which it would not
    be by the maximum of each.

    :param image: (H, W) uint8, which is returned as it is, or uint16; the whole image, not a
        part of it.
    """
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    white = (1 << max(int(image.max()).bit_length(), 8)) - 1
    return np.asarray(cv2.convertScaleAbs(image, alpha=255.0 / white), np.uint8)
