# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Where a rig that has rotated sees what it saw before, and images as it would have taken them."""
from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .rig import StereoRig
from ..core.records import Array, StereoPair

_KNOT_PX = 16  # between exact points of a map; linear in between is good to 1e-3 px


def moved_px(rig: StereoRig, now: StereoRig, right: bool, uv_px: Array) -> Array:
    """
    Return where a view shows after a rotation what it showed at some pixels, far away.

    A rig turns about its left camera, which takes the right one along by less than a millimetre
    in a tenth of a degree: images that are moved this way are right at any distance to 0.1 px at
    20 m. Points in space, which :meth:`StereoRig.project` takes, are exact.

    :param rig: as it was.
    :param now: as it is.
    :param right: of the right view.
    :param uv_px: (..., 2) raw pixels; the result is too.
    """
    if right:
        rays = rig.right.rays(uv_px) @ rig.R @ now.R.T
        return now.right.distort(rays[..., :2] / rays[..., 2:])
    return now.left.project(rig.left.rays(uv_px))[0]


def steadied(pair: StereoPair, rig: StereoRig) -> StereoPair:
    """
    Return a pair as the rig would have taken it, had it not moved; the same where it has not.

    :param pair: with its motion.
    :param rig: as it was when it had not moved.
    """
    if pair.motion is None:
        return pair
    now = rig.as_taken(pair.motion)
    left, right = (remapped(image, rig, now, side)
                   for image, side in ((pair.left, False), (pair.right, True)))
    return replace(pair, left=left, right=right, motion=None)


def remapped(image: NDArray[Any], wanted: StereoRig, taken: StereoRig, right: bool
             ) -> NDArray[Any]:
    """
    Return an image as one rig would have taken it from that of another; edges are repeated.

    :param image: (H, W) raw.
    :param wanted: the rig that would have.
    :param taken: the rig that took it, rotated against the other.
    :param right: it is of the right view.
    """
    height, width = image.shape
    # cv2.resize puts the first knot of each axis half a step into the image.
    u, v = (np.arange(-1, size // _KNOT_PX + 2) * _KNOT_PX + (_KNOT_PX - 1) / 2
            for size in (width, height))
    knots = moved_px(wanted, taken, right, np.stack(np.meshgrid(u, v), axis=-1)).astype(np.float32)
    whole = cv2.resize(knots, (len(u) * _KNOT_PX, len(v) * _KNOT_PX),
                       interpolation=cv2.INTER_LINEAR)
    part = whole[_KNOT_PX:_KNOT_PX + height, _KNOT_PX:_KNOT_PX + width]
    return np.asarray(cv2.remap(
        image, np.ascontiguousarray(part), None, cv2.INTER_CUBIC,  # type: ignore[call-overload]
        borderMode=cv2.BORDER_REPLICATE))
