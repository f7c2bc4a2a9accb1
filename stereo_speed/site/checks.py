# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of picked lines in a single image: order of the points, and crossings."""
from __future__ import annotations

from typing import Optional

import numpy as np

from ..core.records import Array

_REVERSES = -0.5  # cosine between two steps below which the line reverses, at over 120 degrees
_REVERSES_AT_END = -0.9  # stricter, as one reversal alone may be a curve at a grazing angle


def out_of_order(points: Array) -> Optional[int]:
    """
    Return the index of a point that lies behind the previous one; None if there is none.

    A curve seen at a grazing angle may bend back once. A point out of order makes the line reverse
    twice in a row, or at its very end.

    :param points: (n, 2) or (n, 3) points, supposed to be in order along travel.
    """
    steps = np.diff(points, axis=0)
    length = np.linalg.norm(steps, axis=-1)
    if np.any(length == 0):
        return int(np.argmin(length)) + 1
    unit = steps / length[:, None]
    cosine = np.sum(unit[1:] * unit[:-1], axis=-1)
    twice = np.nonzero((cosine[1:] < _REVERSES) & (cosine[:-1] < _REVERSES))[0]
    if twice.size:
        return int(twice[0]) + 2
    if len(cosine) and cosine[-1] < _REVERSES_AT_END:
        return len(points) - 1
    return 1 if len(cosine) and cosine[0] < _REVERSES_AT_END else None


def crossing(a: Array, b: Array) -> Optional[tuple[int, int]]:
    """
    Return the indices of two segments of two polylines that cross; None if there are none.

    :param a: (n, 2) points of one polyline.
    :param b: (m, 2) points of the other one; may be ``a`` itself, whose neighbouring segments are
        then ignored.
    """
    p, r = a[:-1, None], np.diff(a, axis=0)[:, None]
    q, s = b[None, :-1], np.diff(b, axis=0)[None]
    det = _cross(r, s)
    with np.errstate(divide='ignore', invalid='ignore'):
        t, u = _cross(q - p, s) / det, _cross(q - p, r) / det
        hit = (det != 0) & (t > 0) & (t < 1) & (u > 0) & (u < 1)
    if a is b:
        i, j = np.indices(hit.shape)
        hit &= np.abs(i - j) > 1
    found = np.argwhere(hit)
    return (int(found[0][0]), int(found[0][1])) if len(found) else None


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of 2-D vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
