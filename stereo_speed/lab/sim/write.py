# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Write a simulation as a bag with its site, initial fronts and truth."""
from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
import shutil
import tempfile
from typing import Any, Iterable, Iterator, Mapping, Union

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
from rosbags.typesys import get_typestore, Stores
import yaml

from .sequence import SimSequence
from .traffic import TrafficRow, TrafficStream
from .truth import TRAFFIC_COLUMNS, write_truth
from ...core.errors import InputError
from ...core.records import Array, StereoPair
from ...geometry.camera import Camera
from ...geometry.rig import StereoRig

STORAGES = ('mcap', 'sqlite3', 'ros1')
ENCODINGS = ('mono8', 'bgr8', 'rgb8', 'bgra8', 'rgba8', 'bayer_rggb8', 'bayer_bggr8',
             'bayer_gbrg8', 'bayer_grbg8', 'mono16')
_IMAGE, _COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'
_INFO = 'sensor_msgs/msg/CameraInfo'


def rectification(rig: StereoRig) -> tuple[Array, Array, Array, Array]:
    """
    Rectify a rig: x along the baseline, z as close as possible to both optical axes.

    :return: R1 (3, 3), R2 (3, 3), P1 (3, 4) and P2 (3, 4), as ``CameraInfo`` holds them.
    """
    if not np.any(rig.t[1:]) and np.array_equal(rig.R, np.eye(3)):
        r1 = r2 = np.eye(3)  # exactly, without rounding
    else:
        x = -rig.R.T @ rig.t / rig.baseline_m
        ahead = rig.R[2] + [0.0, 0.0, 1.0]  # both axes in the left frame
        y = np.cross(ahead, x)
        y /= np.linalg.norm(y)
        r1 = np.stack([x, y, np.cross(x, y)])
        r2 = r1 @ rig.R.T
    k = rig.left.K
    p1 = np.zeros((3, 4))
    p1[:, :3] = [[k[0, 0], 0.0, k[0, 2]], [0.0, k[0, 0], k[1, 2]], [0.0, 0.0, 1.0]]
    p2 = p1.copy()
    p2[0, 3] = -k[0, 0] * rig.baseline_m
    return r1, r2, p1, p2


