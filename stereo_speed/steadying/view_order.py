# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Check whether the views are swapped: in front of the cameras, disparities are positive."""
from __future__ import annotations

from typing import Any, Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.records import StereoPair
from ..geometry.rig import StereoRig
from ..vision.grey import to_eight_bits

_FEATURES = 1500  # largest number of features per view
_OFF_PX = 2.5  # largest distance of a match from the epipolar line
_LEAST_PX = 2.0  # least disparity whose sign is significant
_FEWEST, _CLEAR_SHARE = 20, 0.75  # fewest matches, and share of them with one sign, for a decision


def views_crossed(rig: StereoRig, pair: StereoPair) -> Optional[bool]:
    """
    Return whether the views are swapped; None if the images do not tell.

    :param rig: the rig.
    :param pair: pair of raw images.
    """
    left_px, right_px = _matches(pair.left, pair.right)
    if len(left_px) < _FEWEST:
        return None
    left, right = rig.left.rays(left_px), rig.right.rays(right_px)
    lines = left @ rig.essential.T
    off = np.abs(np.sum(lines * right, axis=1)) / np.hypot(lines[:, 0], lines[:, 1])
    focal_px = float(rig.right.K[0, 0])
    # The rays to one point differ by the baseline divided by the depth.
    rotated, centre_m = right @ rig.R, -rig.R.T @ rig.t
    apart = left / left[:, 2:] - rotated / rotated[:, 2:]
    disparity_px = focal_px * (apart @ centre_m) / float(np.linalg.norm(centre_m))
    significant_px = disparity_px[(off * focal_px < _OFF_PX) & (np.abs(disparity_px) > _LEAST_PX)]
    if len(significant_px) < _FEWEST:
        return None
    share = float(np.mean(significant_px < 0))
    return None if 1 - _CLEAR_SHARE < share < _CLEAR_SHARE else share > 0.5


def _matches(left: NDArray[Any], right: NDArray[Any]
             ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the left and right pixels (n, 2) of features that are mutual best matches."""
    orb: Any = cv2.ORB.create(_FEATURES)
    found = [orb.detectAndCompute(to_eight_bits(image), None) for image in (left, right)]
    if any(descriptors is None for _, descriptors in found):
        return np.zeros((0, 2)), np.zeros((0, 2))
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(found[0][1], found[1][1])
    index = np.array([(m.queryIdx, m.trainIdx) for m in matches], dtype=int).reshape(-1, 2)
    points = [np.array([p.pt for p in keys], dtype=np.float64).reshape(-1, 2)
              for keys, _ in found]
    return points[0][index[:, 0]], points[1][index[:, 1]]
