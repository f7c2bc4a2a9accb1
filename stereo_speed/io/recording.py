# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Read serialized messages from any kind of bag, and report any damage in one clear line.

Only this module and ``lab.sim`` use rosbags.
"""
from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
import hashlib
from pathlib import Path
import struct
import threading
from typing import Any, Collection, Iterator, NamedTuple, Optional, Sequence, Union

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

from .results import file_sha256
from ..core.errors import BagError, StereoSpeedError

_STORAGE = ('.mcap', '.db3', '.bag')
WHOLE = "a whole, readable bag ('mcap recover' or 'ros2 bag reindex' may repair it)"


class RawMessage(NamedTuple):
    """
    A serialized message of the bag; it must begin with a ``std_msgs/Header``.

    :param topic: its topic.
    :param msgtype: for instance ``sensor_msgs/msg/Image``; the same for ROS 1.
    :param stamp_ns: its header stamp, ns.
    :param log_time_ns: when it was recorded (receive time), ns.
    :param data: the serialized message.
    """

    topic: str
    msgtype: str
    stamp_ns: int
    log_time_ns: int
    data: bytes


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """
    Turn any exception that a damaged file causes in the reader into one line.

    The libraries raise their own errors and, on damaged bytes, nearly any built-in one; so only
    calls into them belong inside the block.
    """
    try:
        yield
    except StereoSpeedError:
        raise
    except Exception as error:
        message = ' '.join(str(error).split()) or 'no details'
        raise BagError(path, 'file', f'{type(error).__name__}: {message[:300]}', WHOLE) from error


def header_stamp_ns(data: Union[bytes, memoryview], big_endian: bool = False) -> int:
    """
    Read the header stamp, ns, of a serialized message without decoding it.

    ROS 2: 4 bytes of CDR encapsulation, then sec and nanosec. ROS 1: 4 bytes of ``seq``, then
    secs and nsecs. Either way they are bytes 4 to 12.
    """
    sec, nanosec = struct.unpack_from('>iI' if big_endian else '<iI', data, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


def _checked(connection: Any) -> Any:
    """Check the types of a topic's metadata, which may be damaged."""
    for value, kind in ((connection.topic, str), (connection.msgtype, str),
                        (connection.msgcount, int)):
        if not isinstance(value, kind):
            raise TypeError(f'{value!r} where a topic has its name, type or count')
    return connection


class Recording:
    """
    An open bag of any kind.

    :param path: rosbag2 folder, bare ``.mcap`` or ``.db3`` file, or ROS 1 ``.bag`` file.
    :raises BagError: no such bag, or a damaged one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._reader: Optional[AnyReader] = None
        _check_path(path)
        with _reading(path):
            # the default store is for bags without message definitions
            reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            reader.open()
            self._reader = reader
            self._connections = [_checked(connection) for connection in reader.connections]

    def close(self) -> None:
        """Close the files; closing twice does no harm."""
        reader, self._reader = self._reader, None
        if reader is not None:
            with _reading(self.path):
                reader.close()

    @property
    def types(self) -> dict[str, str]:
        """Return the message type of each topic that holds messages."""
        return {c.topic: c.msgtype for c in self._connections if c.msgcount}

    def count(self, topics: Collection[str]) -> int:
        """Return the number of messages on some topics, according to the bag's index."""
        return sum(c.msgcount for c in self._connections if c.topic in topics)

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Stream the messages of some topics in the order they were recorded."""
        reader = self._open()
        source = reader.messages([c for c in self._connections if c.topic in topics])
        while True:
            with _reading(self.path):
                found = next(source, None)
                if found is None:
                    return
                connection, log_time_ns, data = found
                # the second byte of CDR is even for big-endian data; ROS 1 is little-endian
                stamp_ns = header_stamp_ns(data, big_endian=reader.is2 and not data[1] & 1)
            yield RawMessage(connection.topic, connection.msgtype, stamp_ns, log_time_ns, data)

    @property
    def connections(self) -> Sequence[Connection]:
        """Return the connections of rosbags: topics with their types."""
        return self._connections

    @property
    def store(self) -> Typestore:
        """Return the type store of the messages."""
        return self._open().typestore

    def everything(self) -> Iterator[tuple[Connection, int, bytes]]:
        """Stream all messages, with or without a header, and their recording times, ns."""
        source = self._open().messages(self._connections)
        while True:
            with _reading(self.path):
                found = next(source, None)
            if found is None:
                return
            yield found

    def decode(self, raw: RawMessage) -> Any:
        """Deserialize a message."""
        reader = self._open()
        with _reading(self.path):
            return reader.deserialize(raw.data, raw.msgtype)

    def _open(self) -> AnyReader:
        if self._reader is None:
            raise RuntimeError(f'{self.path} is not open')
        return self._reader


def _check_path(path: Path) -> None:
    wanted = 'a rosbag2 folder, or a .mcap, .db3 or ROS 1 .bag file'
    if not path.exists():
        raise BagError(path, 'bag', 'no such file or folder', wanted)
    if path.is_dir() and not (path / 'metadata.yaml').is_file():
        inside = ', '.join(sorted(p.name for p in path.iterdir())[:8]) or 'nothing'
        raise BagError(path, 'metadata.yaml', f'none among {inside}',
                       'a rosbag2 folder (or give the .mcap, .db3 or .bag file itself)')
    if path.is_file() and path.suffix not in _STORAGE:
        raise BagError(path, 'bag', f'a file ending in {path.suffix!r}', wanted)


def hash_files(path: Path, stop: Optional[threading.Event] = None) -> str:
    """
    Hash a bag's files, independently of the folder's name.

    :param path: the bag, a file or a folder.
    :param stop: ends it early where it is set, by another thread.
    :return: SHA-256, hex: of the file, or for a folder of the lines that ``sha256sum`` prints
        for its files, in order of their names.
    :raises CancelledError: it was ended early.
    """
    if path.is_file():
        return file_sha256(path, stop)
    files = sorted(p for p in path.iterdir() if p.is_file())
    lines = ''.join(f'{file_sha256(p, stop)}  {p.name}\n' for p in files)
    return hashlib.sha256(lines.encode()).hexdigest()


class FilesHash:
    """
    The hash of a bag's files, on request computed by a thread of its own; see :func:`hash_files`.

    Hashing a bag of raw images takes a second per 2 GB, as long as a tenth of measuring it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stop = threading.Event()
        self._thread: Optional[ThreadPoolExecutor] = None
        self._value: Optional[Future[str]] = None

    def begin(self) -> None:
        """Begin to hash in a thread, unless the hash is known or no longer wanted."""
        if self._value is None and not self._stop.is_set():
            self._thread = ThreadPoolExecutor(1, 'hash')
            self._value = self._thread.submit(hash_files, self._path, self._stop)

    def value(self) -> str:
        """
        Return the hash, once it is there.

        :raises OSError: a file that cannot be read.
        :raises CancelledError: its thread was ended early.
        """
        if self._value is None:
            value: Future[str] = Future()
            value.set_result(hash_files(self._path))
            self._value = value
        return self._value.result()

    def close(self) -> None:
        """End the thread, also in the middle of a file."""
        self._stop.set()
        if self._thread is not None:
            self._thread.shutdown()
