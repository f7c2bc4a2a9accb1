# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
What of a window moves: how far out from its middle a vehicle reaches, whatever it looks like.

The road beside a vehicle looks as it did in an earlier pair.  So columns of a window that have
changed show a vehicle, or what it has uncovered since.  What goes with it has changed where it is
and where it came from, looks here as it did there, and does not lie on the road as a shadow does.
"""
from __future__ import annotations

from typing import Optional

import numpy as np

from .config import MotionConfig
from .front_sampler import FrontHypothesis, FrontSampler, GRID_M
from .patch_kernels import Floats
from .pyramid import Patches
from .temporal_match import Interval, Motion, OFF_SAMPLES
from ..vision.box_sums import window_sums

_BESIDE_M = 2.3  # the other lamp of a bus is so far from one of them
_SMOOTH = 3  # columns that are looked at together
_MORE = 2.0  # an explanation that leaves so many times less is the better one


def moving_outline(sampler: FrontSampler, x_m: float, s_m: float, most_m: float,
                   interval: Interval, noise: float, config: MotionConfig
                   ) -> Optional[tuple[float, float]]:
    """
    Return middle and half width of what has changed in a window and does not lie on the road, m.

    :param sampler: of a lane.
    :param x_m: middle of the window.
    :param s_m: arc length of its plane.
    :param most_m: greatest width; of what is wider, the part that has changed most.
    :param interval: the pair and an earlier one.
    :param noise: 1-sigma of a grey value.
    :param config: parameters.
    :return: None where there is nothing.
    """
    half = round(_BESIDE_M / GRID_M)
    place = np.array([s_m]), np.array([x_m]), half
    now, before = (sampler.left(*place, pair)[0] for pair in (interval.now, interval.before))
    road = sampler.right(*place, interval.now, np.zeros(1), lying=True)[0]
    change, allowed = _change(now, _as_bright(before, now), noise)
    lain, _ = _change(now, _as_bright(road, now), noise)
    has = (change > config.change_factor * allowed) & (lain > _MORE * allowed)
    width = min(round(most_m / GRID_M), len(has))
    first = int(np.argmax(window_sums(np.where(has, change - allowed, 0.0)[None], width)[0]))
    inside = np.flatnonzero(has[first:first + width])
    if not len(inside):
        return None
    left, right = first + int(inside[0]) - half, first + int(inside[-1]) - half
    return x_m + (left + right) / 2 * GRID_M, (right - left) / 2 * GRID_M


def going_width(sampler: FrontSampler, front: FrontHypothesis, motion: Motion,
                interval: Interval, noise: float, config: MotionConfig) -> float:
    """
    Return the width of all that goes with a front, and is no shadow of it, m.

    :param sampler: of its lane.
    :param front: in the pair.
    :param motion: of the front, from the earlier pair.
    :param interval: the pair and the earlier one.
    :param noise: 1-sigma of a grey value.
    :param config: parameters.
    """
    half = round(_BESIDE_M / GRID_M)
    s, x, ahead = (np.array([v]) for v in (front.s_m, front.x_m, front.ahead_m))
    core = round(front.half_m / GRID_M)
    middle = slice(half - core, half + core + 1)
    now, still = (sampler.left(s, x, half, pair)[0] for pair in (interval.now, interval.before))
    left, gone = (sampler.left(s - motion.gone_m, x + motion.aside_m, half, pair)[0]
                  for pair in (interval.now, interval.before))
    stands, lies = (sampler.right(s, x, half, interval.now, ahead, lying=lying)[0]
                    for lying in (False, True))
    changed, allowed = _change(now, _as_bright(still, now), noise)
    changed_there, allowed_there = _change(gone, _as_bright(left, gone), noise)
    left_over, standing, lain = (
        _change(now, _matched(other, now[:, middle], as_[:, middle]), noise)[0]
        for other, as_ in ((gone, gone), (stands, stands), (lies, stands)))
    goes = ((changed > config.change_factor * allowed) & (changed > _MORE * left_over)
            & (changed_there > config.change_factor * allowed_there)
            & (standing < _MORE * np.maximum(lain, allowed)))
    columns = np.flatnonzero(goes)
    return float(columns[-1] - columns[0] + 1) * GRID_M if len(columns) else 0.0


def _change(now: Patches, then: Patches, noise: float) -> tuple[Floats, Floats]:
    """Return the squares of the differences of columns, and what explains itself of them."""
    steep = np.square(np.gradient(now)).sum(axis=0)
    columns = np.square(now - then), 2 * noise ** 2 + OFF_SAMPLES ** 2 * steep
    change, allowed = (np.convolve(v.sum(axis=0), np.ones(_SMOOTH), 'same') for v in columns)
    return change, allowed


def _as_bright(other: Patches, now: Patches) -> Patches:
    """Return a window as bright as another one, most of which shows the same."""
    return np.asarray(other * (np.median(now) / max(float(np.median(other)), 1.0)))


def _matched(values: Patches, to: Patches, part: Patches) -> Patches:
    """Return grey values as they would be were a part of them as bright and rich as another."""
    gain = to.std() / max(float(part.std()), 1.0)
    return np.asarray((values - part.mean()) * gain + to.mean())
