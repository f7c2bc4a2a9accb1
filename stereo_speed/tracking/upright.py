# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Whether what a track follows stands on the road or lies on it.

The edge of a shadow goes along with its vehicle, and where it crosses a line of the road its
corner looks the same from pair to pair.  But it lies: through the front one sees the road farther
away, and the right view shows that elsewhere than what stands there.
"""
from __future__ import annotations

import math
from typing import Optional

import cv2
import numpy as np

from ..core.records import Array, StereoPair, TrackUpdate
from ..geometry.rig import StereoRig
from ..road.lanes import LanePath
from ..vision.ncc import ncc

_ACROSS, _UP = 24, 10  # samples of a front
_INNER = 0.9  # share of its width and height that is looked at
_ROAD_OFF_M = (-0.05, 0.0, 0.05)  # the road may be so much higher than its path says
# Odds of 20 to 1 that it lies. A ratio of what is left over is that of the probabilities of two
# samples, and a front has more, so the odds are no less. Without a margin, what views that tell
# nothing show would often be taken to lie: the best of three roads meets one standing plane.
_LIES = -math.log(20)
_LEAST_DOUBT = 0.005  # no two views agree better than this, whatever their correlation


class Upright:
    """
    Gathers what both views of the pairs of one track say.

    Either way the right view differs from the left one by noise of an unknown size, gain and
    level: the logarithm of the ratio of what is left over is in proportion to the evidence.

    :param rig: the cameras.
    :param lane: the lane whose path its places are told by.

    ``evidence`` is that it stands; below 0 it may lie.
    """

    def __init__(self, rig: StereoRig, lane: LanePath) -> None:
        self.rig, self.lane = rig, lane
        self.evidence = 0.0
        across, up = np.meshgrid(*(0.5 + _INNER * np.linspace(-0.5, 0.5, count)
                                   for count in (_ACROSS, _UP)))
        shares = across.ravel()[:, None], up.ravel()[:, None]
        self._corners: Array = np.concatenate([  # of each sample by the corners, clockwise
            (1 - shares[0]) * (1 - shares[1]), shares[0] * (1 - shares[1]),
            shares[0] * shares[1], (1 - shares[0]) * shares[1]], axis=1)

    @property
    def lies(self) -> bool:
        """Return whether it lies on the road rather than stands on it, by odds of 20 to 1."""
        return self.evidence < _LIES

    def take(self, pair: StereoPair, update: TrackUpdate) -> None:
        """Take in a pair, and where the front is in it."""
        rig, forward = self.rig.as_taken(pair.motion), update.axes[:, 0]
        rays = rig.left.rays(update.quad_left_px)
        depth = float(update.position_m @ forward) / (rays @ forward)
        standing = self._corners @ (rays * depth[:, None])
        gone = forward * update.speed_mps * pair.right_lag_s
        left = _sampled(pair.left, rig.left.project(standing)[0])
        lying = [self._on_road(standing, update.s_m, off_m) for off_m in _ROAD_OFF_M]
        misfits = [self._misfit(rig, pair, left, None if points is None else points + gone)
                   for points in (standing, *lying)]
        if left is not None and None not in misfits:
            stands, *lies = (float(v) for v in misfits if v is not None)
            self.evidence += math.log(min(lies) / stands)

    def _on_road(self, points: Array, s_m: float, off_m: float) -> Optional[Array]:
        """Return where (n, 3) the left camera's rays through points meet the road; None if not."""
        up = self.lane.path.frame(np.array(s_m))[:, 2]
        with np.errstate(divide='ignore'):  # along the road there is none
            share = (float(self.lane.path.position(np.array(s_m)) @ up) + off_m) / (points @ up)
        return points * share[:, None] if (np.isfinite(share) & (share > 0)).all() else None

    @staticmethod
    def _misfit(rig: StereoRig, pair: StereoPair, left: Optional[Array],
                points: Optional[Array]) -> Optional[float]:
        """Return how much of the left view the right one lacks at points (n, 3)."""
        if left is None or points is None:
            return None
        right = _sampled(pair.right, rig.right.project(rig.to_right(points))[0])
        return None if right is None else 1 - float(ncc(left, right)) + _LEAST_DOUBT


def _sampled(image: Array, uv_px: Array) -> Optional[Array]:
    """Return the grey values (n,) at pixels (n, 2); None if some are outside the image."""
    height, width = image.shape
    if not (np.isfinite(uv_px).all() and (uv_px >= 0).all()
            and (uv_px <= np.array([width, height]) - 1.0).all()):
        return None
    (x0, y0), (x1, y1) = np.floor(uv_px.min(axis=0)).astype(int), \
        np.ceil(uv_px.max(axis=0)).astype(int) + 1
    at = (uv_px - np.array([x0, y0])).astype(np.float32)
    found = cv2.remap(np.asarray(image[y0:y1, x0:x1], np.float32), at[None, :, 0], at[None, :, 1],
                      cv2.INTER_LINEAR)
    return np.asarray(found[0], np.float64)
