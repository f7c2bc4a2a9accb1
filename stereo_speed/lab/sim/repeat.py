# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Make long bags by repeating a short one."""
from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import struct
from typing import Any, Callable, Optional

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from ...core.errors import InputError
from ...core.units import NS_S


def repeat_bag(source: Path, folder: Path, times: int, gap_s: float,
               pairs: Optional[int] = None) -> Path:
    """
    Write a bag that repeats another one, with stamps that keep rising.

    :param source: a rosbag2 bag whose messages begin with a header.
    :param folder: folder of the new bag (MCAP); it must not exist.
    :param times: number of rounds.
    :param gap_s: time from the last stamp of a round to the first of the next, s.
    :param pairs: number of messages of each topic per round; None for all.
    :raises InputError: the folder exists already.
    """
    if folder.exists():
        raise InputError(folder, 'bag', 'a folder that is there', 'a new one')
    with AnyReader([source]) as reader, \
            Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        rows = [(c, bytes(data)) for c, _, data in reader.messages()]
        if pairs is not None:
            rows = [row for k, row in enumerate(rows)
                    if sum(c is row[0] for c, _ in rows[:k]) < pairs]
        out = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=reader.typestore)
               for c in reader.connections}
        stamps = [_stamp_ns(data) for _, data in rows]
        round_ns = max(stamps) - min(stamps) + round(gap_s / NS_S)
        for number in range(times):
            for (connection, data), stamp_ns in zip(rows, stamps):
                moved_ns = stamp_ns + number * round_ns
                writer.write(out[connection.topic], moved_ns, _stamped(data, moved_ns))
    return folder


def _stamp_ns(data: bytes) -> int:
    sec, nanosec = struct.unpack_from('<iI', data, 4)
    return int(sec) * 10 ** 9 + int(nanosec)


def _stamped(data: bytes, stamp_ns: int) -> bytes:
    """Return a serialized message with another stamp in its header."""
    return data[:4] + struct.pack('<iI', *divmod(stamp_ns, 10 ** 9)) + data[12:]


def damaged_copy(source: Path, folder: Path, pairs: int, damage: Callable[[bytes], bytes],
                 which: int) -> Path:
    """
    Write the first messages of a bag, with the data of one image damaged.

    :param source: a rosbag2 bag with compressed images.
    :param folder: folder of the new bag (MCAP).
    :param pairs: number of messages of each topic.
    :param damage: returns the damaged bytes of a compressed image.
    :param which: number of the image, in recording order.
    """
    number = 0
    with AnyReader([source]) as reader, \
            Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        out = {c.topic: writer.add_connection(c.topic, c.msgtype, typestore=reader.typestore)
               for c in reader.connections}
        counts = dict.fromkeys(out, 0)
        for connection, log_time_ns, data in reader.messages():
            counts[connection.topic] += 1
            if counts[connection.topic] > pairs:
                continue
            if connection.msgtype.endswith('CompressedImage'):
                if number == which:
                    message: Any = reader.deserialize(data, connection.msgtype)
                    hurt = np.frombuffer(damage(message.data.tobytes()), np.uint8)
                    data = bytes(reader.typestore.serialize_cdr(
                        replace(message, data=hurt), connection.msgtype))
                number += 1
            writer.write(out[connection.topic], log_time_ns, data)
    return folder
