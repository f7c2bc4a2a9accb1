# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Turn image messages into grey arrays.

The messages are duck-typed (``sensor_msgs`` ``Image`` or ``CompressedImage``, of ROS 1 or 2),
so that live nodes and offline replay get the same pixels.
"""
from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .decoding import decode_image
from .encodings import compressed_mosaic, ENCODINGS, WITH_COLOUR
from ..core.errors import BagError

# The pixels as stored: no rotation by EXIF, and 16 bits stay 16 bits.
_GREY = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
_JPEG_START, _JPEG_END = b'\xff\xd8\xff', b'\xff\xd9'
_PNG_START, _PNG_END = b'\x89PNG\r\n\x1a\n', b'IEND'


def grey_from_message(msg: Any, where: object) -> NDArray[Any]:
    """
    Turn an ``Image`` or ``CompressedImage`` message into a grey image.

    :param msg: the message.
    :param where: file and topic, for the error.
    :return: (H, W) uint8, or uint16 for 16-bit images; raw, not rectified.
    :raises BagError: an encoding that is not supported, or data that do not make an image.
    """
    if hasattr(msg, 'encoding'):
        return _from_raw(msg, where)
    return _from_compressed(msg, where)


def _from_raw(msg: Any, where: object) -> NDArray[Any]:
    encoding = str(msg.encoding).lower()
    if encoding not in ENCODINGS:
        raise BagError(where, 'encoding', repr(msg.encoding), 'one of ' + ', '.join(ENCODINGS))
    if encoding == 'mono16':
        rows = pixel_rows(msg, 2, where).view('>u2' if msg.is_bigendian else '<u2')
        return rows.astype(np.uint16)
    known = WITH_COLOUR.get(encoding)
    if known is None:
        return pixel_rows(msg, 1, where).copy()
    rows = pixel_rows(msg, known.channels, where)
    return _converted(rows.reshape(len(rows), -1, known.channels), known.to_grey, where)


def pixel_rows(msg: Any, pixel_bytes: int, where: object) -> NDArray[np.uint8]:
    """Return the (H, W * pixel_bytes) bytes of a raw image without the padding of its rows."""
    width, height, step = int(msg.width), int(msg.height), int(msg.step)
    if width < 1 or height < 1:
        raise BagError(where, 'image size', f'{width}x{height} px', 'at least 1x1 px')
    if step < width * pixel_bytes:
        raise BagError(where, 'step', step,
                       f'at least {width * pixel_bytes} bytes for {width} px of {msg.encoding}')
    data = np.frombuffer(msg.data, dtype=np.uint8)
    # the last row may lack its padding
    needed = step * (height - 1) + width * pixel_bytes
    if data.size < needed:
        raise BagError(where, 'image data', f'{data.size} bytes',
                       f'{step * height} bytes for {height} rows of {step}')
    rows = np.lib.stride_tricks.as_strided(
        data, (height, width * pixel_bytes), (step, 1), writeable=False)
    return np.ascontiguousarray(rows)


def _converted(pixels: NDArray[Any], code: int, where: object) -> NDArray[Any]:
    try:
        return np.asarray(cv2.cvtColor(pixels, code))
    except cv2.error as error:
        raise BagError(where, 'image', f'{pixels.shape[1]}x{pixels.shape[0]} px, {error.err}',
                       'an image that can be turned to grey') from None


def _from_compressed(msg: Any, where: object) -> NDArray[Any]:
    data = np.frombuffer(msg.data, dtype=np.uint8)
    _check_complete(data, where)
    mosaic = compressed_mosaic(msg)
    # A Bayer mosaic may be compressed as it is: then one channel holds three colours.
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION if mosaic is not None else _GREY
    image, why = decode_image(data, flags)
    if image is None:
        raise BagError(where, 'compressed image', why, 'a whole JPEG or PNG image')
    if mosaic is None:
        return image
    if image.ndim == 2:
        return _converted(image, mosaic.to_grey, where)
    code = cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
    return _converted(image, code, where)


def _check_complete(data: NDArray[np.uint8], where: object) -> None:
    """Refuse a truncated JPEG or PNG, which OpenCV would silently fill with grey."""
    head, tail = data[:8].tobytes(), data[data.size // 2:].tobytes()
    wanted = 'a whole JPEG or PNG image'
    if head.startswith(_JPEG_START):
        end = _JPEG_END
    elif head == _PNG_START:
        end = _PNG_END
    else:
        raise BagError(where, 'compressed image',
                       f'{data.size} bytes that begin with {head.hex() or "nothing"}', wanted)
    if end not in tail:
        raise BagError(where, 'compressed image', f'{data.size} bytes without an end', wanted)
