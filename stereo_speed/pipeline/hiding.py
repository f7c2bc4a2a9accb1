# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Decides which tracked fronts other vehicles hide.

A front that is hidden from its first pair on has no better pairs to compare with: one half of it
shows the vehicle and the other half what hides that, and its place and speed are those of neither.
But where the other vehicle is tracked too, geometry tells that it is in the way.
"""
from __future__ import annotations

from typing import Iterable

import cv2
import numpy as np

from .track import holds, place_m, Track
from ..core.records import Array, TrackUpdate
from ..geometry.rig import StereoRig

_LEAST_HEIGHT_M = 0.6  # of any vehicle from the lower edge of its front, a bumper or lamp, up
_HIDDEN_SHARE = 0.1  # share of a front from which it counts as hidden


def is_hidden(front: TrackUpdate, tracks: Iterable[Track], rig: StereoRig, apart_m: float
              ) -> bool:
    """
    Return whether a nearer vehicle is in the way of a front, in either view.

    :param front: the newest update of a track.
    :param tracks: all tracks; those may hide it that have been confirmed, are not doubted and saw
        their vehicle in their last pair.
    :param rig: the cameras as they stood when the pair of the update was taken.
    :param apart_m: how much nearer another front is, at least, that is not the same vehicle's, m.
    """
    range_m = float(np.linalg.norm(front.position_m))
    for track in tracks:
        last = track.last
        if last is None or last.track == front.track or not holds(last) \
                or not track.confirmed or track.doubted:
            continue
        at_m = place_m(last, front.stamp_ns)
        if np.linalg.norm(at_m) < range_m - apart_m and _covers(
                _silhouette_m(last, at_m, rig), front, rig):
            return True
    return False


def _silhouette_m(last: TrackUpdate, at_m: Array, rig: StereoRig) -> Array:
    """
    Return what a vehicle covers at least: the middle of its front, then four corners (5, 3).

    :param last: its last update, which shows the size of its front.
    :param at_m: (3,) the middle of its front now.
    :return: points in the left optical frame, m.
    """
    quad = last.quad_left_px
    width_m, height_m = rig.left.metres_per_px(float(last.position_m[2])) * np.linalg.norm(
        quad[[2, 0]] - quad[3], axis=1)
    across, up = last.axes[:, 1] * width_m / 2, last.axes[:, 2]
    low = at_m - up * height_m / 2
    high = low + up * max(height_m, _LEAST_HEIGHT_M)
    return np.stack([at_m, high - across, high + across, low + across, low - across])


def _covers(silhouette_m: Array, front: TrackUpdate, rig: StereoRig) -> bool:
    """
    Return whether a silhouette covers more than a margin of a front in either view.

    A vehicle whose own front is out of a view covers nothing there.

    :param silhouette_m: (5, 3) as of :func:`_silhouette_m`.
    """
    left, right, in_left, in_right = rig.project(silhouette_m)
    for other_px, seen, own_px in ((left, in_left, front.quad_left_px),
                                   (right, in_right, front.quad_right_px)):
        if not seen[0] or not np.isfinite(other_px).all():
            continue
        own = own_px.astype(np.float32)
        shared_px, _ = cv2.intersectConvexConvex(other_px[1:].astype(np.float32), own)
        if shared_px > _HIDDEN_SHARE * cv2.contourArea(own):
            return True
    return False
