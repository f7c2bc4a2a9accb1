# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A picture of each view with the lines found in it."""
from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .empty_road import as_picture
from .refiner import RefinedSite
from ...core.records import Array
from ...road.fitted import RoadFit

Colour = tuple[int, int, int]
_SCALE = 2  # size of the picture relative to the view
_COLOURS: tuple[Colour, ...] = (
    (60, 220, 60), (255, 160, 40), (60, 120, 255), (220, 60, 220), (40, 220, 220))
_CLICKED: Colour = (90, 90, 255)
_RESIDUAL: Colour = (0, 255, 255)
_MAGNIFICATION = 50  # magnification of the residuals
_NAME_PX = (-60, -8)  # offset of a line's name from its end


def picture(refined: RefinedSite, right: bool) -> NDArray[np.uint8]:
    """
    Draw a view at twice its size: the fitted lines, the points found, and their residuals.

    Residuals are magnified fifty times, across their line. Clicked points are red.

    :param refined: the site.
    :param right: whether to draw the right view.
    :return: (2 H, 2 W, 3) uint8, BGR.
    """
    grey = as_picture(refined.views[int(right)])
    canvas = np.asarray(cv2.cvtColor(cv2.resize(
        grey, None, fx=_SCALE, fy=_SCALE, interpolation=cv2.INTER_LINEAR), cv2.COLOR_GRAY2BGR),
        dtype=np.uint8)
    for line in refined.rough.picked.values():
        for uv in line.views_px[int(right)]:
            cv2.drawMarker(canvas, _canvas_px(uv), _CLICKED, cv2.MARKER_TILTED_CROSS, 9, 1,
                           cv2.LINE_AA)
    if refined.road is not None:
        for number, name in enumerate(refined.road.names):
            colour = _COLOURS[number % len(_COLOURS)]
            _draw_line(canvas, refined.road, number, right, colour)
            at = refined.site.picked[name].views_px[int(right)][-1] + _NAME_PX
            cv2.putText(canvas, name, _canvas_px(at), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 1,
                        cv2.LINE_AA)
    return canvas


def _draw_line(canvas: NDArray[np.uint8], road: RoadFit, number: int, right: bool, colour: Colour
               ) -> None:
    """Draw a fitted line, its points and their residuals."""
    s = np.linspace(*road.line_range_m(number), 400)
    _draw_curve(canvas, road.seen(road.points(number, s, np.zeros_like(s)), right), colour)
    picks, feet = road.problem.picks, road.feet
    rows = picks.of_line(number, right)
    for uv, off, normal in zip(picks.uv_px[rows], feet.residual_px[rows], feet.normal[rows]):
        cv2.circle(canvas, _canvas_px(uv), 3, colour, 1, cv2.LINE_AA)
        end = uv + _MAGNIFICATION * off * normal
        cv2.line(canvas, _canvas_px(uv), _canvas_px(end), _RESIDUAL, 1, cv2.LINE_AA)


def _canvas_px(uv: Array) -> tuple[int, int]:
    """Return the pixel of the picture that shows a raw pixel."""
    u, v = np.round((np.asarray(uv) + 0.5) * _SCALE - 0.5).astype(int)
    return int(u), int(v)


def _draw_curve(canvas: NDArray[np.uint8], uv: Array, colour: Colour) -> None:
    """Draw a curve of raw pixels (n, 2)."""
    seen = np.isfinite(uv).all(axis=-1)
    points = np.round((uv[seen] + 0.5) * _SCALE - 0.5).astype(np.int32)
    cv2.polylines(canvas, [points.reshape(-1, 1, 2)], False, colour, 1, cv2.LINE_AA)
