# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Targets and their boxes.

A box is [x, y, w, h]: its left and upper edge, width and height, px. An oriented box is rotated
about its centre by an angle from the x axis towards the y axis (y is down, so clockwise as seen).
"""
from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from ..core.records import Array


class TargetState(str, Enum):
    """Life of a target."""

    TRACKED = 'tracked'
    OCCLUDED = 'occluded'  # currently not seen; its box is predicted
    LOST = 'lost'  # occluded for too long; ended
    LEFT_VIEW = 'left_view'  # ended
    STREAM_ENDED = 'stream_ended'

    @property
    def followed(self) -> bool:
        """Return whether the target has not ended."""
        return self in (TargetState.TRACKED, TargetState.OCCLUDED)


@dataclass(frozen=True, eq=False, kw_only=True)
class Target:
    """
    A target as marked by a person.

    :param id: number of the target.
    :param frame: the frame in which it is marked, from 1.
    :param box_px: (4,), the initial box: x, y, w, h, px.
    :param angle_rad: angle of the box about its centre; 0 for an upright object, whose box never
        rotates.
    """

    id: int  # noqa: A003
    frame: int
    box_px: Array
    angle_rad: float = 0.0

    @property
    def upright(self) -> bool:
        """Return whether the box never rotates."""
        return self.angle_rad == 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class TargetEstimate:
    """
    A target in one frame.

    :param frame: number of the frame, from 1.
    :param id: the target's number.
    :param state: tracked or occluded.
    :param box_px: (4,), x, y, w, h, px, before rotation.
    :param angle_rad: angle of the box about its centre.
    :param distance_px: d of the environment state, px; infinite in inaccessible regions.
    :param distance_rate_px: change of d per frame of the video, px.
    :param similarity: Bhattacharyya coefficient with the reference, 0 to 1.
    :param velocity_px: (2,), velocity of the reference point, px per frame of the video.
    """

    frame: int
    id: int  # noqa: A003
    state: TargetState
    box_px: Array
    angle_rad: float
    distance_px: float
    distance_rate_px: float
    similarity: float
    velocity_px: Array

    @property
    def envelope_px(self) -> Array:
        """Return the upright box around the rotated one, px."""
        return envelope(self.box_px, self.angle_rad)


@dataclass(frozen=True, kw_only=True)
class TargetEnd:
    """
    How a target ended.

    :param id: number of the target.
    :param first_frame: the frame in which it was marked.
    :param last_frame: the last frame with a box.
    :param frames: number of frames with a box.
    :param state: lost, left_view or stream_ended.
    """

    id: int  # noqa: A003
    first_frame: int
    last_frame: int
    frames: int
    state: TargetState


def corners(box_px: Array, angle_rad: float) -> Array:
    """Return the four corners of a rotated box, (4, 2) px, clockwise from the upper left."""
    x, y, w, h = box_px
    half = np.array([[-w, -h], [w, -h], [w, h], [-w, h]]) / 2
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray([x + w / 2, y + h / 2] + half @ np.array([[c, s], [-s, c]]))


def envelope(box_px: Array, angle_rad: float) -> Array:
    """Return the smallest upright box (4,) around a rotated one, px."""
    if angle_rad == 0.0:
        return np.array(box_px, dtype=np.float64)
    points = corners(box_px, angle_rad)
    low, high = points.min(axis=0), points.max(axis=0)
    return np.concatenate([low, high - low])


def overlap(a_px: Array, b_px: Array) -> Array:
    """
    Return the intersection over union of upright boxes.

    :param a_px: (..., 4).
    :param b_px: (..., 4).
    :return: (...), 0 to 1.
    """
    low = np.maximum(a_px[..., :2], b_px[..., :2])
    high = np.minimum(a_px[..., :2] + a_px[..., 2:], b_px[..., :2] + b_px[..., 2:])
    common = np.prod(np.maximum(high - low, 0.0), axis=-1)
    both = np.prod(a_px[..., 2:], axis=-1) + np.prod(b_px[..., 2:], axis=-1) - common
    return np.asarray(common / np.maximum(both, 1e-12))
