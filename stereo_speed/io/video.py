# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Read the colour frames of one camera: a video file, a folder of images or a bag.

Frames are counted from 1, as the MOTChallenge counts them.
"""
from __future__ import annotations

from pathlib import Path
import re
from typing import Iterator, NamedTuple, Optional, Union

import cv2
import numpy as np

from .colour import bgr_from_message, Colour
from .decoding import caught_chatter, read_image
from .recording import Recording
from .topics import IMAGE_TYPES
from ..core.errors import BagError, InputError

IMAGE_SUFFIXES = ('.png', '.jpg', '.jpeg', '.bmp', '.tif', '.tiff', '.ppm')
_BAG_SUFFIXES = ('.mcap', '.db3', '.bag')
_MOST_FRAMES = 1e9  # files of unknown length state a huge number of frames
_WANTED = 'a video file, a folder of images, or a bag'


class Frame(NamedTuple):
    """
    One frame.

    :param number: number of the frame in the video, from 1.
    :param stamp_ns: its header stamp, ns; None where it is not from a bag.
    :param image: (H, W, 3) uint8, BGR.
    """

    number: int
    stamp_ns: Optional[int]
    image: Colour


def read_frames(path: Union[str, Path], topic: Optional[str] = None) -> Iterator[Frame]:
    """
    Stream the frames of a video.

    :param path: video file, folder of images (in the natural order of their names), or bag.
    :param topic: image topic of a bag; None for its only one.
    :raises InputError: an unreadable source, no frame, or frames of several sizes.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(path, 'video', 'no such file or folder', _WANTED)
    if is_bag(path):
        frames = _bag_frames(path, topic)
    elif topic is not None:
        raise InputError(path, '--topic', topic, 'none: only bags have topics')
    else:
        frames = _folder_frames(path) if path.is_dir() else _file_frames(path)
    return _checked(frames, path)


def frames_missing(path: Union[str, Path], frames: int) -> int:
    """
    Return how many frames a video file states beyond those that were read.

    :param frames: number of frames read.
    :return: 0 for folders and bags, which state no number, and for a difference of one frame,
        because the stated numbers are not exact.
    """
    path = Path(path)
    if not path.is_file() or is_bag(path):
        return 0
    with caught_chatter(everything=True):
        capture = cv2.VideoCapture(str(path))
    stated = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    capture.release()
    missing = round(stated) - frames if 0 < stated < _MOST_FRAMES else 0
    return missing if missing > 1 else 0


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag, by its name and content."""
    if path.is_dir():
        return (path / 'metadata.yaml').is_file() or (
            image_files(path) == [] and any(p.suffix in _BAG_SUFFIXES for p in path.iterdir()))
    return path.suffix in _BAG_SUFFIXES


def image_files(folder: Path) -> list[Path]:
    """List the images of a folder in natural order: 2 before 10."""
    found = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES]
    return sorted(found, key=lambda p: [int(t) if t.isdecimal() else t
                                        for t in re.split(r'(\d+)', p.name)])


def _checked(frames: Iterator[Frame], path: Path) -> Iterator[Frame]:
    """Pass frames on; refuse an empty video and a change of size."""
    size: Optional[tuple[int, ...]] = None
    for frame in frames:
        if size is not None and frame.image.shape != size:
            raise InputError(path, f'size of frame {frame.number}', _size_of(frame.image.shape),
                             f'{_size_of(size)} as in frame 1')
        size = frame.image.shape
        yield frame
    if size is None:
        raise InputError(path, 'frames', 'none that can be decoded', _WANTED)


def _size_of(shape: tuple[int, ...]) -> str:
    return f'{shape[1]}x{shape[0]} px'


def _file_frames(path: Path) -> Iterator[Frame]:
    with caught_chatter(everything=True):  # an unreadable file shows by the result
        capture = cv2.VideoCapture(str(path))
    try:
        number = 0
        while capture.isOpened():
            with caught_chatter(everything=True):
                there, image = capture.read()
            if not there:
                break
            number += 1
            yield Frame(number, None, np.asarray(image, dtype=np.uint8))
    finally:
        capture.release()


def _folder_frames(folder: Path) -> Iterator[Frame]:
    for number, path in enumerate(image_files(folder), 1):
        image = read_image(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION,
                           'a complete image')
        yield Frame(number, None, np.asarray(image, dtype=np.uint8))


def _bag_frames(path: Path, topic: Optional[str]) -> Iterator[Frame]:
    recording = Recording(path)
    try:
        name = _image_topic(recording, topic, path)
        for number, raw in enumerate(recording.messages([name]), 1):
            image = bgr_from_message(recording.decode(raw), f'{path}: {name} at {raw.stamp_ns} ns')
            yield Frame(number, raw.stamp_ns, image)
    finally:
        recording.close()


def _image_topic(recording: Recording, topic: Optional[str], path: Path) -> str:
    """Choose the image topic: the one given, else the only one."""
    found = sorted(t for t, kind in recording.types.items()
                   if kind in IMAGE_TYPES and not t.endswith('/compressedDepth'))
    listed = ', '.join(found) or 'none'
    if topic is not None:
        name = topic if topic in found else '/' + topic
        if name not in found:
            raise BagError(path, f'--topic {topic}', listed, 'a topic of images in the bag')
        return name
    # of the same images, raw and compressed, take the raw ones, which are lossless
    found = [t for t in found
             if not (t.endswith('/compressed') and t[:-len('/compressed')] in found)]
    if len(found) != 1:
        raise BagError(path, 'image topic', listed, 'one only, or --topic TOPIC')
    return found[0]
