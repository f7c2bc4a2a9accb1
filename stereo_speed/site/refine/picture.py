# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A picture of each view with what was found in it."""
from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .empty_road import as_picture
from .refiner import RefinedSite
from ...core.records import Array

_SCALE = 2
_COLOURS = ((60, 220, 60), (255, 160, 40), (60, 120, 255), (220, 60, 220), (40, 220, 220))
_CLICKED = (90, 90, 255)
_TIMES = 50  # residuals are drawn this much too long


def picture(refined: RefinedSite, right: bool) -> NDArray[np.uint8]:
    """
    Draw a view at twice its size: the fitted lines, the points found, and their residuals.

    Residuals are drawn fifty times too long, across their line. What was clicked is red.

    :param refined: the site.
    :param right: the right view.
    :return: (2 H, 2 W, 3) uint8, BGR.
    """
    grey = as_picture(refined.views[int(right)])
    canvas = cv2.cvtColor(cv2.resize(
        grey, None, fx=_SCALE, fy=_SCALE, interpolation=cv2.INTER_LINEAR), cv2.COLOR_GRAY2BGR)
    side = 'right_px' if right else 'left_px'
    for name in refined.rough.lines:
        clicked = getattr(refined.rough.lines[name], side)
        for uv in () if clicked is None else clicked:
            cv2.drawMarker(canvas, _at(uv), _CLICKED, cv2.MARKER_TILTED_CROSS, 9, 1, cv2.LINE_AA)
    road = refined.road
    for number, name in enumerate(refined.road_lines if road is not None else ()):
        colour = _COLOURS[number % len(_COLOURS)]
        low, high = road.line_range_m(number)
        s = np.linspace(low, high, 400)
        _draw(canvas, road.seen(road.points(number, s, np.zeros_like(s)), right), colour)
        picks = road.problem.picks
        mine = (picks.line == number) & (picks.right == right)
        feet = road.feet
        for uv, off, normal in zip(picks.uv_px[mine], feet.residual_px[mine], feet.normal[mine]):
            cv2.circle(canvas, _at(uv), 3, colour, 1, cv2.LINE_AA)
            cv2.line(canvas, _at(uv), _at(uv + _TIMES * off * normal), (0, 255, 255), 1,
                     cv2.LINE_AA)
        cv2.putText(canvas, name, _at(getattr(refined.site.lines[name], side)[-1]
                                      + [-60, -8]), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 1,
                    cv2.LINE_AA)
    return np.asarray(canvas, dtype=np.uint8)


def _at(uv: Array) -> tuple[int, int]:
    """Give the place of a raw pixel in the picture."""
    u, v = np.round((np.asarray(uv) + 0.5) * _SCALE - 0.5).astype(int)
    return int(u), int(v)


def _draw(canvas: NDArray[np.uint8], uv: Array, colour: tuple[int, int, int]) -> None:
    """Draw a curve of raw pixels (n, 2)."""
    seen = np.isfinite(uv).all(axis=-1)
    points = np.round((uv[seen] + 0.5) * _SCALE - 0.5).astype(np.int32)
    cv2.polylines(canvas, [points.reshape(-1, 1, 2)], False, colour, 1, cv2.LINE_AA)
