# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Turn image messages into colour arrays, for methods that use colour."""
from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .decoding import decode_image
from .encodings import compressed_mosaic, Encoding, WITH_COLOUR
from .images import grey_from_message, pixel_rows
from ..core.errors import BagError

Colour = NDArray[np.uint8]


def bgr_from_message(msg: Any, where: object) -> Colour:
    """
    Turn an ``Image`` or ``CompressedImage`` message into a colour image.

    :param msg: the message, of ROS 1 or 2.
    :param where: file and topic, for the error.
    :return: (H, W, 3) uint8, BGR; grey images have three equal channels.
    :raises BagError: an encoding that is not supported, or data that do not make an image.
    """
    grey = grey_from_message(msg, where)  # checks the message
    if hasattr(msg, 'encoding'):
        encoding = WITH_COLOUR.get(str(msg.encoding).lower())
        if encoding is not None:
            return _raw(msg, encoding, where)
    else:
        image, why = decode_image(np.frombuffer(msg.data, np.uint8),
                                  cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if image is None:
            raise BagError(where, 'compressed image', why, 'a whole JPEG or PNG image')
        mosaic = compressed_mosaic(msg)
        if mosaic is None or mosaic.to_bgr is None:
            return np.asarray(image, dtype=np.uint8)
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(image[..., 0]), mosaic.to_bgr),
                          dtype=np.uint8)
    return bgr_of_grey(grey)


def bgr_of_grey(grey: NDArray[Any]) -> Colour:
    """Return a grey image (H, W), of 8 or 16 bits, as three equal channels of 8 bits."""
    eight = grey if grey.dtype == np.uint8 else (grey >> 8).astype(np.uint8)
    return np.asarray(cv2.cvtColor(eight, cv2.COLOR_GRAY2BGR), dtype=np.uint8)


def _raw(msg: Any, encoding: Encoding, where: object) -> Colour:
    """Return the pixels of a raw message."""
    channels, code = encoding.channels, encoding.to_bgr
    pixels = pixel_rows(msg, channels, where)
    if channels > 1:
        pixels = pixels.reshape(len(pixels), -1, channels)
    # a copy even where nothing is converted, because callers may draw on it
    return np.array(pixels) if code is None else np.asarray(cv2.cvtColor(pixels, code), np.uint8)
