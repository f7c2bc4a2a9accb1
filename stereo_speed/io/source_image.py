# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""An image as its camera sent it, kept as bytes: to be stored without loss, and shown."""
from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .colour import bgr_from_message, bgr_of_grey, CHANNELS
from .images import grey_from_message, pixel_rows
from ..core.errors import BagError
from ..vision.grey import to_eight_bits

_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)  # images of the road gain little from more
_TO_BGR = {  # transparency stays: nothing is left out of what is stored
    'rgb8': cv2.COLOR_RGB2BGR, 'rgba8': cv2.COLOR_RGBA2BGRA}


@dataclass(frozen=True, eq=False)
class SourceImage:
    """
    One image message, without its stamp.

    :param encoding: of a raw image, as ``sensor_msgs/Image`` names it; of a compressed one the
        ``format`` of its message.
    :param data: its bytes.
    :param width_px: of a raw image; 0 for a compressed one, which knows by itself, as
    :param height_px: and
    :param step: bytes in a row, are.
    :param big_endian: of 16-bit images.
    """

    encoding: str
    data: bytes
    width_px: int = 0
    height_px: int = 0
    step: int = 0
    big_endian: bool = False

    @classmethod
    def from_message(cls, msg: Any) -> SourceImage:
        """Return an ``Image`` or ``CompressedImage`` message, of ROS 1 or 2, with its own copy."""
        if not hasattr(msg, 'encoding'):
            return cls(str(msg.format), bytes(msg.data))
        return cls(str(msg.encoding).lower(), bytes(msg.data), int(msg.width), int(msg.height),
                   int(msg.step), bool(msg.is_bigendian))

    @property
    def compressed(self) -> bool:
        """Return whether it came as a JPEG or PNG image."""
        return not self.width_px

    def grey(self, where: object) -> NDArray[Any]:
        """
        Return the grey image that is measured in.

        :param where: for errors.
        :return: (H, W) uint8 or uint16.
        :raises BagError: data that make no image.
        """
        return grey_from_message(self._message(), where)

    def _message(self) -> SimpleNamespace:
        """Return the message that it came as."""
        if self.compressed:
            return SimpleNamespace(format=self.encoding, data=self.data)
        return SimpleNamespace(
            encoding=self.encoding, data=self.data, width=self.width_px, height=self.height_px,
            step=self.step, is_bigendian=self.big_endian)

    def file(self, where: object) -> tuple[str, bytes]:
        """
        Return the ending and the bytes of a file that holds the image as it came.

        JPEG and PNG images are kept to the byte; raw ones become PNG, without loss, mosaics of
        colours as they are.

        :param where: for errors.
        """
        if self.compressed:
            return ('.jpg' if self.data.startswith(b'\xff\xd8') else '.png'), self.data
        return '.png', png(self._pixels(where))

    def colours(self, where: object) -> NDArray[np.uint8]:
        """
        Return the image for people.

        :param where: for errors.
        :return: (H, W, 3) uint8, BGR.
        """
        grey = self.grey(where)
        if grey.dtype == np.uint16 and 'bayer' not in self.encoding.lower():
            return bgr_of_grey(to_eight_bits(grey))
        return bgr_from_message(self._message(), where)

    def _pixels(self, where: object) -> NDArray[Any]:
        """Return the pixels of a raw image, (H, W) or (H, W, 3 or 4) with blue first."""
        channels = CHANNELS.get(self.encoding)
        if channels is None:  # one number a pixel: grey, or a mosaic that stays one
            plain = 'mono16' if self.encoding == 'mono16' else 'mono8'
            return replace(self, encoding=plain).grey(where)
        rows = pixel_rows(self._message(), channels, where)
        pixels = rows.reshape(self.height_px, self.width_px, channels)
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
