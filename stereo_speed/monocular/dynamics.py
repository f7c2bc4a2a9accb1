# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The adaptive dynamics (2010, Section IV.B, eq. 15-19): motion that follows the contours.

Everything here is deterministic: it gives the mean of eq. 19, to which the filter adds noise.
"""
from __future__ import annotations

import numpy as np

from .distance import DistanceField
from ..core.records import Array

_ITERATIONS = 3  # Newton iterations for the intersection of circle and contour
_LARGEST_STEP_RAD = 0.3  # largest Newton step, so that it stays near the intersection ahead
_LEAST_SLOPE = 0.2  # least slope of the distance along the circle for which a step is taken
_CERTAIN = 0.9  # gradient length above which the contour has full weight
_UNCERTAIN = 0.5  # gradient length below which the contour has no weight
_AHEAD = 0.8  # cosine of the heading change above which the contour is followed fully
_ASIDE = 0.5  # cosine of the heading change below which the contour is not followed


def certainty(gradient: Array) -> Array:
    """
    Return how well the contour is defined: 0 on a ridge of the field, 1 away from it.

    :param gradient: (N, 2), gradient of the field, or its orientation.
    """
    length = np.hypot(gradient[:, 0], gradient[:, 1])
    return np.asarray(np.clip((length - _UNCERTAIN) / (_CERTAIN - _UNCERTAIN), 0.0, 1.0))


def contour_velocity(field: DistanceField, point_px: Array, velocity_px: Array,
                     distance_rate_px: Array, frames: float) -> Array:
    """
    Return the velocity of the same magnitude that reaches the expected contour (eq. 15-16).

    The contour is that of ``d + d_rate * frames``; of its two intersections with the circle, the
    one ahead is taken. The result blends back to the given velocity where the field is too curved,
    where there is no contour (ridges), and where the heading would change sharply.

    :param point_px: (N, 2), points.
    :param velocity_px: (N, 2), px per frame.
    :param distance_rate_px: (N,), px per frame.
    :param frames: time to the next frame used, frames of the video.
    :return: (N, 2), px per frame.
    """
    speed = np.linalg.norm(velocity_px, axis=-1)
    radius = np.maximum(speed * frames, 1e-9)
    level, gradient = field.level_and_gradient(point_px)
    wanted = level + distance_rate_px * frames
    # initial guess: exact where the contours are straight and parallel
    side = np.sign(gradient[:, 0] * velocity_px[:, 1] - gradient[:, 1] * velocity_px[:, 0])
    across = np.arccos(np.clip(distance_rate_px * frames / radius, -1.0, 1.0))
    bearing = np.arctan2(gradient[:, 1], gradient[:, 0]) + np.where(side < 0, -across, across)
    for _ in range(_ITERATIONS):
        ahead = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        there = point_px + radius[:, None] * ahead
        level, slope = field.level_and_gradient(there)
        # derivative of d along the circle, per radian
        derivative = radius * (slope[:, 1] * ahead[:, 0] - slope[:, 0] * ahead[:, 1])
        steep = np.abs(derivative) > _LEAST_SLOPE * radius
        step = np.where(steep, (wanted - level) / np.where(steep, derivative, 1.0), 0.0)
        bearing = bearing + np.clip(step, -_LARGEST_STEP_RAD, _LARGEST_STEP_RAD)
    along = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    heading = velocity_px / np.maximum(speed, 1e-9)[:, None]
    trust = certainty(gradient) * np.clip(
        (np.sum(along * heading, axis=-1) - _ASIDE) / (_AHEAD - _ASIDE), 0.0, 1.0)
    mixed = trust[:, None] * along + (1.0 - trust[:, None]) * heading
    length = np.linalg.norm(mixed, axis=-1, keepdims=True)
    return np.asarray(speed[:, None] * mixed / np.maximum(length, 1e-9))


def contour_rotation(field: DistanceField, from_px: Array, to_px: Array) -> Array:
    """
    Return the rotation of the contour's tangent between points (eq. 17-18).

    :param from_px: (N, 2).
    :param to_px: (N, 2).
    :return: (N,) rad, in [-pi/2, pi/2], because a tangent has no direction; reduced where the
        contours around the point are not parallel.
    """
    before, after = field.orientation(from_px), field.orientation(to_px)
    doubled = np.arctan2(after[:, 1], after[:, 0]) - np.arctan2(before[:, 1], before[:, 0])
    trust = np.minimum(certainty(before), certainty(after))
    return np.asarray(trust * np.arctan2(np.sin(doubled), np.cos(doubled)) / 2.0)
