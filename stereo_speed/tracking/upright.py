# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Decides whether a tracked front stands on the road or lies on it.

The edge of a shadow moves along with its vehicle, and where it crosses a line of the road its
corner looks the same from pair to pair.  But it lies on the road: where a front seems to be, the
left view shows the road behind it, whose disparity differs from that of a standing front.
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

_ACROSS, _UP = 24, 10  # numbers of samples of a front
_INNER = 0.9  # share of its width and height that is sampled
_ROAD_OFF_M = (-0.05, 0.0, 0.05)  # trial heights of the road against its path
# Odds of 20 to 1 that the front lies.  The ratio of residuals is the likelihood ratio for two
# independent samples; a front has more, so the odds are no less.  Without this margin,
# uninformative views would often count as lying, as the best of three roads is compared with one
# standing plane.
_LIES = -math.log(20)
_LEAST_DOUBT = 0.005  # added to 1 - NCC, as no two views agree better than this


class Upright:
    """
    Gathers the evidence of both views of the pairs of one track.

    Under both hypotheses the right view equals the left one up to gain, level and noise of unknown
    size, so the evidence is proportional to the logarithm of the ratio of their residuals.

    :param rig: the cameras.
    :param lane: the lane along whose path the places of the track are given.

    ``evidence`` is that for standing; below 0 the front may lie.
    """

    def __init__(self, rig: StereoRig, lane: LanePath) -> None:
        self.rig, self.lane = rig, lane
        self.evidence = 0.0
        across, up = np.meshgrid(*(0.5 + _INNER * np.linspace(-0.5, 0.5, count)
                                   for count in (_ACROSS, _UP)))
        shares = across.ravel()[:, None], up.ravel()[:, None]
        self._corners: Array = np.concatenate([  # weights of the corners in samples, clockwise
            (1 - shares[0]) * (1 - shares[1]), shares[0] * (1 - shares[1]),
            shares[0] * shares[1], (1 - shares[0]) * shares[1]], axis=1)

    @property
    def lies(self) -> bool:
        """Return whether the front lies on the road, by odds of 20 to 1."""
        return self.evidence < _LIES

    def take(self, pair: StereoPair, update: TrackUpdate) -> None:
        """Add the evidence of a pair, with the update of the track for it."""
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
        """Return where (n, 3) left rays through points meet the road; None if not all do."""
        up = self.lane.path.frame(np.array(s_m))[:, 2]
        with np.errstate(divide='ignore'):  # a ray parallel to the road does not meet it
            share = (float(self.lane.path.position(np.array(s_m)) @ up) + off_m) / (points @ up)
        return points * share[:, None] if (np.isfinite(share) & (share > 0)).all() else None

    @staticmethod
    def _misfit(rig: StereoRig, pair: StereoPair, left: Optional[Array],
                points: Optional[Array]) -> Optional[float]:
        """Return the residual, 1 - NCC, of the right view at points (n, 3); None if not seen."""
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