def info_matrices(rig: StereoRig) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return d, k, r and p, flat, of the ``CameraInfo`` of the left and of the right camera."""
    r1, r2, p1, p2 = rectification(rig)
    left, right = (
        {key: np.array(value, dtype=np.float64).ravel()
         for key, value in (('d', camera.D), ('k', camera.K), ('r', r), ('p', p))}
        for camera, r, p in ((rig.left, r1, p1), (rig.right, r2, p2)))
    return left, right


def write_bag(sequence: SimSequence, folder: Union[str, Path], storage: str = 'mcap',
              encoding: str = 'mono8', compressed: bool = False,
              jpeg_quality: int = 95) -> Path:
    """
    Write ``bag/`` (``bag.bag`` for ROS 1), ``site.yaml``, ``init.yaml`` and ``truth.csv``.

    The folder appears only when it is complete.

    :param sequence: the sequence to write.
    :param folder: output folder; must not exist, or be empty.
    :param storage: ``mcap``, ``sqlite3`` or ``ros1``.
    :param encoding: encoding of the raw images: see ``ENCODINGS``.
    :param compressed: whether to write ``CompressedImage`` messages (JPEG) instead.
    :param jpeg_quality: JPEG quality, 1 to 100.
    :return: the folder.
    :raises InputError: the folder is not empty, or the storage or encoding is unknown.
    """
    _check(storage, encoding)
    with aside(folder) as work:
        _write_messages(sequence.rig, sequence.pairs, work, storage,
                        encoding if not compressed else '', jpeg_quality)
        _write_yaml(sequence.site, work / 'site.yaml')
        _write_yaml(sequence.init, work / 'init.yaml')
        write_truth(sequence.truth, work / 'truth.csv')
    return Path(folder)


def write_traffic_bag(stream: TrafficStream, folder: Union[str, Path], compressed: bool = False
                      ) -> Path:
    """
    Write a stream of traffic as it is generated: ``bag/`` (MCAP), ``site.yaml``, ``truth.csv``.

    The parameters, the result and the errors are those of :func:`write_bag`.
    """
    truth: list[TrafficRow] = []

    def pairs() -> Iterator[StereoPair]:
        for one in stream:
            truth.extend(one.truth)
            yield one.pair
    with aside(folder) as work:
        _write_messages(stream.rig, pairs(), work, 'mcap', '' if compressed else 'mono8')
        _write_yaml(stream.site, work / 'site.yaml')
        write_truth(truth, work / 'truth.csv', TRAFFIC_COLUMNS)
    return Path(folder)


def write_pairs(rig: StereoRig, pairs: Iterable[StereoPair], folder: Union[str, Path],
                storage: str = 'mcap', compressed: bool = False) -> Path:
    """
    Write only ``bag/`` (``bag.bag`` for ROS 1).

    :param rig: the calibrated rig.
    :param pairs: pairs in order of stamps.

    The other parameters, the result and the errors are those of :func:`write_bag`.
    """
    with aside(folder) as work:
        _write_messages(rig, pairs, work, storage, '' if compressed else 'mono8')
    return Path(folder)


def _check(storage: str, encoding: str) -> None:
    for what, value, known in (('storage', storage, STORAGES), ('encoding', encoding, ENCODINGS)):
        if value not in known:
            raise InputError('simulation', what, value, 'one of ' + ', '.join(known))


@contextmanager
def aside(folder: Union[str, Path]) -> Iterator[Path]:
    """Yield a folder to write into, which replaces the output folder if the block succeeds."""
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(folder, 'output folder', 'something there already',
                         'a folder that is empty or not there')
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f'.{folder.name}.', dir=folder.parent) as scratch:
        work = Path(scratch) / folder.name
        work.mkdir()
        yield work
        if folder.exists():
            folder.rmdir()
        shutil.move(str(work), str(folder))


def _write_yaml(content: Mapping[str, object], path: Path) -> None:
    path.write_text(yaml.safe_dump(
        dict(content), sort_keys=False, default_flow_style=None, width=99))


def _write_messages(rig: StereoRig, pairs: Iterable[StereoPair], folder: Path, storage: str,
                    encoding: str, quality: int = 95) -> None:
    """Write the bag; an empty encoding means compressed images."""
    store = get_typestore(Stores.ROS1_NOETIC if storage == 'ros1' else Stores.ROS2_JAZZY)
    make = _Messages(rig, store.types, storage == 'ros1', encoding, quality)
    image_type = _IMAGE if encoding else _COMPRESSED
    bag: Union[Writer1, Writer2]
    if storage == 'ros1':
        bag = Writer1(folder / 'bag.bag')
    else:
        plugin = StoragePlugin.MCAP if storage == 'mcap' else StoragePlugin.SQLITE3
        bag = Writer2(folder / 'bag', version=9, storage_plugin=plugin)
    with bag:
        connections = {}
        for side in ('left', 'right'):
            topic = f'/stereo/{side}/image_raw' + ('' if encoding else '/compressed')
            connections[side, True] = bag.add_connection(topic, image_type, typestore=store)
            connections[side, False] = bag.add_connection(
                f'/stereo/{side}/camera_info', _INFO, typestore=store)
        for stamp_ns, side, is_image, message in make.in_order(pairs):
            kind = image_type if is_image else _INFO
            raw = (store.serialize_ros1(message, kind) if storage == 'ros1'
                   else store.serialize_cdr(message, kind))
            bag.write(connections[side, is_image], stamp_ns, raw)


class _Messages:
    """Makes the messages of pairs, in the order of their stamps."""

    def __init__(self, rig: StereoRig, types: Any, ros1: bool, encoding: str,
                 quality: int) -> None:
        self.rig, self.types, self.ros1 = rig, types, ros1
        self.matrices = info_matrices(rig)
        self.encoding, self.quality = encoding, quality

    def in_order(self, pairs: Iterable[StereoPair]) -> Iterator[tuple[int, str, bool, Any]]:
        """Yield stamp (ns), side, whether it is an image, and the message."""
        cameras, (left, right) = self.rig, self.matrices
        for pair in pairs:
            sides = [(pair.stamp_ns, 'left', pair.left, cameras.left, left),
                     (pair.right_stamp_ns, 'right', pair.right, cameras.right, right)]
            for stamp_ns, side, image, camera, matrices in sorted(
                    sides, key=lambda item: item[0]):
                header = self._header(stamp_ns, f'stereo_{side}_optical_frame')
                yield stamp_ns, side, False, self._info(header, camera, matrices)
                yield stamp_ns, side, True, self._image(header, image)

    def _header(self, stamp_ns: int, frame_id: str) -> Any:
        stamp = self.types['builtin_interfaces/msg/Time'](
            sec=stamp_ns // 10 ** 9, nanosec=stamp_ns % 10 ** 9)
        more = {'seq': 0} if self.ros1 else {}
        return self.types['std_msgs/msg/Header'](stamp=stamp, frame_id=frame_id, **more)

    def _info(self, header: Any, camera: Camera, matrices: Mapping[str, Array]) -> Any:
        roi = self.types['sensor_msgs/msg/RegionOfInterest'](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return self.types[_INFO](
            header=header, height=camera.height_px, width=camera.width_px,
            distortion_model=camera.model, binning_x=0, binning_y=0, roi=roi,
            **{key.upper() if self.ros1 else key: value for key, value in matrices.items()})

    def _image(self, header: Any, image: NDArray[np.uint8]) -> Any:
        if not self.encoding:
            _, jpeg = cv2.imencode('.jpg', image, [cv2.IMWRITE_JPEG_QUALITY, self.quality])
            return self.types[_COMPRESSED](
                header=header, format='mono8; jpeg compressed mono8', data=jpeg.ravel())
        data = encode(image, self.encoding)
        return self.types[_IMAGE](
            header=header, height=image.shape[0], width=image.shape[1], encoding=self.encoding,
            is_bigendian=0, step=data.nbytes // image.shape[0], data=data.view(np.uint8).ravel())


def encode(image: NDArray[np.uint8], encoding: str) -> NDArray[np.uint8 | np.uint16]:
    """
    Turn a grey image into another encoding of the same scene.

    :param image: (rows, columns) uint8.
    :param encoding: see ``ENCODINGS``; a grey Bayer mosaic is the image itself.
    """
    if encoding == 'mono16':
        return np.asarray(image.astype('<u2') * np.array(257, dtype='<u2'))
    channels = {'bgr8': 3, 'rgb8': 3, 'bgra8': 4, 'rgba8': 4}.get(encoding)
    if channels is None:
        return np.ascontiguousarray(image)
    out = np.repeat(image[..., None], channels, axis=2)
    if channels == 4:
        out[..., 3] = 255
    return out
