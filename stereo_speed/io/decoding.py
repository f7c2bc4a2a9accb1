# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Decode images that may be damaged or malicious.

OpenCV fills the missing part of a damaged JPEG with grey and returns it as an image; the only sign
is a line that libjpeg writes to the standard error of the process. That line is caught here, and
the image is then refused. The size that an image states is checked before it is decoded, because a
few bytes can stand for gigabytes.
"""
from __future__ import annotations

from contextlib import contextmanager
import os
import struct
import threading
from typing import Any, Iterator, Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from .atomic import PathLike
from ..core.errors import InputError

MOST_BYTES = 1 << 27  # of decoded pixels: 33 megapixels in colour, 67 of 16-bit grey
_JPEG_START, _PNG_START = b'\xff\xd8\xff', b'\x89PNG\r\n\x1a\n'
# How lines of the decoders begin; lines of other writers are passed on.
_HARMLESS = ('Unknown Adobe', 'Warning: unknown JFIF', 'Corrupt JPEG data: bad ICC',
             'libpng warning', '[ WARN:', '[ERROR:', '[ INFO:', 'Cleanup called',
             'imdecode_(', 'imread_(', 'OpenCV(', '\n')
_DAMAGE = ('Corrupt JPEG', 'Premature end', 'Invalid SOS', 'Inconsistent progression',
           'Application transferred', 'Invalid', 'Unsupported', 'libpng error', 'Unexpected',
           'Bogus', 'Not a JPEG')
_one_at_a_time = threading.RLock()  # the process has one standard error


def decode_image(data: NDArray[np.uint8], flags: int) -> tuple[Optional[NDArray[Any]], str]:
    """
    Decode a compressed image.

    :param data: the bytes of its file.
    :param flags: flags of ``cv2.imdecode``.
    :return: the image, and an empty reason; or None and a short reason.
    """
    size = stated_size(data[:1 << 20].tobytes())
    if size is not None and not 0 < size[0] * size[1] * size[2] <= MOST_BYTES:
        return None, f'{size[0]}x{size[1]} px in {data.size} bytes'
    if not _chunks_fit(data):
        return None, f'{data.size} bytes that cannot be decoded (a chunk of PNG beyond the end)'
    image = None
    with caught_chatter() as lines:
        try:
            image = cv2.imdecode(data, flags) if data.size else None
        except cv2.error:
            pass
    damage = [line for line in lines if line.strip() and not line.startswith(_HARMLESS)]
    if image is None or damage:
        told = f' ({damage[0]})' if damage else ''
        return None, f'{data.size} bytes that cannot be decoded{told}'
    return np.asarray(image), ''


def read_image(path: PathLike, flags: int, wanted: str, what: str = 'image') -> NDArray[Any]:
    """
    Read an image file.

    :param flags: flags of ``cv2.imdecode``.
    :param wanted: kind of image that is expected, for errors.
    :param what: what the image is used as, for errors.
    :raises InputError: the file cannot be read or decoded.
    """
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(path, what, error.strerror or error, wanted) from None
    image, why = decode_image(data, flags)
    if image is None:
        raise InputError(path, what, why, wanted)
    return image


def stated_size(head: bytes) -> Optional[tuple[int, int, int]]:
    """
    Return the size that a JPEG or PNG states, without decoding it.

    :param head: its first bytes.
    :return: width and height, px, and bytes per decoded pixel; None where no size is stated.
    """
    if head.startswith(_PNG_START) and len(head) >= 26:
        width, height, depth, kind = struct.unpack_from('>IIBB', head, 16)
        # one channel for grey, else four: colour or palette, perhaps with transparency
        return int(width), int(height), (1 if kind == 0 else 4) * (2 if depth == 16 else 1)
    if not head.startswith(_JPEG_START):
        return None
    at = 2
    while at + 9 <= len(head) and head[at] == 0xff:
        kind = head[at + 1]
        if kind == 0xff:  # fill
            at += 1
            continue
        # Start of frame; three markers in this range have another meaning.
        if 0xc0 <= kind <= 0xcf and kind not in (0xc4, 0xc8, 0xcc):
            height, width = struct.unpack_from('>HH', head, at + 5)
            return int(width), int(height), 3
        at += 2 + int(struct.unpack_from('>H', head, at + 2)[0])
    return None


def _chunks_fit(data: NDArray[np.uint8]) -> bool:
    """Return whether all chunks of a PNG end within it; decoders allocate the stated length."""
    if data[:8].tobytes() != _PNG_START:
        return True
    at = 8
    while at + 8 <= data.size:
        length, kind = struct.unpack('>I4s', data[at:at + 8].tobytes())
        at += 12 + int(length)
        if kind == b'IEND':
            break
    return at <= data.size


@contextmanager
def caught_chatter(everything: bool = False) -> Iterator[list[str]]:
    """
    Catch the lines that C libraries write to standard error instead of raising an exception.

    :param everything: whether to take all lines for theirs; otherwise they are recognised by their
        beginning.
    :return: a list that has those lines after the block; lines of other writers are passed on to
        standard error.
    """
    lines: list[str] = []
    with _one_at_a_time:
        try:
            saved = os.dup(2)
        except OSError:  # there is no standard error
            yield lines
            return
        aside = os.memfd_create('chatter')
        os.dup2(aside, 2)
        try:
            yield lines
        finally:
            os.dup2(saved, 2)
            length = os.lseek(aside, 0, os.SEEK_CUR)
            text = os.pread(aside, length, 0).decode('utf-8', 'replace') if length else ''
            for line in text.splitlines(keepends=True):
                if everything or line.startswith((*_HARMLESS, *_DAMAGE)):
                    lines.append(' '.join(line.split()))
                else:
                    os.write(2, line.encode())
            os.close(aside)
            os.close(saved)
