# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Read and write boxes in the MOTChallenge's format.

A line is ``frame,id,x,y,w,h,conf,-1,-1,-1``; frames are counted from 1.
"""
from __future__ import annotations

import math
from pathlib import Path
from typing import Iterable

import numpy as np

from .atomic import PathLike
from ..core.errors import InputError
from ..core.records import Array
from ..monocular.boxes import TargetEstimate


def load_truth(path: PathLike) -> dict[int, dict[int, Array]]:
    """
    Read boxes in the MOTChallenge's format.

    :return: for each id, its boxes (4,) by frame.
    :raises InputError: names the line, what was found and what was wanted.
    """
    wanted = 'frame,id,x,y,w,h and more, frames from 1'
    truth: dict[int, dict[int, Array]] = {}
    try:
        lines = Path(path).read_text(encoding='utf-8').splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, 'file', ' '.join(str(error).split()), wanted) from None
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            values = [float(v) for v in line.split(',')]
        except ValueError:
            values = []
        if len(values) < 6 or not all(map(math.isfinite, values)) \
                or values[0] < 1 or values[0] % 1 or values[1] % 1 or min(values[4:6]) <= 0:
            raise InputError(path, f'line {number}', repr(line[:60]), wanted)
        if len(values) > 6 and values[6] == 0:
            continue  # the MOTChallenge excludes these boxes from its scores
        truth.setdefault(int(values[1]), {})[int(values[0])] = np.array(values[2:6])
    if not truth:
        raise InputError(path, 'boxes', 'none', wanted)
    return truth


def boxes_text(estimates: Iterable[TargetEstimate]) -> str:
    """Return the text of ``boxes.txt``: upright boxes; the confidence is the similarity."""
    lines = [f'{e.frame},{e.id},' + ','.join(fixed(v) for v in (*e.envelope_px, e.similarity))
             + ',-1,-1,-1\n' for e in sorted(estimates, key=lambda e: (e.frame, e.id))]
    return ''.join(lines)


def fixed(value: float) -> str:
    """Return a number with three decimals, without a negative zero."""
    if not math.isfinite(value):
        return 'inf' if value > 0 else '-inf'
    text = f'{value:.3f}'
    return text.lstrip('-') if float(text) == 0 else text
