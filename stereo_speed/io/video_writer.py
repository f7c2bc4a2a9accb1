# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Write frames to a video that appears only when complete."""
from __future__ import annotations

import os
from pathlib import Path
from typing import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError

_CODEC = 'MJPG'  # OpenCV encodes it on every platform without further libraries


class VideoWriter:
    """
    An AVI file that is being written.

    :param path: final path of the file.
    :param shape: (H, W, 3), shape of the frames.
    :param rate_hz: frames per second when played.
    :raises InputError: the file cannot be written.
    """

    def __init__(self, path: Path, shape: tuple[int, ...], rate_hz: float = 10.0) -> None:
        self.path, self._aside = path, path.with_name(f'.partial-{path.name}')
        self._kept = False
        fourcc: Callable[..., int] = getattr(
            cv2, 'VideoWriter_fourcc', None) or cv2.VideoWriter.fourcc
        self._writer = cv2.VideoWriter(str(self._aside), fourcc(*_CODEC), rate_hz,
                                       (shape[1], shape[0]))
        if not self._writer.isOpened():
            raise InputError(path, 'video', 'a file that cannot be written', 'a writable folder')

    def write(self, image: NDArray[np.uint8]) -> None:
        """Add a frame (H, W, 3), BGR."""
        self._writer.write(image)

    def keep(self) -> None:
        """Finish the file and move it into place."""
        self._writer.release()
        os.replace(self._aside, self.path)
        self._kept = True

    def close(self) -> None:
        """Close the file; remove it unless :meth:`keep` was called."""
        self._writer.release()
        if not self._kept:
            self._aside.unlink(missing_ok=True)
