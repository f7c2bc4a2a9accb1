# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged messages: raw and compressed images, and calibrations."""
from __future__ import annotations

from pathlib import Path
import struct
from types import SimpleNamespace
from typing import Callable, Sequence
import zlib

import cv2
import numpy as np

from ..sim.damage import damage_bytes, STRANGE
from ...io.camera_info import rig_from_info
from ...io.colour import bgr_from_message
from ...io.images import grey_from_message

Rng = np.random.Generator


def image_case(rng: Rng, folder: Path) -> Callable[[], object]:
    """Return an image message with false sizes, or with damaged compressed bytes."""
    shape = tuple(int(n) for n in rng.integers(1, 40, 2))
    pixels = rng.integers(0, 256, shape, np.uint8)
    if rng.random() < 0.4:
        sizes = [0, 1, shape[0], shape[1], 3 * shape[1], 65535, 2 ** 31, 2 ** 32 - 1]
        height, width, step = (int(n) if rng.random() < 0.5 else int(rng.choice(sizes))
                               for n in (*shape, shape[1]))
        encodings = ['mono8', 'mono16', 'bgr8', 'rgba8', 'bayer_rggb8', 'MONO8', 'yuv422', '',
                     '32FC1']
        message = SimpleNamespace(
            height=height, width=width, step=step, encoding=str(rng.choice(encodings)),
            is_bigendian=int(rng.integers(3)), data=pixels.reshape(-1))
    else:
        kind = str(rng.choice(['.jpg', '.png']))
        data = cv2.imencode(kind, pixels)[1].tobytes()
        message = SimpleNamespace(
            format=str(rng.choice(['jpeg', 'png', 'bayer_rggb8; jpeg compressed', '\x00'])),
            data=np.frombuffer(damage_bytes(rng, data), np.uint8))
    read = grey_from_message if rng.random() < 0.7 else bgr_from_message
    return lambda: read(message, 'image')


def bomb_case(rng: Rng, folder: Path) -> Callable[[], object]:
    """Return a compressed image that is valid except for false, mostly too large, sizes."""
    pixels = rng.integers(0, 256, tuple(int(n) for n in rng.integers(1, 40, 2)), np.uint8)
    sizes = [int(n) for n in rng.choice([0, 1, 2 ** 11, 2 ** 14, 2 ** 15 - 1, 2 ** 16 - 1], 2)]
    if rng.random() < 0.5:
        data = with_png_sizes(cv2.imencode('.png', pixels)[1].tobytes(), sizes)
    else:
        data = with_jpeg_sizes(cv2.imencode('.jpg', pixels)[1].tobytes(), sizes)
    if rng.random() < 0.3:
        data = data[:int(rng.integers(1, len(data) + 1))]
    message = SimpleNamespace(format='jpeg', data=np.frombuffer(data, np.uint8))
    read = grey_from_message if rng.random() < 0.7 else bgr_from_message
    return lambda: read(message, 'image')


def with_png_sizes(data: bytes, sizes: Sequence[int]) -> bytes:
    """Return a PNG file that states another width and height, with a correct checksum."""
    head = data[12:16] + struct.pack('>II', *sizes) + data[24:29]
    return data[:12] + head + struct.pack('>I', zlib.crc32(head)) + data[33:]


def with_jpeg_sizes(data: bytes, sizes: Sequence[int]) -> bytes:
    """Return a JPEG file that states another height and width."""
    at = data.index(b'\xff\xc0') + 5
    return data[:at] + struct.pack('>HH', *sizes) + data[at + 4:]


def info_case(rng: Rng, folder: Path) -> Callable[[], object]:
    """Return a pair of ``CameraInfo`` with unusual fields; if accepted, the rig must work."""
    left, right = _info('left'), _info('right')
    for _ in range(int(rng.integers(1, 4))):
        message = (left, right)[int(rng.integers(2))]
        field = str(rng.choice(['k', 'd', 'r', 'p', 'width', 'height', 'distortion_model']))
        value = getattr(message, field)
        if isinstance(value, list):
            setattr(message, field, _strange_matrix(rng, value))
        elif field == 'distortion_model':
            setattr(message, field, str(rng.choice(['', 'plumb_bob', 'equidistant', 'fisheye',
                                                    'rational_polynomial'])))
        else:
            setattr(message, field, int(rng.choice([0, 1, 64, 2 ** 16, 2 ** 32 - 1])))

    def use() -> object:
        rig = rig_from_info(left, right, 'camera_info')
        points_m = np.array([[0.0, 0.0, 10.0], [1.0, -1.0, 50.0], [0.0, 0.0, -1.0]])
        left_px = rig.project(points_m)[0]
        rig.triangulate(left_px, left_px)
        return None
    return use


def _strange_matrix(rng: Rng, values: list[float]) -> list[float]:
    """Return a matrix with one number changed, or with another number of elements."""
    numbers = [float(v) for v in STRANGE if isinstance(v, (int, float)) and abs(v) < 1e308]
    out = list(values)
    if not out:  # cut to nothing before
        return [0.0]
    if rng.random() < 0.2:
        return out[:int(rng.integers(len(out) + 1))]
    out[int(rng.integers(len(out)))] = float(rng.choice([*numbers, float('nan'), float('inf'),
                                                         1e308]))
    return out


def _info(side: str) -> SimpleNamespace:
    shift = -16.0 if side == 'right' else 0.0
    return SimpleNamespace(
        width=64, height=48, distortion_model='plumb_bob', d=[0.0] * 5,
        k=[32.0, 0.0, 31.5, 0.0, 32.0, 23.5, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[32.0, 0.0, 31.5, shift, 0.0, 32.0, 23.5, 0.0, 0.0, 0.0, 1.0, 0.0],
        header=SimpleNamespace(frame_id='left'))
