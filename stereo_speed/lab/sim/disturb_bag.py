# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Copy a bag with the images of its stereo pair, or its calibration, disturbed."""
from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Optional

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer

from .disturb import Disturbance, Disturber, grain_grey
from .write import aside, info_matrices
from ...core.errors import InputError
from ...geometry.rig import StereoRig
from ...io.bags import StereoBag
from ...io.images import grey_from_message
from ...io.recording import header_stamp_ns, Recording
from ...io.topics import StereoTopics

_GRAIN_PAIRS = 6  # pairs from which the noise is estimated
_JPEG_QUALITY = 98  # high, so that a second compression adds little noise


@dataclass(frozen=True, eq=False)
class Disturbed:
    """
    What was written.

    :param pairs: number of pairs.
    :param rig: the rig by the calibration of the source.
    :param calibrated: the rig by that of the copy.
    """

    pairs: int
    rig: StereoRig
    calibrated: StereoRig


def disturb_bag(source: Path, folder: Path, what: Disturbance, rng: np.random.Generator,
                left: Optional[str] = None, right: Optional[str] = None) -> Disturbed:
    """
    Write ``bag/``: a copy of a bag with disturbed images, or another calibration.

    Stamps and other topics are unchanged. Disturbed images are grey, as used for measuring:
    compressed ones are JPEG or PNG as before, raw ones mono8 or mono16. The folder appears when
    the bag is complete.

    :param source: a rosbag2 bag.
    :param folder: output folder; must not exist, or be empty.
    :param what: the disturbance.
    :param rng: source of randomness.
    :param left: left image topic; None finds it.
    :param right: right image topic; None finds it.
    :return: what was written.
    :raises InputError: an unusable bag, no disturbance, or a folder that is not empty.
    """
    if source.suffix == '.bag':
        raise InputError(source, 'bag', 'one of ROS 1',
                         'a rosbag2 bag (rosbags-convert makes one)')
    with StereoBag(source, left, right) as bag:
        topics, count = bag.topics, bag.pair_count
        first = list(islice(bag.pairs(), _GRAIN_PAIRS))
        grain = grain_grey([pair.left for pair in first]), grain_grey(
            [pair.right for pair in first])
        disturber = Disturber(what, bag.rig, bag.stamps_ns, grain, rng)
    with aside(folder) as work:
        _copy(source, work / 'bag', topics, disturber)
    return Disturbed(count, disturber.rig, disturber.calibrated)


def _copy(source: Path, folder: Path, topics: StereoTopics, disturber: Disturber) -> None:
    recording = Recording(source)
    images = topics.images if disturber.what.changes_images else ()
    infos = topics.infos if disturber.what.calibration else ()
    matrices = info_matrices(disturber.calibrated)
    try:
        with Writer(folder, version=9, storage_plugin=_storage(source)) as writer:
            out = {c.id: writer.add_connection(
                c.topic, c.msgtype, typestore=recording.store,
                offered_qos_profiles=getattr(c.ext, 'offered_qos_profiles', ()))
                for c in recording.connections}
            for connection, log_time_ns, data in recording.everything():
                if connection.topic in (*infos, *images):
                    message: Any = recording.store.deserialize_cdr(data, connection.msgtype)
                    if connection.topic in infos:
                        message = replace(message, **matrices[infos.index(connection.topic)])
                    else:
                        message = _disturbed(
                            message, header_stamp_ns(data, not data[1] & 1),
                            images.index(connection.topic), f'{source}: {connection.topic}',
                            disturber)
                    data = bytes(recording.store.serialize_cdr(message, connection.msgtype))
                writer.write(out[connection.id], log_time_ns, data)
    finally:
        recording.close()


def _storage(source: Path) -> StoragePlugin:
    files = [source] if source.is_file() else source.iterdir()
    return StoragePlugin.SQLITE3 if any(f.suffix == '.db3' for f in files) else StoragePlugin.MCAP


def _disturbed(message: Any, stamp_ns: int, side: int, where: str, disturber: Disturber) -> Any:
    """Return an image message with the disturbed image, and the same kind and header."""
    image = disturber.disturbed(grey_from_message(message, where), stamp_ns, side)
    mono = f'mono{8 * image.itemsize}'
    if not hasattr(message, 'encoding'):
        kind = 'png' if 'png' in message.format or image.itemsize > 1 else 'jpeg'
        return replace(message, format=f'{mono}; {kind} compressed {mono}',
                       data=_compressed(image, kind))
    pixels = np.ascontiguousarray(image.astype('<u2') if image.itemsize > 1 else image)
    return replace(message, encoding=mono, is_bigendian=0, step=pixels.strides[0],
                   data=pixels.view(np.uint8).ravel())


def _compressed(image: NDArray[Any], kind: str) -> NDArray[np.uint8]:
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if kind == 'jpeg' else []
    return np.asarray(cv2.imencode('.' + kind, image, options)[1]).ravel()
