# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Detections drawn into a picture, to see what the detector sees."""
from __future__ import annotations

from typing import Any, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .records import Detection

_COLOUR = (66, 228, 240)  # BGR, told apart also by the colour-blind
_SHIFT = 4  # fractional bits of the coordinates given to OpenCV
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_detections(image: NDArray[Any], detections: Sequence[Detection], right: bool = False
                    ) -> NDArray[np.uint8]:
    """
    Draw the quads of detections with their distances along the lane and speeds.

    :param image: (H, W) or (H, W, 3), 8 bits; it is left as it is.
    :param detections: of this pair.
    :param right: whether it is the right view.
    :return: (H, W, 3) BGR.
    """
    out = np.array(image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    for found in detections:
        quad = found.right_px if right else found.left_px
        corners = np.round(quad * 2 ** _SHIFT).astype(np.int32)
        cv2.polylines(out, [corners], True, _COLOUR, 1, cv2.LINE_AA, _SHIFT)
        text = f'{found.lane} {found.s_m:.1f} m {found.speed_mps:.0f} m/s {found.confidence:.2f}'
        at = (int(quad[:, 0].min()), int(quad[:, 1].min()) - 6)
        cv2.putText(out, text, at, _FONT, 0.4, _COLOUR, 1, cv2.LINE_AA)
    return out
