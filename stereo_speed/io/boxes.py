# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Boxes of vehicles that a detector outside the package found (CSV).

A row for each box: ``stamp_ns,left_px,top_px,width_px,height_px`` and, if given, ``score``.
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
_LARGEST_PX = 1e6  # a larger number is no pixel
_LAST_NS = 2 ** 63 - 1  # stamps have 64 bits
_BOUNDS = {
    'left_px': (-_LARGEST_PX, _LARGEST_PX, 'a column in px'),
    'top_px': (-_LARGEST_PX, _LARGEST_PX, 'a row in px'),
    'width_px': (math.ulp(0.0), _LARGEST_PX, 'a width above 0 px'),
    'height_px': (math.ulp(0.0), _LARGEST_PX, 'a height above 0 px'),
    OPTIONAL: (0.0, 1.0, 'a confidence between 0 and 1')}


def load_boxes(path: PathLike) -> dict[int, list[ImageBox]]:
    """
    Return the boxes of a file by the stamp of the left image they were found in, in its order.

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
    Gives a detector the boxes of a file, those of each pair just before the pair.

    :param detector: of the pipeline.
    :param path: the file; None where there is none.
    :param name: of the detector, for errors.
    :raises InputError: no boxes for a detector that takes them, or the other way round.
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
        Yield the pairs.

        :raises InputError: in the end, where no pair has the stamp of any box.
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
