# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Annotated frames of the monocular tracker, and the map drawn over a frame."""
from __future__ import annotations

from typing import Iterable, Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from .overlay import colour_of
from ..monocular.boxes import corners, TargetEstimate, TargetState
from ..monocular.distance import DistanceField, INACCESSIBLE, PATHWAY

Image = NDArray[np.uint8]
_SHIFT = 4  # fractional bits of the coordinates given to OpenCV
_TINT = {PATHWAY: (115, 158, 0), INACCESSIBLE: (0, 94, 213)}  # BGR
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_targets(image: Image, estimates: Iterable[TargetEstimate],
                 labels: Optional[NDArray[np.uint8]] = None) -> Image:
    """
    Return a frame with boxes and numbers of the targets; predicted boxes are thin.

    :param image: (H, W, 3) uint8, BGR; it is not changed.
    :param estimates: the targets in the frame.
    :param labels: the map, to draw its boundaries; None draws none.
    """
    drawn = image.copy()
    if labels is not None:
        _draw_boundaries(drawn, labels)
    unit = max(image.shape[1] / 1024, 0.5)
    for estimate in estimates:
        colour = colour_of(estimate.id)
        seen = estimate.state is TargetState.TRACKED
        points = np.round(corners(estimate.box_px, estimate.angle_rad) * 2 ** _SHIFT)
        cv2.polylines(drawn, [points.astype(np.int32)], True, colour,
                      max(round(2 * unit), 1) if seen else 1, cv2.LINE_AA, _SHIFT)
        x, y = estimate.envelope_px[:2]
        text = f'{estimate.id}' if seen else f'{estimate.id} hidden'
        cv2.putText(drawn, text, (int(x), max(int(y) - 4, 10)), _FONT, 0.6 * unit, colour, 1,
                    cv2.LINE_AA)
    return drawn


def draw_field(field: DistanceField, image: Optional[Image] = None,
               step_px: float = 20.0) -> Image:
    """
    Return a drawing of a map: tinted regions, boundaries, and contours of the distance.

    :param image: (H, W, 3), frame to draw over; None for a grey one.
    :param step_px: distance between the contours.
    """
    if image is None:
        image = np.full((field.height, field.width, 3), 128, np.uint8)
    drawn = image.copy()
    for kind, colour in _TINT.items():
        inside = field.labels == kind
        drawn[inside] = (0.7 * image[inside] + 0.3 * np.array(colour)).astype(np.uint8)
    rank = np.floor(field.unsigned_px / step_px)
    lines = np.zeros(rank.shape, dtype=bool)
    lines[:, 1:] |= rank[:, 1:] != rank[:, :-1]
    lines[1:] |= rank[1:] != rank[:-1]
    lines &= field.labels != INACCESSIBLE
    drawn[lines] = (0.5 * drawn[lines] + 100).astype(np.uint8)
    _draw_boundaries(drawn, field.labels)
    return drawn


def _draw_boundaries(image: Image, labels: NDArray[np.uint8]) -> None:
    """Draw the boundaries between regions."""
    edge = np.zeros(labels.shape, dtype=bool)
    edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    edge[1:] |= labels[1:] != labels[:-1]
    image[edge] = (66, 228, 240)
