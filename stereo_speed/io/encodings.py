# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The pixel encodings of image messages, by the names of ``sensor_msgs/Image``."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional

import cv2


@dataclass(frozen=True)
class Encoding:
    """
    How an encoding with colour is converted.

    :param channels: bytes per pixel.
    :param to_grey: conversion code of OpenCV to grey.
    :param to_bgr: conversion code of OpenCV to BGR; None where the pixels are BGR.
    """

    channels: int
    to_grey: int
    to_bgr: Optional[int]


COLOUR = {
    'bgr8': Encoding(3, cv2.COLOR_BGR2GRAY, None),
    'rgb8': Encoding(3, cv2.COLOR_RGB2GRAY, cv2.COLOR_RGB2BGR),
    'bgra8': Encoding(4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    'rgba8': Encoding(4, cv2.COLOR_RGBA2GRAY, cv2.COLOR_RGBA2BGR),
}
# OpenCV names a Bayer pattern from its second row and column, ROS from its first.
BAYER = {
    'bayer_rggb8': Encoding(1, cv2.COLOR_BayerBG2GRAY, cv2.COLOR_BayerBG2BGR),
    'bayer_bggr8': Encoding(1, cv2.COLOR_BayerRG2GRAY, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg8': Encoding(1, cv2.COLOR_BayerGR2GRAY, cv2.COLOR_BayerGR2BGR),
    'bayer_grbg8': Encoding(1, cv2.COLOR_BayerGB2GRAY, cv2.COLOR_BayerGB2BGR),
}
WITH_COLOUR = {**COLOUR, **BAYER}
ENCODINGS = ('mono8', 'mono16', *WITH_COLOUR)


def compressed_mosaic(msg: Any) -> Optional[Encoding]:
    """Return the Bayer pattern of a ``CompressedImage`` that holds a mosaic; None for others."""
    return BAYER.get(str(msg.format).partition(';')[0].strip().lower())
