# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Read boxes of vehicles that were detected by another program (CSV).

Each row is a box: ``stamp_ns,left_px,top_px,width_px,height_px`` and optionally ``score``.
"""
from __future__ import annotations

import math
from pathlib import Path
from typing import Iterable, Iterator, Optional

from .atomic import PathLike
from .csv_rows import read_rows
from ..core.errors import InputError
from ..core.records import StereoPair
from ..detection.protocol import Detector, ImageBox, TakesBoxes

COLUMNS = ('stamp_ns', 'left_px', 'top_px', 'width_px', 'height_px')
OPTIONAL = 'score'
_LARGEST_PX = 1e6  # a larger number is no pixel coordinate
_LAST_NS = 2 ** 63 - 1  # stamps have 64 bits
_BOUNDS = {
    'left_px': (-_LARGEST_PX, _LARGEST_PX, 'a column in px'),
    'top_px': (-_LARGEST_PX, _LARGEST_PX, 'a row in px'),
    'width_px': (math.ulp(0.0), _LARGEST_PX, 'a width above 0 px'),
    'height_px': (math.ulp(0.0), _LARGEST_PX, 'a height above 0 px'),
    OPTIONAL: (0.0, 1.0, 'a confidence between 0 and 1')}


def load_boxes(path: PathLike) -> dict[int, list[ImageBox]]:
    """
    Return the boxes of a file by the stamp of their left image, in the order of the file.

    :raises InputError: names the line and column at fault.
    """
    names, rows = read_rows(path, 'CSV file of boxes')
    if sorted(set(names) - {OPTIONAL}) != sorted(COLUMNS) or len(set(names)) != len(names):
        raise InputError(path, 'columns', ','.join(names) or 'none',
                         f'{",".join(COLUMNS)} and, if given, {OPTIONAL}')
    out: dict[int, list[ImageBox]] = {}
    for row in rows:
        stamp_ns = int(row.number('stamp_ns', 'an integer of nanoseconds', 0, _LAST_NS, 1))
        values = {name: float(row.number(name, wanted, low, high))
                  for name, (low, high, wanted) in _BOUNDS.items() if name in names}
        out.setdefault(stamp_ns, []).append(ImageBox(**values))
    return out


class BoxFeed:
    """
    Passes the boxes of a file to a detector, those of each pair just before the pair.

    :param detector: detector of the pipeline.
    :param path: file of boxes; None where there is none.
    :param name: name of the detector, for errors.
    :raises InputError: a detector that takes boxes gets none, or one that takes none gets some.
    """

    def __init__(self, detector: Optional[Detector], path: Optional[Path], name: str) -> None:
        self.taker = detector if isinstance(detector, TakesBoxes) else None
        if self.taker is not None and path is None:
            raise InputError('replay', '--boxes', 'nothing',
                             f'a file of boxes for --detector {name}')
        if self.taker is None and path is not None:
            raise InputError('replay', '--boxes', path,
                             'a --detector that takes boxes, such as boxes, and no --init')
        self.path, self.matched = path, 0
        self.boxes: dict[int, list[ImageBox]] = {} if path is None else load_boxes(path)

    def through(self, pairs: Iterable[StereoPair]) -> Iterator[StereoPair]:
        """
        Yield the pairs, passing the boxes of each to the detector first.

        :raises InputError: after the last pair, if no box has the stamp of a pair.
        """
        for pair in pairs:
            if self.taker is not None:
                boxes = self.boxes.pop(pair.stamp_ns, None)
                self.matched += boxes is not None
                self.taker.offer(pair.stamp_ns, boxes or ())
            yield pair
        if self.boxes and not self.matched:
            raise InputError(self.path, 'stamp_ns', f'{min(self.boxes)} and others that no pair '
                             'of the bag has', 'header stamps of left images')
