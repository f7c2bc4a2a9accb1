# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Annotated frames: the lanes' paths, each vehicle's front and its speed over an image."""
from __future__ import annotations

from typing import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.records import Array, StereoPair, TrackState, TrackUpdate
from ..core.units import KMH_MPS, MPH_MPS
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..vision.grey import to_eight_bits

Image = NDArray[np.uint8]

# BGR, distinguishable with colour blindness (Okabe and Ito)
COLOURS = ((0, 159, 230), (233, 180, 86), (115, 158, 0), (66, 228, 240), (167, 121, 204),
           (0, 94, 213))
PATH_COLOUR = (178, 114, 0)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_STEP_M = 0.5  # between the drawn points of a path
SHIFT = 4  # fractional bits of the coordinates given to OpenCV


def colour_of(track: int) -> tuple[int, int, int]:
    """Return the BGR colour of a track."""
    return COLOURS[track % len(COLOURS)]


def draw(pair: StereoPair, updates: Sequence[TrackUpdate], lanes: Mapping[str, LanePath],
         rig: StereoRig, *, right: bool = False) -> Image:
    """
    Draw paths, fronts and speeds over one image of a pair.

    :param pair: the pair.
    :param updates: updates of the tracks by this pair.
    :param lanes: the lanes' paths.
    :param rig: the cameras.
    :param right: whether to draw over the right image instead of the left one.
    :return: (H, W, 3) uint8, BGR.
    """
    grey = to_eight_bits(pair.right if right else pair.left)
    image: Image = np.repeat(grey[..., None], 3, axis=2)
    unit = max(image.shape[1] / 1024, 0.4)  # text and lines grow with the image
    for lane in lanes.values():
        _draw_path(image, lane, rig, unit, right)
    for update in updates:
        _draw_vehicle(image, update, update.quad_right_px if right else update.quad_left_px, unit)
    return image


def strip(frames: Sequence[Image], columns: int = 3, width_px: int = 640) -> Image:
    """
    Lay frames out as one sheet, row by row.

    :param frames: (H, W, 3) uint8, BGR, all of one size, at least one.
    :param columns: frames per row.
    :param width_px: width of each frame on the sheet.
    """
    height_px = round(width_px * frames[0].shape[0] / frames[0].shape[1])
    columns = min(columns, len(frames))
    gap = 4
    rows = -(-len(frames) // columns)
    sheet = np.full((rows * (height_px + gap) - gap, columns * (width_px + gap) - gap, 3), 255,
                    np.uint8)
    for index, frame in enumerate(frames):
        top = index // columns * (height_px + gap)
        left = index % columns * (width_px + gap)
        sheet[top:top + height_px, left:left + width_px] = cv2.resize(
            frame, (width_px, height_px), interpolation=cv2.INTER_AREA)
    return sheet


def label(update: TrackUpdate) -> tuple[str, str]:
    """Return the two lines beside a vehicle: the speed in mph, and in km/h."""
    if update.state is TrackState.TENTATIVE:
        return f'#{update.track}', 'measuring'
    speed, std = update.speed_mps, update.speed_std_mps
    return (f'#{update.track} {speed / MPH_MPS:.1f} +/- {std / MPH_MPS:.1f} mph',
            f'{speed / KMH_MPS:.1f} +/- {std / KMH_MPS:.1f} km/h')


def _draw_path(image: Image, lane: LanePath, rig: StereoRig, unit: float, right: bool) -> None:
    """Draw the visible runs of a lane's path, half transparent."""
    views = rig.project(path_points(lane))
    uv, valid = (views[1], views[3]) if right else (views[0], views[2])
    over = image.copy()
    for run in visible_runs(uv, valid):
        cv2.polylines(over, [fixed_point(run)], False, PATH_COLOUR, max(round(3 * unit), 1),
                      cv2.LINE_AA, SHIFT)
    cv2.addWeighted(over, 0.6, image, 0.4, 0.0, dst=image)


def path_points(lane: LanePath) -> Array:
    """Return the points (n, 3), m, through which a lane's path is drawn."""
    count = max(int(np.ceil(lane.path.length_m / _STEP_M)) + 1, 2)
    return lane.path.position(np.linspace(0.0, lane.path.length_m, count))


def visible_runs(uv: Array, valid: NDArray[np.bool_]) -> list[Array]:
    """Split points (n, 2) into the runs of at least two valid ones."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], valid, [False]]).astype(int)))
    return [uv[a:b] for a, b in edges.reshape(-1, 2) if b - a > 1]


def fixed_point(uv: Array) -> NDArray[np.int32]:
    """Convert pixels (n, 2) to OpenCV's fixed-point numbers, clipped to their range."""
    fixed: NDArray[np.int32] = np.clip(
        np.round(uv * 2.0 ** SHIFT), -2.0 ** 24, 2.0 ** 24).astype(np.int32)
    return fixed


def _draw_vehicle(image: Image, update: TrackUpdate, quad_px: Array, unit: float) -> None:
    """Draw a vehicle's front (4, 2) and its label."""
    if not np.all(np.isfinite(quad_px)):
        return
    colour = colour_of(update.track)
    thick = max(round(2 * unit), 1)
    cv2.polylines(image, [fixed_point(quad_px)], True, colour, thick, cv2.LINE_AA, SHIFT)
    _draw_label(image, label(update), quad_px, colour, unit)


def _draw_label(image: Image, lines: Sequence[str], quad_px: Array,
                colour: tuple[int, int, int], unit: float) -> None:
    """Put lines of text on a dark plate above the front, or below where there is no room."""
    scale, thick = 0.75 * unit, max(round(1.4 * unit), 1)
    sizes = [cv2.getTextSize(line, _FONT, scale, thick)[0] for line in lines]
    line_px, pad = round(1.55 * max(h for _, h in sizes)), round(6 * unit)
    width, height = max(w for w, _ in sizes) + 2 * pad, line_px * len(lines) + pad
    x = int(np.clip(quad_px[:, 0].mean() - width / 2, 0, max(image.shape[1] - width, 0)))
    y = round(float(quad_px[:, 1].min())) - height - 2 * pad
    if y < 0:
        y = round(float(quad_px[:, 1].max())) + 2 * pad
    y = int(np.clip(y, 0, max(image.shape[0] - height, 0)))
    plate = image[y:y + height, x:x + width]
    plate[:] = (plate * 0.3).astype(np.uint8)
    for index, line in enumerate(lines):
        cv2.putText(image, line, (x + pad, y + (index + 1) * line_px - pad // 3), _FONT, scale,
                    colour if index == 0 else (235, 235, 235), thick, cv2.LINE_AA)
