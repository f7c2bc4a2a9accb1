# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Pictures of one pass: vehicle and path marked in both views, a close-up, and a speed plot."""
from __future__ import annotations

from typing import Any, Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .overlay import COLOURS, fixed_point, PATH_COLOUR, path_points, SHIFT, visible_runs
from ..core.errors import InputError
from ..core.passes import PassResult
from ..core.records import Array, TrackUpdate
from ..core.units import SpeedUnit
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath

Image = NDArray[np.uint8]

FRONT_COLOUR = COLOURS[0]
_CLOSE_UP_SHARE = 0.6  # margin of a close-up on each side, as a share of the front's size
_CLOSE_UP_PX = 640  # least width of a close-up
_QUALITY = 92  # JPEG quality, up to 100


def marked(views: tuple[Image, Image], fronts_px: tuple[Array, Array], path: LanePath,
           rig: StereoRig, caption: str) -> tuple[Image, Image]:
    """
    Return both views of a pair with a vehicle's front and its path drawn in.

    :param views: (H, W, 3) uint8, BGR, left and right.
    :param fronts_px: (4, 2), corners of the front, left and right.
    :param path: path of the lane that the vehicle was measured along.
    :param rig: the cameras.
    :param caption: a line of text at the lower edge.
    """
    left_px, right_px, left_valid, right_valid = rig.project(path_points(path))
    return (_marked(views[0], fronts_px[0], left_px, left_valid, caption),
            _marked(views[1], fronts_px[1], right_px, right_valid, caption))


def _marked(view: Image, front_px: Array, path_px: Array, valid: NDArray[np.bool_],
            caption: str) -> Image:
    image = view.copy()
    unit = max(image.shape[1] / 1024, 0.4)  # text and lines grow with the image
    for run in visible_runs(path_px, valid):
        cv2.polylines(image, [fixed_point(run)], False, PATH_COLOUR, max(round(2 * unit), 1),
                      cv2.LINE_AA, SHIFT)
    if np.isfinite(front_px).all():
        cv2.polylines(image, [fixed_point(front_px)], True, FRONT_COLOUR,
                      max(round(2 * unit), 1), cv2.LINE_AA, SHIFT)
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.6 * unit
    (_, height), below = cv2.getTextSize(caption, font, scale, max(round(unit), 1))
    image[-(height + 3 * below):] = 0
    cv2.putText(image, caption, (below, image.shape[0] - below - below // 2), font, scale,
                (235, 235, 235), max(round(unit), 1), cv2.LINE_AA)
    return image


def close_up(view: Image, front_px: Array) -> Image:
    """
    Return a crop of the vehicle, enlarged where it is small.

    :param view: (H, W, 3) uint8, BGR.
    :param front_px: (4, 2), corners of its front in the view.
    """
    part = view[window(view, front_px, _CLOSE_UP_SHARE)]
    scale = max(_CLOSE_UP_PX / part.shape[1], 1.0)
    return np.asarray(cv2.resize(part, None, fx=scale, fy=scale,
                                 interpolation=cv2.INTER_CUBIC), np.uint8)


def window(view: NDArray[Any], front_px: Array, beyond: float = 0.0) -> tuple[slice, slice]:
    """
    Return the rows and columns of the image region around a front.

    :param view: (H, W) or (H, W, 3).
    :param front_px: (4, 2), corners of the front in the view.
    :param beyond: margin on each side, as a share of the front's size.
    """
    low, high = front_px.min(axis=0), front_px.max(axis=0)
    reach = beyond * (high - low)
    size = view.shape[1::-1]
    x0, y0 = np.clip(np.floor(low - reach), 0, size).astype(int).tolist()
    x1, y1 = np.clip(np.ceil(high + reach) + 1, 0, size).astype(int).tolist()
    return slice(y0, y1), slice(x0, x1)


def jpeg(image: Image, quality: int = _QUALITY) -> bytes:
    """Return a picture as the bytes of a JPEG file."""
    done, data = cv2.imencode('.jpg', image, (cv2.IMWRITE_JPEG_QUALITY, quality))
    if not done:
        raise InputError('picture', 'pixels', image.shape, 'what JPEG can hold')
    return data.tobytes()


def speed_plot(updates: Sequence[TrackUpdate], result: PassResult,
               lanes: Mapping[str, LanePath], unit: SpeedUnit) -> bytes:
    """
    Return a PNG file of the speed over a pass.

    :param updates: live updates of the pass.
    :param result: the pass, with smoothed speeds, final speed and second estimate.
    :param lanes: the lanes, for their speed limits.
    :param unit: unit of the speeds.
    """
    from .plots import png_of, speed_figure  # matplotlib is slow to load
    return png_of(speed_figure(updates, [result], lanes, unit=unit))
