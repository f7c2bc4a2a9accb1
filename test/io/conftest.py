# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Tiny bags of every kind, written with rosbags, for the tests of ``io``."""
from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
from rosbags.typesys import get_typestore, Stores
from stereo_speed.monocular.boxes import TargetEstimate, TargetState

STEP_NS = 200_000_000
START_NS = 1_700_000_000_000_000_000
SIZE = (16, 12)  # width, height


class Messages:
    """Builds messages of one ROS version; only the names of fields differ."""

    def __init__(self, ros1=False):
        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)

    def make(self, name):
        return self.store.types[name]

    def header(self, stamp_ns, frame='stereo_left_optical_frame'):
        stamp = self.make('builtin_interfaces/msg/Time')(
            sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        extra = {'seq': 0x01020304} if self.ros1 else {}
        return self.make('std_msgs/msg/Header')(stamp=stamp, frame_id=frame, **extra)

    def image(self, stamp_ns, pixels, encoding='mono8', padding=0, big=False):
        """Pack (H, W[, C]) pixels with ``padding`` bytes behind each row."""
        if pixels.dtype == np.uint16:
            pixels = pixels.astype('>u2' if big else '<u2')
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
        rows = np.hstack([rows, np.full((len(rows), padding), 77, np.uint8)])
        return self.make('sensor_msgs/msg/Image')(
            header=self.header(stamp_ns), height=pixels.shape[0], width=pixels.shape[1],
            encoding=encoding, is_bigendian=int(big), step=rows.shape[1],
            data=rows.reshape(-1))

    def compressed(self, stamp_ns, pixels, kind='jpg', fmt='mono8; jpeg compressed mono8'):
        data = cv2.imencode('.' + kind, pixels)[1].reshape(-1)
        return self.make('sensor_msgs/msg/CompressedImage')(
            header=self.header(stamp_ns), format=fmt, data=data)

    def info(self, stamp_ns, side, **changes):
        fields = calibration(side)
        fields.update(changes)
        if self.ros1:
            fields = {k.upper() if k in 'dkrp' else k: v for k, v in fields.items()}
        roi = self.make('sensor_msgs/msg/RegionOfInterest')(
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return self.make('sensor_msgs/msg/CameraInfo')(
            header=self.header(stamp_ns), binning_x=0, binning_y=0, roi=roi, **fields)


def calibration(side):
    """Return the fields of a CameraInfo: f = 20 px, baseline 0.5 m."""
    tx = -10.0 if side == 'right' else 0.0
    return {
        'height': SIZE[1], 'width': SIZE[0], 'distortion_model': 'plumb_bob',
        'd': np.zeros(5), 'k': np.array([20.0, 0, 7.5, 0, 20, 5.5, 0, 0, 1]),
        'r': np.eye(3).reshape(-1),
        'p': np.array([20.0, 0, 7.5, tx, 0, 20, 5.5, 0, 0, 0, 1, 0])}


def picture(seed, shape=(12, 16), dtype=np.uint8):
    """Return a random image."""
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype)


def recording(make, count=3, offset_ns=0, image=None):
    """Return (topic, message, log time) of a stereo stream; receive times use another clock."""
    image = image or (lambda stamp, seed: make.image(stamp, picture(seed)))
    rows = []
    for i in range(count):
        for side, shift in (('left', 0), ('right', offset_ns)):
            stamp = START_NS + i * STEP_NS + shift
            log = 5_000 + len(rows)
            rows.append((f'/stereo/{side}/camera_info', make.info(stamp, side), log))
            rows.append((f'/stereo/{side}/image_raw', image(stamp, 2 * i + (side == 'right')),
                         log))
    return rows


def write(path, rows, make, kind='mcap'):
    """Write (topic, message, log time) rows, and return the path to open."""
    store = make.store
    if kind == 'ros1':
        path = path.with_suffix('.bag')
        writer = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if kind == 'mcap' else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    with writer:
        connections = {}
        for topic, msg, log in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, msg.__msgtype__, typestore=store)
            pack = store.serialize_ros1 if kind == 'ros1' else store.serialize_cdr
            writer.write(connections[topic], log, pack(msg, msg.__msgtype__))
    return path


@pytest.fixture()
def bags():
    """Return all helpers above, without an import between test files."""
    return SimpleNamespace(
        ros2=Messages(), ros1=Messages(ros1=True), recording=recording, write=write,
        picture=picture, calibration=calibration, STEP_NS=STEP_NS, START_NS=START_NS, SIZE=SIZE)


@pytest.fixture()
def written(tmp_path):
    """Return a function that writes a text into a file and returns its path."""
    def write_text(text, name='file.yaml'):
        path = tmp_path / name
        path.write_text(text, encoding='utf-8')
        return path
    return write_text


@pytest.fixture()
def estimate():
    """Return a function that makes the estimate of a target in a frame."""
    def make(frame, number=1, box=(1, 2, 3, 4), angle_rad=0.0, **changes):
        fields = {'state': TargetState.TRACKED, 'distance_px': -2.5, 'distance_rate_px': -0.0001,
                  'similarity': 0.875, 'velocity_px': np.zeros(2), **changes}
        return TargetEstimate(frame=frame, id=number, box_px=np.array(box, dtype=float),
                              angle_rad=angle_rad, **fields)
    return make
