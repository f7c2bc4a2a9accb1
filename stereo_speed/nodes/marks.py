# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The message that marks a target live: one ``geometry_msgs/PolygonStamped`` on ``mark``.

Its header has the stamp of the image in which the target is marked. Its points are in pixels of
the raw image, with z unused: two opposite corners of an upright box, or the four corners of a
rotated one, clockwise from the upper left corner of the unrotated box.
"""
from __future__ import annotations

import math

from geometry_msgs.msg import PolygonStamped
import numpy as np

from ..core.errors import InputError
from ..monocular.boxes import corners, Target

MARK_TOPIC = 'mark'
_SQUARE_PX = 2.0  # tolerance of the corners of a rectangle that is marked by hand


def target_from_message(msg: PolygonStamped, number: int, frame: int) -> Target:
    """
    Return the target that is marked.

    :param msg: the mark.
    :param number: number of the new target.
    :param frame: number of the frame with the stamp of the message.
    :raises InputError: the points make no box.
    """
    points = np.array([[p.x, p.y] for p in msg.polygon.points], float).reshape(-1, 2)
    if len(points) not in (2, 4) or not np.isfinite(points).all():
        raise InputError(MARK_TOPIC, 'polygon', points.tolist(),
                         'two opposite corners of an upright box, or four corners, in px')
    if len(points) == 2:
        low, high = points.min(axis=0), points.max(axis=0)
        box, angle = np.concatenate([low, high - low]), 0.0
    else:
        across = points[1] - points[0]
        size = np.array([math.hypot(*across), math.hypot(*(points[3] - points[0]))])
        box = np.concatenate([points.mean(axis=0) - size / 2, size])
        angle = math.atan2(across[1], across[0])
        if np.abs(corners(box, angle) - points).max() > _SQUARE_PX:
            raise InputError(MARK_TOPIC, 'polygon', points.tolist(),
                             'the corners of a rectangle, clockwise from the upper left one')
    if min(box[2:]) <= 0:
        raise InputError(MARK_TOPIC, 'polygon', points.tolist(), 'a width and height above 0 px')
    return Target(id=number, frame=frame, box_px=box, angle_rad=angle)
