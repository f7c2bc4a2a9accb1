# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The message for a synchronized pair.

It is one ``sensor_msgs/Image`` with the left grey image above the right one, so its height is
twice that of a camera image, and any viewer can show it.  Its header is that of the left image.
Every row ends with 8 bytes of padding, which ``step`` includes.  In the first row it holds the
stamp of the right image in ns, little-endian, because the two stamps need not be equal.
"""
from __future__ import annotations

from array import array
import struct
from typing import Union

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image

from .common import image_message, PAIR_TOPIC, stamp_ns
from ..core.errors import InputError
from ..core.records import StereoPair
from ..io.images import grey_from_message

Grey = NDArray[Union[np.uint8, np.uint16]]  # (H, W)

_STAMP = struct.Struct('<q')


def pair_message(left: Grey, right: Grey, *, left_ns: int, right_ns: int,
                 frame_id: str) -> Image:
    """
    Put two grey images of the same size and type, (H, W), into one message.

    :raises InputError: images that differ in size or type.
    """
    if left.shape != right.shape or left.dtype != right.dtype:
        raise InputError(PAIR_TOPIC, 'right image', f'{right.shape} {right.dtype}',
                         f'{left.shape} {left.dtype} as the left image')
    width, size = left.shape[1], left.dtype.itemsize
    extra = -(-_STAMP.size // size)
    both = np.zeros((2 * len(left), width + extra), left.dtype)
    both[:len(left), :width], both[len(left):, :width] = left, right
    msg = image_message(both, ns=left_ns, frame_id=frame_id)
    data: array[int] = msg.data
    data[width * size:width * size + _STAMP.size] = array('B', _STAMP.pack(right_ns))
    msg.width, msg.data = width, data
    return msg


def pair_from_message(msg: Image, index: int) -> StereoPair:
    """
    Return the pair that a message contains.

    :param msg: the message.
    :param index: number of the pair in its stream.
    :raises InputError: the message has no stamp of the right image, or an odd height.
    """
    ns, both = stamp_ns(msg.header.stamp), grey_from_message(msg, PAIR_TOPIC)
    used = msg.width * both.dtype.itemsize
    if msg.step < used + _STAMP.size or msg.height % 2:
        raise InputError(PAIR_TOPIC, 'image', f'height {msg.height}, step {msg.step}',
                         f'an even height, and a step of {used + _STAMP.size} or more that '
                         'holds the right stamp, as stereo_sync_node publishes it')
    right_ns = _STAMP.unpack(bytes(msg.data[used:used + _STAMP.size]))[0]
    half = len(both) // 2
    return StereoPair(index, ns, right_ns, both[:half], both[half:])
