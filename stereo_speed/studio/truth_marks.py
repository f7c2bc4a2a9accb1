# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Manual truth: fronts of a vehicle marked in several pairs become rows of ``truth.csv``.

Each mark is triangulated, and a path over time is fitted to the marks of a vehicle: straight with
constant velocity for two or three marks, a parabola in time for more.
"""
from __future__ import annotations

from typing import Callable, Iterator, Optional, Sequence

import numpy as np

from .draft import Draft, DraftFront, pixels_of
from .edits import WHERE
from ..core.errors import InputError
from ..core.records import Array
from ..geometry.rig import StereoRig
from ..io.atomic import csv_text

COLUMNS = ('stamp', 'vehicle', 'speed', 'x', 'y', 'z')
LEAST_MARKS = 2
_BENDING_MARKS = 4  # number of marks from which the path may be curved


def truth_csv(draft: Draft, rig: StereoRig, stamp_of: Callable[[int], Optional[int]]) -> str:
    """
    Return the text of a ``truth.csv``: a row for each mark, by vehicle and time.

    :param draft: the draft, with vehicles that are marked in more than one pair.
    :param rig: the rig with its drift applied.
    :param stamp_of: returns the stamp of a pair, ns; None where there is no such pair.
    :raises InputError: no such vehicle, an unfinished mark, or two marks in one pair.
    """
    rows = [row for vehicle, marks in enumerate(_by_vehicle(draft))
            for row in _rows(vehicle, marks, rig, stamp_of)]
    return csv_text(COLUMNS, rows)


def _by_vehicle(draft: Draft) -> list[list[DraftFront]]:
    """Return the marks of each vehicle that is marked in more than one pair."""
    groups: dict[int, list[DraftFront]] = {}
    for front in draft.fronts:
        groups.setdefault(front.number if front.of is None else front.of, []).append(front)
    marked = [marks for marks in groups.values() if len(marks) >= LEAST_MARKS]
    if not marked:
        raise InputError(WHERE, 'vehicles', 'none that is marked in more than one pair',
                         'the front of a vehicle marked in two pairs or more')
    for front in (front for marks in marked for front in marks):
        if not front.complete:
            raise InputError(WHERE, f'vehicle in pair {front.frame}', 'corners missing',
                             'four corners in both views')
    return marked


def _rows(vehicle: int, marks: Sequence[DraftFront], rig: StereoRig,
          stamp_of: Callable[[int], Optional[int]]) -> Iterator[tuple[object, ...]]:
    """Yield the rows of one vehicle."""
    found: dict[int, Array] = {}
    for front in marks:
        stamp_ns = stamp_of(front.frame)
        if stamp_ns is None or stamp_ns in found:
            raise InputError(WHERE, f'vehicle in pair {front.frame}', 'no such pair'
                             if stamp_ns is None else 'marked twice', 'one mark in a pair')
        found[stamp_ns] = np.mean(rig.triangulate(pixels_of(front.left), pixels_of(front.right)),
                                  axis=0)
    stamps_ns = sorted(found)
    places = np.array([found[ns] for ns in stamps_ns])
    if not np.isfinite(places).all():
        raise InputError(WHERE, 'vehicles', 'corners that do not meet in front of the cameras',
                         'the same corners in both views')
    seconds = np.array([(ns - stamps_ns[0]) * 1e-9 for ns in stamps_ns])
    degree = 1 if len(marks) < _BENDING_MARKS else 2
    way = np.polynomial.polynomial.polyfit(seconds, places, degree)
    at = np.polynomial.polynomial.polyval(seconds, way).T
    speed = np.linalg.norm(np.polynomial.polynomial.polyval(
        seconds, np.polynomial.polynomial.polyder(way)), axis=0)
    for ns, mps, place in zip(stamps_ns, speed.tolist(), at.tolist()):
        yield (f'{ns // 10**9}.{ns % 10**9:09d}', vehicle, f'{mps:.5f}',
               *(f'{value:.4f}' for value in place))
