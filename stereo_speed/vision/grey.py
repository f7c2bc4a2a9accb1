# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Grey levels of 8 bits, which most functions of OpenCV want."""
from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def to_eight_bits(image: NDArray[Any]) -> NDArray[np.uint8]:
    """
    Return a grey image as 8 bits.

    White is the greatest number of as many bits as the brightest pixel has, at least eight.
    Cameras write 10 or 12 bits into 16, and by whole bits the images of one camera scale alike,
    which their own maxima would not do.

    :param image: (H, W) uint8, which is returned as it is, or uint16; the whole image, not a
        part of it.
    """
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    white = (1 << max(int(image.max()).bit_length(), 8)) - 1
    return np.asarray(cv2.convertScaleAbs(image, alpha=255.0 / white), np.uint8)
