# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Conversion of images to 8 bits, which most functions of OpenCV require."""
from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def to_eight_bits(image: NDArray[Any]) -> NDArray[np.uint8]:
    """
    Return a grey image as 8 bits.

    White is the largest number with as many bits as the brightest pixel has, and at least eight.
    Cameras write 10 or 12 bits into 16. Rounded up to whole bits, the scale is the same for all
    images of a camera, which it would not be by the maximum of each.

    :param image: (H, W) uint8, which is returned as it is, or uint16; the whole image, not a
        part of it.
    """
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    white = (1 << max(int(image.max()).bit_length(), 8)) - 1
    return np.asarray(cv2.convertScaleAbs(image, alpha=255.0 / white), np.uint8)
