# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Corners on a vehicle, tracked from pair to pair and matched between the views.

The caller gives the region of the vehicle in each view.  It serves as a mask for the corners and
as the start of the search.  The corners are then measured by optical flow with a forward-backward
check (Z. Kalal, K. Mikolajczyk, J. Matas, "Forward-backward error", ICPR 2010).  A region that
moves at a wrong speed would leave its vehicle; from the first pair on, the common motion of the
corners corrects it.
"""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, Optional

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.records import Array, StereoPair
from ..core.tracker_config import SecondConfig
from ..vision.grey import to_eight_bits

Grey = NDArray[np.uint8]
Flags = NDArray[np.bool_]

_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)  # most steps; accuracy, px
_LEVELS = 2  # pyramid levels, as regions are known to some pixels
_MARGIN_PX = 16  # margin around a region, for the windows of corners at its edges
_LEAST_REGION_PX = 8  # least size of a region that shows corners
_WINDOWS_ACROSS = 12.0  # width of a region in half windows
_LEAST_AGREEING = 3  # fewest corners that correct a region; fewer may be on the background
_APART = 0.8  # least distance of two corners, as a share of the window


@dataclass(frozen=True, eq=False)
class Sighting:
    """
    The corners of one pair.

    :param ids: (n,) ids of the corners; a corner keeps its id from pair to pair.
    :param left_px: (n, 2) places in the raw left view.
    :param right_px: (n, 2) places in the raw right view.
    :param crowding: mean number of windows that cover a place, 1 or more; it measures how far the
        errors of corners are correlated.
    """

    ids: NDArray[np.int64]
    left_px: Array
    right_px: Array
    crowding: float


@dataclass(frozen=True, eq=False)
class _FollowerState:
    """
    The state kept from the last pair.

    :param part: part of the left image around the region.
    :param origin: (2,) origin of that part in the image, px.
    :param box: (2, 2) least and greatest u, v of the region, px.
    :param ids: (n,) ids of the corners.
    :param left_px: (n, 2) their places.
    :param off_px: (2,) correction of the given regions by the corners, px.
    :param disparity_off_px: correction of the given disparities by the corners, px.
    """

    part: Grey
    origin: Array
    box: Array
    ids: NDArray[np.int64]
    left_px: Array
    off_px: Array
    disparity_off_px: float


class CornerFollower:
    """
    Tracks the corners of one vehicle; see the module's docstring.

    :param config: number and strength of corners, and limits of matches.
    """

    def __init__(self, config: SecondConfig) -> None:
        self.config = config
        self._last: Optional[_FollowerState] = None
        self._next_id = 0

    def take(self, pair: StereoPair, left_region: Array, right_region: Array
             ) -> Optional[Sighting]:
        """
        Return the corners of the next pair; None if a region is too small or not finite.

        :param left_region: (4, 2) outline of the vehicle in the raw left view, px.
        :param right_region: (4, 2) outline of the vehicle in the raw right view, px.
        """
        if not (_is_large_enough(left_region) and _is_large_enough(right_region)):
            return None
        given = _bounds(left_region)
        off, disparity_off = self._carried(given)
        part, origin = _part(to_eight_bits(pair.left), given + off)
        window = _window_px(float(given[1, 0] - given[0, 0]))
        ids, left_px, move = self._follow(part, origin, given + off, window)
        off = off + move
        region, box = left_region + off, given + off
        inside = _inside(left_px, region)
        fresh = self._corners(part, origin, region, left_px[inside], window)
        ids = np.concatenate([ids[inside], np.arange(self._next_id, self._next_id + len(fresh))])
        self._next_id += len(fresh)
        left_px = np.concatenate([left_px[inside], fresh])
        expected_px = right_region.mean(axis=0) - left_region.mean(axis=0) + [disparity_off, 0.0]
        shift = np.round(expected_px)
        right_part = _part_at(to_eight_bits(pair.right), origin + shift, part.shape)
        right_px = _match(part, right_part, left_px - origin, window,
                          self.config.most_round_trip_px) + origin + shift
        good = np.flatnonzero(np.isfinite(right_px).all(axis=1))
        disparity_off += float(_consensus_move(
            right_px[good] - left_px[good] - expected_px, window)[0])
        self._last = _FollowerState(part, origin, box, ids, left_px, off, disparity_off)
        area = float(np.prod(box[1] - box[0]))
        return Sighting(ids[good], left_px[good], right_px[good],
                        max(1.0, len(good) * window ** 2 / area))

    def _carried(self, given: Array) -> tuple[Array, float]:
        """
        Return the corrections of region and disparity, scaled from the last pair to this.

        :param given: (2, 2) least and greatest u, v of the given left region, px.
        """
        if self._last is None:
            return np.zeros(2), 0.0
        grown = (given[1] - given[0]) / (self._last.box[1] - self._last.box[0])
        return grown * self._last.off_px, float(grown[0]) * self._last.disparity_off_px

    def _follow(self, part: Grey, origin: Array, box: Array, window: int
                ) -> tuple[NDArray[np.int64], Array, Array]:
        """
        Return the ids and places of known corners in the next left view, and their common move.

        The move is relative to the change of the region, px.
        """
        last = self._last
        if last is None or not len(last.ids):
            return np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(2)
        scale = (box[1] - box[0]) / (last.box[1] - last.box[0])
        move = (box[0] - origin) - scale * (last.box[0] - last.origin)
        warped = np.asarray(cv2.warpAffine(
            last.part, np.column_stack([np.diag(scale), move]), part.shape[::-1],
            flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)
        start = (last.left_px - last.origin) * scale + move
        found_px = _match(warped, part, start, window, self.config.most_round_trip_px)
        found = np.flatnonzero(np.isfinite(found_px).all(axis=1))
        return (last.ids[found], found_px[found] + origin,
                _consensus_move(found_px[found] - start[found], window))

    def _corners(self, part: Grey, origin: Array, region: Array, known: Array, window: int
                 ) -> Array:
        """Return new corners in the region, (n, 2) px."""
        wanted = self.config.most_points - len(known)
        if wanted <= 0:
            return np.zeros((0, 2))
        apart = max(3.0, _APART * window)
        mask = np.zeros(part.shape, np.uint8)
        cv2.fillConvexPoly(mask, np.round(region - origin).astype(np.int32), 255)
        for u, v in known - origin:
            cv2.circle(mask, (round(float(u)), round(float(v))), round(apart), 0, -1)
        found = cv2.goodFeaturesToTrack(
            part, wanted, self.config.least_quality, apart, mask=mask, blockSize=5)
        if found is None:
            return np.zeros((0, 2))
        return np.asarray(found.reshape(-1, 2).astype(float) + origin)


def _bounds(region: Array) -> Array:
    """Return least and greatest u, v (2, 2) of a region (4, 2), px."""
    return np.stack([region.min(axis=0), region.max(axis=0)])


def _is_large_enough(region: Array) -> bool:
    """Return whether a region (4, 2) is finite and large enough to show corners."""
    low, high = _bounds(region)
    return bool(np.isfinite(region).all() and (high - low).min() >= _LEAST_REGION_PX)


def _consensus_move(moves_px: Array, window: int) -> Array:
    """Return the median (2,) of moves (n, 2); zeros unless more than half of them agree on it."""
    if len(moves_px) < _LEAST_AGREEING:
        return np.zeros(2)
    middle = np.asarray(np.median(moves_px, axis=0))
    near = np.abs(moves_px - middle).max(axis=1) < window / 2
    return middle if 2 * np.count_nonzero(near) > len(near) else np.zeros(2)


def _window_px(width_px: float) -> int:
    """Return the size of the window of the optical flow, odd, for the width of a region."""
    return 2 * int(np.clip(width_px / _WINDOWS_ACROSS, 4, 9)) + 1


def _part(image: Grey, box: Array) -> tuple[Grey, Array]:
    """Return the part of an image around a box (2, 2), and its origin (2,), px."""
    size = np.array(image.shape[::-1])
    low = np.clip(np.floor(box[0]) - _MARGIN_PX, 0, size - _LEAST_REGION_PX).astype(int)
    high = np.clip(np.ceil(box[1]) + _MARGIN_PX + 1, low + _LEAST_REGION_PX, size).astype(int)
    return np.ascontiguousarray(image[low[1]:high[1], low[0]:high[0]]), low.astype(float)


def _part_at(image: Grey, origin: Array, shape: tuple[int, ...]) -> Grey:
    """Return the part of an image with a given origin and shape; edges are repeated."""
    u = np.clip(np.arange(shape[1]) + int(origin[0]), 0, image.shape[1] - 1)
    v = np.clip(np.arange(shape[0]) + int(origin[1]), 0, image.shape[0] - 1)
    return np.ascontiguousarray(image[np.ix_(v, u)])


def _inside(uv: Array, region: Array) -> Flags:
    """Return which points (n, 2) lie in a region (4, 2)."""
    outline = np.ascontiguousarray(region, dtype=np.float32)[:, None]
    return np.array([cv2.pointPolygonTest(outline, (float(u), float(v)), False) >= 0
                     for u, v in uv], dtype=bool)


def _match(first: Grey, second: Grey, uv: Array, window: int, most_px: float) -> Array:
    """
    Return the places (n, 2) of points of one image in another, px; NaN if the match fails.

    :param uv: (n, 2) places in the first image, px, which are also the start in the second.
    :param window: size of the window, px.
    :param most_px: largest round-trip error of the forward-backward check, px.
    """
    if not len(uv):
        return np.zeros((0, 2))
    options: dict[str, Any] = {
        'winSize': (window, window), 'maxLevel': _LEVELS, 'criteria': _STOP,
        'flags': cv2.OPTFLOW_USE_INITIAL_FLOW}
    start = np.ascontiguousarray(uv, dtype=np.float32)[:, None]
    second = _with_contrast_of(second, first)
    matched, found, _ = cv2.calcOpticalFlowPyrLK(first, second, start, start.copy(), **options)
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(second, first, matched, start.copy(), **options)
    round_trip_px = np.linalg.norm((back - start)[:, 0], axis=1)
    good = (found[:, 0] == 1) & (found_back[:, 0] == 1) & (round_trip_px < most_px)
    return np.where(good[:, None], matched[:, 0].astype(float), math.nan)


def _with_contrast_of(image: Grey, model: Grey) -> Grey:
    """Return an image with the mean and contrast of another one, as exposures may differ."""
    mean, std = (float(v[0, 0]) for v in cv2.meanStdDev(image))
    wanted, wanted_std = (float(v[0, 0]) for v in cv2.meanStdDev(model))
    gain = wanted_std / max(std, 1.0)
    return np.asarray(cv2.convertScaleAbs(image, alpha=gain, beta=wanted - gain * mean), np.uint8)
