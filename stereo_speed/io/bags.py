# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Read stereo pairs from a bag: rosbag2 (MCAP or SQLite) or ROS 1, raw or compressed images.

Opening a bag scans the header stamps, without decoding an image, so that the pairing is known,
and every fault of the recording told, before the first pair is given out. Images are streamed.
"""
from __future__ import annotations

from contextlib import contextmanager
import hashlib
import logging
from pathlib import Path
import struct
from typing import Any, Iterator, NamedTuple, Optional, Union

from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores

from .camera_info import check_image_size, rig_from_info, same_calibration
from .images import grey_from_message
from .topics import choose_topics, SIDES, StereoTopics
from ..errors import BagError, StereoSpeedError
from ..geometry.rig import StereoRig
from ..records import StereoPair
from ..sync import choose_tolerance_ns, plan_pairs

_log = logging.getLogger(__name__)
_STORAGE = ('.mcap', '.db3', '.bag')
_WHOLE = "a whole, readable bag ('mcap recover' or 'ros2 bag reindex' may repair it)"


class BagMessage(NamedTuple):
    """
    One message of the stereo pair's four topics.

    :param topic: its topic in the bag.
    :param msg: the message, deserialized.
    :param log_time_ns: when it was recorded (receive time), ns.
    :param msgtype: for instance ``sensor_msgs/msg/Image``.
    :param side: ``left`` or ``right``.
    :param kind: ``image`` or ``camera_info``.
    :param stamp_ns: its header stamp, ns.
    """

    topic: str
    msg: Any
    log_time_ns: int
    msgtype: str
    side: str
    kind: str
    stamp_ns: int


class _Raw(NamedTuple):
    """A message of the four topics before deserialization."""

    side: int
    kind: str
    stamp_ns: int
    log_time_ns: int
    data: bytes
    msgtype: str


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """
    Turn whatever a damaged file makes the reader raise into one line.

    The libraries below raise their own errors and, on bytes that make no sense, nearly any
    built-in one; only calls into them belong inside.
    """
    try:
        yield
    except StereoSpeedError:
        raise
    except Exception as error:
        told = ' '.join(str(error).split()) or 'no details'
        raise BagError(path, 'file', f'{type(error).__name__}: {told[:300]}', _WHOLE) from error


def _stamp(data: Union[bytes, memoryview], big_endian: bool) -> int:
    """
    Read the header stamp, ns, of a serialized message that begins with a header.

    ROS 2: 4 bytes of CDR encapsulation, then sec and nanosec. ROS 1: 4 bytes of ``seq``, then
    secs and nsecs. Either way they are bytes 4 to 12.
    """
    sec, nanosec = struct.unpack_from('>iI' if big_endian else '<iI', data, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


class StereoBag:
    """
    A bag with the images and calibrations of one stereo pair; a context manager.

    :param path: rosbag2 folder, bare ``.mcap`` or ``.db3`` file, or ROS 1 ``.bag`` file.
    :param left: left image topic; None finds it by type and name.
    :param right: right image topic; None finds it by type and name.
    :param tolerance_ns: largest gap between the header stamps of a pair, ns; None lets
        :func:`stereo_speed.sync.choose_tolerance_ns` decide.
    """

    rig: StereoRig
    topics: StereoTopics
    tolerance_ns: int  # decided or given, ns
    unpaired_left: int  # left images without a partner
    unpaired_right: int  # right images without a partner

    def __init__(self, path: Union[str, Path], left: Optional[str] = None,
                 right: Optional[str] = None, tolerance_ns: Optional[int] = None) -> None:
        self.path = Path(path)
        self._given = (left, right)
        self._wanted_tolerance_ns = tolerance_ns
        self._reader: Optional[AnyReader] = None

    def __enter__(self) -> StereoBag:
        self._check_path()
        with _reading(self.path):
            reader = AnyReader([self.path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            reader.open()
        self._reader = reader
        try:
            self._connect(reader)
            self._scan()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; closing twice does no harm."""
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.close()

    @property
    def pair_count(self) -> int:
        """Number of pairs that :meth:`pairs` gives."""
        return len(self._plan)

    @property
    def pairing(self) -> dict[str, Any]:
        """How the images were paired, for ``summary.json``."""
        return {'pairs': len(self._plan), 'tolerance_ns': self.tolerance_ns,
                'method': 'nearest' if self.tolerance_ns else 'exact',
                'unpaired_left': self.unpaired_left, 'unpaired_right': self.unpaired_right}

    def pairs(self, tolerance_ns: Optional[int] = None) -> Iterator[StereoPair]:
        """
        Stream the pairs in time order; an image is kept only until its partner has come.

        :param tolerance_ns: another tolerance than the bag's, ns.
        :raises BagError: an image that cannot be decoded, or no pair.
        :raises CalibrationError: an image that has not the calibration's size.
        """
        if tolerance_ns is not None:
            self._make_plan(tolerance_ns)
        plan = list(self._plan)
        paired = [{pair[side] for pair in plan} for side in (0, 1)]
        seen, held, index = [0, 0], ({}, {}), 0  # type: ignore[var-annotated]
        for raw in self._raw(('image',)):
            number, seen[raw.side] = seen[raw.side], seen[raw.side] + 1
            if number in paired[raw.side]:
                held[raw.side][number] = raw
            while index < len(plan) and all(plan[index][s] in held[s] for s in (0, 1)):
                yield self._pair(index, *(held[s].pop(plan[index][s]) for s in (0, 1)))
                index += 1

    def messages(self) -> Iterator[BagMessage]:
        """Stream the messages of the four topics in the order they were recorded."""
        for raw in self._raw(('image', 'camera_info')):
            yield BagMessage(self._topic(raw), self._decode(raw), raw.log_time_ns, raw.msgtype,
                             SIDES[raw.side], raw.kind, raw.stamp_ns)

    def input_hash(self) -> str:
        """
        Hash the bag's files, whatever the folder is called.

        :return: SHA-256, hex: of the file, or for a folder of the lines that ``sha256sum``
            prints for its files, in order of their names.
        """
        if self.path.is_file():
            return _sha256(self.path)
        files = sorted(p for p in self.path.iterdir() if p.is_file())
        lines = ''.join(f'{_sha256(p)}  {p.name}\n' for p in files)
        return hashlib.sha256(lines.encode()).hexdigest()

    def _check_path(self) -> None:
        wanted = 'a rosbag2 folder, or a .mcap, .db3 or ROS 1 .bag file'
        if not self.path.exists():
            raise BagError(self.path, 'bag', 'no such file or folder', wanted)
        if self.path.is_dir() and not (self.path / 'metadata.yaml').is_file():
            inside = ', '.join(sorted(p.name for p in self.path.iterdir())[:8]) or 'nothing'
            raise BagError(self.path, 'metadata.yaml', f'none among {inside}',
                           'a rosbag2 folder (or give the .mcap, .db3 or .bag file itself)')
        if self.path.is_file() and self.path.suffix not in _STORAGE:
            raise BagError(self.path, 'bag', f'a file ending in {self.path.suffix!r}', wanted)

    def _connect(self, reader: AnyReader) -> None:
        """Choose the topics and remember their connections."""
        with _reading(self.path):
            connections = list(reader.connections)
        types = {c.topic: c.msgtype for c in connections if c.msgcount}
        self.topics = choose_topics(types, self._given, self.path)
        names = {topic: (side, kind)
                 for kind, pair in (('image', self.topics.images),
                                    ('camera_info', self.topics.infos))
                 for side, topic in enumerate(pair)}
        self._roles = {c.topic: names[c.topic] for c in connections if c.topic in names}
        self._connections = [c for c in connections if c.topic in names]

    def _raw(self, kinds: tuple[str, ...]) -> Iterator[_Raw]:
        """Stream serialized messages; every call into the reader is guarded."""
        reader = self._reader
        if reader is None:
            raise RuntimeError('StereoBag is not open: use it in a with statement')
        wanted = [c for c in self._connections if self._roles[c.topic][1] in kinds]
        source = reader.messages(wanted)
        while True:
            with _reading(self.path):
                found = next(source, None)
                if found is None:
                    return
                connection, log_time_ns, data = found
                # the second byte of CDR is even when big-endian; ROS 1 is little-endian
                stamp_ns = _stamp(data, big_endian=reader.is2 and not data[1] & 1)
            side, kind = self._roles[connection.topic]
            yield _Raw(side, kind, stamp_ns, log_time_ns, data, connection.msgtype)

    def _topic(self, raw: _Raw) -> str:
        return (self.topics.images if raw.kind == 'image' else self.topics.infos)[raw.side]

    def _decode(self, raw: _Raw) -> Any:
        assert self._reader is not None
        with _reading(self.path):
            return self._reader.deserialize(raw.data, raw.msgtype)

    def _scan(self) -> None:
        """Read all stamps and the calibrations; find every fault before the first pair."""
        stamps: tuple[list[int], list[int]] = ([], [])
        infos: list[Any] = [None, None]
        first_info: list[bytes] = [b'', b'']
        count = 0
        for raw in self._raw(('image', 'camera_info')):
            count += 1
            if raw.kind == 'image':
                self._check_rising(stamps[raw.side], raw)
                stamps[raw.side].append(raw.stamp_ns)
            elif infos[raw.side] is None:
                infos[raw.side], first_info[raw.side] = self._decode(raw), raw.data[12:]
            elif raw.data[12:] != first_info[raw.side] \
                    and not same_calibration(infos[raw.side], self._decode(raw)):
                raise BagError(f'{self.path}: {self._topic(raw)}', 'calibration',
                               f'another one at stamp {raw.stamp_ns} ns', 'one for the whole bag')
        told = sum(c.msgcount for c in self._connections)
        if count < told:
            raise BagError(self.path, 'messages', f'{count} of {told}', _WHOLE)
        for side, name in enumerate(SIDES):
            if infos[side] is None or not stamps[side]:
                raise BagError(self.path, f'{name} images and camera_info', 'no messages', _WHOLE)
        self.rig = rig_from_info(infos[0], infos[1], self.path)
        self._stamps = stamps
        self._make_plan(self._wanted_tolerance_ns)

    def _check_rising(self, stamps: list[int], raw: _Raw) -> None:
        if stamps and raw.stamp_ns < stamps[-1]:
            raise BagError(f'{self.path}: {self._topic(raw)}', 'header stamps out of order',
                           f'{raw.stamp_ns} ns after {stamps[-1]} ns', 'stamps that rise')

    def _make_plan(self, tolerance_ns: Optional[int]) -> None:
        """Decide which images pair, from their stamps."""
        left, right = self._stamps
        for topic, stamps in zip(self.topics.images, self._stamps):
            if len(stamps) > 1 and stamps[0] == stamps[-1]:
                raise BagError(f'{self.path}: {topic}', 'header stamps',
                               f'{stamps[0]} ns in all {len(stamps)} images',
                               'the time each image was taken')
        chosen = choose_tolerance_ns(left, right) if tolerance_ns is None else int(tolerance_ns)
        self._plan, self.unpaired_left, self.unpaired_right = plan_pairs(left, right, chosen)
        self.tolerance_ns = chosen
        if not self._plan:
            raise BagError(self.path, 'pairs', f'none among {len(left)} left and {len(right)} '
                           'right images', f'header stamps that agree within {chosen} ns')
        self._log_plan(tolerance_ns is None)

    def _log_plan(self, automatic: bool) -> None:
        how = f'nearest within {self.tolerance_ns} ns' if self.tolerance_ns else 'exact'
        told = f'{self.path}: {self.pair_count} pairs, {how} by header stamp, ' \
               f'{self.unpaired_left} left and {self.unpaired_right} right images unpaired'
        if automatic and self.tolerance_ns:
            _log.warning('%s (too few stamps are equal)', told)
        else:
            _log.info('%s', told)

    def _pair(self, index: int, left: _Raw, right: _Raw) -> StereoPair:
        images = []
        for raw, camera in ((left, self.rig.left), (right, self.rig.right)):
            where = f'{self.path}: {self._topic(raw)} at {raw.stamp_ns} ns'
            image = grey_from_message(self._decode(raw), where)
            check_image_size(camera, image, where)
            images.append(image)
        if images[0].dtype != images[1].dtype:
            raise BagError(self.path, 'bits per pixel', f'{images[0].dtype} left and '
                           f'{images[1].dtype} right', 'the same on both sides')
        return StereoPair(index=index, stamp_ns=left.stamp_ns, right_stamp_ns=right.stamp_ns,
                          left=images[0], right=images[1])


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open('rb') as stream:
        for block in iter(lambda: stream.read(1 << 20), b''):
            digest.update(block)
    return digest.hexdigest()
