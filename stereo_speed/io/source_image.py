# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""An image as received from the camera, kept as bytes for lossless storage and display."""
from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .colour import bgr_from_message, bgr_of_grey
from .encodings import COLOUR
from .images import grey_from_message, pixel_rows
from ..core.errors import BagError
from ..vision.grey import to_eight_bits

_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)  # higher compression gains little on road images
_TO_BGR = {  # transparency is kept: nothing is dropped from what is stored
    'rgb8': cv2.COLOR_RGB2BGR, 'rgba8': cv2.COLOR_RGBA2BGRA}


@dataclass(frozen=True, eq=False)
class SourceImage:
    """
    One image message, without its stamp.

    :param encoding: encoding of a raw image, as ``sensor_msgs/Image`` names it; the ``format`` of
        a compressed one.
    :param data: bytes of the message's data.
    :param width_px: width of a raw image; 0 for a compressed one, whose data state its size.
    :param height_px: height of a raw image; 0 for a compressed one.
    :param step: bytes per row of a raw image; 0 for a compressed one.
    :param big_endian: byte order of 16-bit images.
    """

    encoding: str
    data: bytes
    width_px: int = 0
    height_px: int = 0
    step: int = 0
    big_endian: bool = False

    @classmethod
    def from_message(cls, msg: Any) -> SourceImage:
        """Return a copy of an ``Image`` or ``CompressedImage`` message of ROS 1 or 2."""
        if not hasattr(msg, 'encoding'):
            return cls(str(msg.format), bytes(msg.data))
        return cls(str(msg.encoding).lower(), bytes(msg.data), int(msg.width), int(msg.height),
                   int(msg.step), bool(msg.is_bigendian))

    @property
    def compressed(self) -> bool:
        """Return whether it was received as JPEG or PNG."""
        return not self.width_px

    def grey(self, where: object) -> NDArray[Any]:
        """
        Return the grey image used for measuring.

        :param where: source of the image, for errors.
        :return: (H, W) uint8 or uint16.
        :raises BagError: the data cannot be decoded.
        """
        return grey_from_message(self._message(), where)

    def _message(self) -> SimpleNamespace:
        """Return the fields of the original message."""
        if self.compressed:
            return SimpleNamespace(format=self.encoding, data=self.data)
        return SimpleNamespace(
            encoding=self.encoding, data=self.data, width=self.width_px, height=self.height_px,
            step=self.step, is_bigendian=self.big_endian)

    def file(self, where: object) -> tuple[str, bytes]:
        """
        Return suffix and content of a file that holds the image without loss.

        JPEG and PNG data are kept unchanged; raw images become PNG, Bayer mosaics without
        demosaicing.

        :param where: source of the image, for errors.
        """
        if self.compressed:
            return ('.jpg' if self.data.startswith(b'\xff\xd8') else '.png'), self.data
        return '.png', png(self._pixels(where))

    def colours(self, where: object) -> NDArray[np.uint8]:
        """
        Return the image in colour, for display.

        :param where: source of the image, for errors.
        :return: (H, W, 3) uint8, BGR.
        """
        grey = self.grey(where)
        if grey.dtype == np.uint16 and 'bayer' not in self.encoding.lower():
            return bgr_of_grey(to_eight_bits(grey))
        return bgr_from_message(self._message(), where)

    def _pixels(self, where: object) -> NDArray[Any]:
        """Return the pixels of a raw image, (H, W) or (H, W, 3 or 4), blue first."""
        known = COLOUR.get(self.encoding)
        if known is None:  # one value per pixel: grey, or an unchanged Bayer mosaic
            plain = 'mono16' if self.encoding == 'mono16' else 'mono8'
            return replace(self, encoding=plain).grey(where)
        rows = pixel_rows(self._message(), known.channels, where)
        pixels = rows.reshape(self.height_px, self.width_px, known.channels)
        code = _TO_BGR.get(self.encoding)
        return pixels if code is None else np.asarray(cv2.cvtColor(pixels, code))


def png(pixels: NDArray[Any]) -> bytes:
    """
    Return the bytes of a PNG file.

    :param pixels: (H, W) uint8 or uint16, or (H, W, 3 or 4) uint8, blue first.
    """
    done, data = cv2.imencode('.png', pixels, _PNG)
    if not done:
        raise BagError('image', 'pixels', f'{pixels.dtype} {pixels.shape}',
                       'an array that PNG can store')
    return data.tobytes()
