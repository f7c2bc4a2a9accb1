# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Read stereo pairs from a bag: rosbag2 (MCAP or SQLite) or ROS 1, raw or compressed images.

Opening a bag scans the header stamps without decoding an image, so that the pairing is known and
every fault of the recording is reported before the first pair is yielded. Images are streamed.
"""
from __future__ import annotations

from array import array
from dataclasses import replace
import logging
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, NamedTuple, Optional, Union

import numpy as np
from numpy.typing import NDArray

from .camera_info import check_image_size, rig_from_info, same_calibration
from .images import grey_from_message
from .recording import FilesHash, RawMessage, Recording, WHOLE
from .source_image import SourceImage
from .topics import choose_topics, SIDES, StereoTopics
from ..core.errors import BagError
from ..core.pair_matcher import choose_tolerance_ns, plan_pairs
from ..core.records import StereoPair
from ..geometry.rig import StereoRig

_log = logging.getLogger(__name__)


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


class StereoBag:
    """
    A bag with the images and calibrations of one stereo pair; a context manager.

    :param path: rosbag2 folder, bare ``.mcap`` or ``.db3`` file, or ROS 1 ``.bag`` file.
    :param left: left image topic; None finds it by type and name.
    :param right: right image topic; None finds it by type and name.
    :param tolerance_ns: largest gap between the header stamps of a pair, ns; None lets
        :func:`stereo_speed.core.pair_matcher.choose_tolerance_ns` decide.
    :raises BagError: on entering, when the bag cannot be used.
    :raises CalibrationError: on entering, when its calibration cannot be used.
    """

    rig: StereoRig
    topics: StereoTopics
    tolerance_ns: int  # decided or given, ns
    unpaired_left: int  # left images without a partner
    unpaired_right: int  # right images without a partner
    # Called with each pair and its images as received, before the pair is yielded.
    watcher: Optional[Callable[[StereoPair, SourceImage, SourceImage], None]] = None

    def __init__(self, path: Union[str, Path], left: Optional[str] = None,
                 right: Optional[str] = None, tolerance_ns: Optional[int] = None) -> None:
        self.path = Path(path)
        self._given = (left, right)
        self._wanted_tolerance_ns = tolerance_ns
        self._told = False  # whether the log tells how images are paired
        self._hash = FilesHash(self.path)

    def __enter__(self) -> StereoBag:
        self._recording = Recording(self.path)
        try:
            self.topics = choose_topics(self._recording.types, self._given, self.path)
            self._scan()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; closing twice does no harm."""
        self._hash.close()
        self._recording.close()

    @property
    def pair_count(self) -> int:
        """Count the pairs that :meth:`pairs` gives."""
        return len(self._plan)

    @property
    def rate_hz(self) -> float:
        """Return the mean rate of the left images, Hz; 10 for a single one."""
        stamps = self._stamps[0]
        return (len(stamps) - 1) * 1e9 / (stamps[-1] - stamps[0]) if len(stamps) > 1 else 10.0

    @property
    def stamps_ns(self) -> list[int]:
        """Return the stamps of the pairs: those of their left images."""
        return [int(self._stamps[0][left]) for left, _ in self._plan]

    @property
    def pairing(self) -> dict[str, Any]:
        """Return how the images were paired, for ``summary.json``."""
        return {'pairs': len(self._plan), 'tolerance_ns': self.tolerance_ns,
                'method': 'nearest' if self.tolerance_ns else 'exact',
                'unpaired_left': self.unpaired_left, 'unpaired_right': self.unpaired_right}

    def pairs(self) -> Iterator[StereoPair]:
        """
        Stream the pairs in time order; an image is held only until its partner is read.

        :raises BagError: an image that cannot be decoded, or no pair.
        :raises CalibrationError: an image whose size is not the calibration's.
        """
        if not len(self._plan):
            left, right = self._stamps
            raise BagError(self.path, 'pairs',
                           f'none among {len(left)} left and {len(right)} right images',
                           f'header stamps that agree within {self.tolerance_ns} ns')
        if not self._told:
            self._log_plan()
            self._told = True
        return self._stream(self._plan)

    def pairs_at(self, indices: Iterable[int]) -> Iterator[StereoPair]:
        """
        Stream some of the pairs; images of the others are not decoded.

        :param indices: which, rising, below :attr:`pair_count`.
        :raises BagError: an image that cannot be decoded.
        :raises CalibrationError: an image whose size is not the calibration's.
        """
        wanted = list(indices)
        stream = self._stream(self._plan[wanted])
        for index, pair in zip(wanted, stream):
            yield replace(pair, index=index)

    def messages(self) -> Iterator[BagMessage]:
        """Stream the messages of the four topics in the order they were recorded."""
        roles = {topic: (side, kind)
                 for kind, topics in (('image', self.topics.images),
                                      ('camera_info', self.topics.infos))
                 for side, topic in zip(SIDES, topics)}
        for raw in self._recording.messages(roles):
            yield BagMessage(raw.topic, self._recording.decode(raw), raw.log_time_ns,
                             raw.msgtype, *roles[raw.topic], raw.stamp_ns)

    def input_hash(self) -> str:
        """SHA-256, hex, of the bag's files; see :func:`.recording.hash_files`."""
        return self._hash.value()

    def hash_ahead(self) -> None:
        """Begin to compute :meth:`input_hash` in a thread."""
        self._hash.begin()

    def _stream(self, plan: NDArray[np.int64]) -> Iterator[StereoPair]:
        held: tuple[dict[int, RawMessage], ...] = ({}, {})
        seen, wanted, index = [0, 0], [0, 0], 0  # wanted: the pair that a side serves next
        for raw in self._recording.messages(self.topics.images):
            side = self.topics.images.index(raw.topic)
            number, seen[side] = seen[side], seen[side] + 1
            if wanted[side] < len(plan) and number == plan[wanted[side], side]:
                held[side][number] = raw
                wanted[side] += 1
            while index < min(wanted):
                yield self._pair(index, *(held[s].pop(int(plan[index, s])) for s in (0, 1)))
                index += 1

    def _scan(self) -> None:
        """Read all stamps and the calibrations; find every fault before the first pair."""
        stamps = (array('q'), array('q'))  # 8 bytes each: there are millions in a day
        infos: dict[str, tuple[bytes, Any]] = {}
        topics = (*self.topics.images, *self.topics.infos)
        count = 0
        for raw in self._recording.messages(topics):
            count += 1
            if raw.topic in self.topics.images:
                self._check_rising(stamps[self.topics.images.index(raw.topic)], raw)
            else:
                self._check_constant(infos, raw)
        if count < self._recording.count(topics):
            raise BagError(self.path, 'messages',
                           f'{count} of {self._recording.count(topics)}', WHOLE)
        left, right = (infos[topic][1] for topic in self.topics.infos)
        self.rig = rig_from_info(left, right, self.path)
        self._stamps = stamps
        self._make_plan()

    def _check_rising(self, stamps: array[int], raw: RawMessage) -> None:
        """Add an image's stamp to those of its topic."""
        if stamps and raw.stamp_ns < stamps[-1]:
            raise BagError(f'{self.path}: {raw.topic}', 'header stamps out of order',
                           f'{raw.stamp_ns} ns after {stamps[-1]} ns', 'stamps that rise')
        stamps.append(raw.stamp_ns)

    def _check_constant(self, infos: dict[str, tuple[bytes, Any]], raw: RawMessage) -> None:
        """Keep the first calibration of each topic; the others must say the same."""
        rest = raw.data[12:]  # after the stamp; equal bytes need no decoding
        if raw.topic not in infos:
            infos[raw.topic] = (rest, self._recording.decode(raw))
        elif rest != infos[raw.topic][0] \
                and not same_calibration(infos[raw.topic][1], self._recording.decode(raw)):
            raise BagError(f'{self.path}: {raw.topic}', 'calibration',
                           f'a different one at {raw.stamp_ns} ns', 'one for the whole bag')

    def _make_plan(self) -> None:
        """Decide which images pair, from their stamps."""
        left, right = self._stamps
        for topic, stamps in zip(self.topics.images, self._stamps):
            if len(stamps) > 1 and stamps[0] == stamps[-1]:
                raise BagError(f'{self.path}: {topic}', 'header stamps',
                               f'{stamps[0]} ns in all {len(stamps)} images',
                               'the time each image was taken')
        wanted = self._wanted_tolerance_ns
        self.tolerance_ns = choose_tolerance_ns(left, right) if wanted is None else int(wanted)
        plan, self.unpaired_left, self.unpaired_right = plan_pairs(
            left, right, self.tolerance_ns)
        self._plan = np.array(plan, dtype=np.int64).reshape(-1, 2)

    def _log_plan(self) -> None:
        method = f'nearest within {self.tolerance_ns} ns' if self.tolerance_ns else 'exact'
        summary = f'{self.path}: {self.pair_count} pairs, {method} by header stamp, ' \
                  f'{self.unpaired_left} left and {self.unpaired_right} right images unpaired'
        if self._wanted_tolerance_ns is None and self.tolerance_ns:
            _log.warning('%s (too few stamps are equal)', summary)
        else:
            _log.info('%s', summary)

    def _pair(self, index: int, left: RawMessage, right: RawMessage) -> StereoPair:
        images, sources = [], []
        for raw, camera in ((left, self.rig.left), (right, self.rig.right)):
            where = f'{self.path}: {raw.topic} at {raw.stamp_ns} ns'
            message = self._recording.decode(raw)
            image = grey_from_message(message, where)
            check_image_size(camera, image, where)
            images.append(image)
            if self.watcher is not None:
                sources.append(SourceImage.from_message(message))
        if images[0].dtype != images[1].dtype:
            raise BagError(self.path, 'bits per pixel', f'{images[0].dtype} left and '
                           f'{images[1].dtype} right', 'the same on both sides')
        pair = StereoPair(index=index, stamp_ns=left.stamp_ns, right_stamp_ns=right.stamp_ns,
                          left=images[0], right=images[1])
        if self.watcher is not None:
            self.watcher(pair, *sources)
        return pair
