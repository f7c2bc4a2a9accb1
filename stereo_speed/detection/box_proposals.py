# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Turns a box in the left image into proposals on a lane.

A vehicle stands on the road, so the lower edge of its box gives its approximate place.  The box
may be a few pixels off, and may include the side of the vehicle.  So a few planes around that
place are proposed, each with the middle of the box.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .lane_geometry import LaneGeometry
from .plane_sweep import Proposal
from .protocol import ImageBox
from ..core.config import CheckedRecord, parameter
from ..core.records import Array

_PLANE_SHIFT_M = 0.08  # shift of the right view between planes, which refining can bridge
_MOST_PLANES = 4  # greatest number of planes either way; at range a pixel covers many metres
_MOST_HALF_M = 0.9  # half the width of a car; more of the box may be the side of the vehicle


@dataclass(frozen=True)
class BoxFitConfig(CheckedRecord):
    """Where a front must lie in the box that it was found by."""

    lower_edge_px: float = parameter(
        4.0, 0.0, 200.0, 'px', 'error of the lower edge of a box; the place on the road is '
        'searched for so far above and below that edge')
    margin_share: float = parameter(
        0.15, 0.0, 1.0, '', 'greatest distance by which a front may extend beyond its box, as a '
        'share of the width and height of the box')
    lower_share: float = parameter(
        0.7, 0.05, 1.0, '', 'lower share of a box in which the middle of its front must lie')
    side_share: float = parameter(
        0.7, 0.0, 1.0, '', 'greatest share of the width of a box that shows the side of the '
        'vehicle; the front must be at least as wide as the rest')


def box_proposals(geometry: LaneGeometry, box: ImageBox, reach_m: float, fit: BoxFitConfig
                  ) -> list[Proposal]:
    """
    Return proposals for the front of the vehicle in a box, the likeliest first.

    :param geometry: the lane.
    :param box: the box in the left image.
    :param reach_m: greatest distance of the middle of a vehicle from the path, m.
    :param fit: how a front must lie in its box.
    """
    across = box.left_px + box.width_px * np.array([0.0, 0.5, 1.0])
    low = box.top_px + box.height_px
    rows = low + fit.lower_edge_px * np.array([0.0, -1.0, 1.0])
    s_m = [geometry.on_road(np.array([across[1], row])) for row in rows]
    if not np.isfinite(s_m[0]):
        return []
    middle = float(s_m[0])
    ends = [s if np.isfinite(s) else middle for s in s_m]
    step_m = _PLANE_SHIFT_M / max(abs(float(geometry.rates(np.array([middle])).shift[0])), 1e-6)
    count = min(int(np.ceil(max(abs(s - middle) for s in ends) / step_m)), _MOST_PLANES)
    places = middle + step_m * np.array([0, *(sign * k for k in range(1, count + 1)
                                              for sign in (-1, 1))], dtype=np.float64)
    out = []
    for s in places[(places >= min(ends) - step_m) & (places <= max(ends) + step_m)]:
        x = geometry.across(float(s), np.stack([across, np.full(3, low)], axis=-1))
        half_m = min(0.5 * abs(float(x[2] - x[0])), _MOST_HALF_M)
        # The middle of the box may be that of front and side together.
        if np.isfinite(x).all() and abs(float(x[1])) < reach_m + half_m:
            out.append(Proposal(float(s), float(x[1]), half_m=half_m))
    return out


def fits_box(quad_px: Array, box: ImageBox, fit: BoxFitConfig) -> bool:
    """
    Return whether a front lies in a box as the front of the vehicle in it would.

    :param quad_px: (4, 2) corners of the front in the left image.
    """
    low, high = quad_px.min(axis=0), quad_px.max(axis=0)
    first = np.array([box.left_px, box.top_px])
    size = np.array([box.width_px, box.height_px])
    margin = fit.margin_share * size
    middle_px = (low[1] + high[1]) / 2
    return bool(
        (low >= first - margin).all() and (high <= first + size + margin).all()
        and middle_px >= box.top_px + (1 - fit.lower_share) * box.height_px
        and high[0] - low[0] >= (1 - fit.side_share) * box.width_px)
