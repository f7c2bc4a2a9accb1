# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Finds a front in an earlier pair, to decide whether it has moved along its lane."""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Optional

import numpy as np

from .config import MotionConfig
from .front_sampler import FrontHypothesis, FrontSampler, GRID_M
from .patch_kernels import plain_correlate as correlate
from .patches import slide
from .pyramid import PairPyramids
from ..core.records import Array

_MOST_STEPS = 240  # greatest number of trial places along the lane
_FINE_STEPS = 7  # number of trial places about the best of them
_NEAR_STEPS = 15  # number of trial places where the distance is known approximately
_NEAR_SHARE = 0.2  # their reach either way, as a share of that distance
_STEP_PX = 1.0  # spacing of trial places
_STRIDE = 2  # step of samples in the first search
_SURE_HALF_M = 0.6  # half width of the middle of a front, which must not change
OFF_SAMPLES = 0.5  # possible displacement of two samplings of a front, in samples


@dataclass(frozen=True, eq=False)
class Interval:
    """
    A pair and an earlier one.

    :param now: the pair.
    :param before: the earlier pair.
    """

    now: PairPyramids
    before: PairPyramids

    @property
    def seconds(self) -> float:
        """Return the time from the earlier left view to the later, s; negative if swapped."""
        return self.before.age_s(self.now.pair.stamp_ns)


@dataclass(frozen=True)
class Travel:
    """
    The best match of a front in an earlier pair.

    :param gone_m: distance back along the lane, m.
    :param aside_m: distance to the left of its present place, m.
    :param ncc: correlation of the front with the image there.
    """

    gone_m: float
    aside_m: float
    ncc: float


@dataclass(frozen=True)
class Motion:
    """
    The motion of a front since an earlier pair.

    :param speed_mps: speed along the lane, m/s.
    :param gone_m: distance travelled along the lane, m.
    :param aside_m: how far to the left of its present place it was, m.
    :param ncc: correlation with the earlier image at its place then.
    :param still_ncc: correlation with the earlier image at its present place.
    :param moved_px: distance moved in the left view, px.
    """

    speed_mps: float
    gone_m: float
    aside_m: float
    ncc: float
    still_ncc: float
    moved_px: float


def find_motion(sampler: FrontSampler, front: FrontHypothesis, interval: Interval,
                config: MotionConfig) -> Motion:
    """
    Find where a front was in an earlier pair.

    :param sampler: sampler of its lane.
    :param front: the front in the pair.
    :param interval: the pair and the earlier one.
    :param config: parameters.
    """
    travel = find_travel(sampler, front, interval, config)
    place = np.array([front.s_m]), np.array([front.x_m]), round(front.half_m / GRID_M)
    mine, then = (sampler.left(*place, pair) for pair in (interval.now, interval.before))
    still = correlate(mine - mine.mean(), then - then.mean())
    here, there = (sampler.geometry.project(
        np.array([front.s_m - d]), np.array([front.x_m + a]), sampler.heights_m[:1])[0][0, 0, 0]
        for d, a in ((0.0, 0.0), (travel.gone_m, travel.aside_m)))
    return Motion(travel.gone_m / interval.seconds, travel.gone_m, travel.aside_m, travel.ncc,
                  float(still[0]), float(np.linalg.norm(here - there)))


def find_travel(sampler: FrontSampler, front: FrontHypothesis, interval: Interval,
                config: MotionConfig, expected_m: Optional[float] = None) -> Travel:
    """
    Find the best match of a front in the left view of an earlier pair.

    :param sampler: sampler of its lane.
    :param front: the front in the pair.
    :param interval: the pair and the earlier one.
    :param config: parameters.
    :param expected_m: approximate distance back along the lane, m; None where it is not known.
    """
    rates = sampler.geometry.rates(np.array([front.s_m]))
    scale = max(1.0, float(rates.px_per_m[0]) * GRID_M)  # coarser pixels are used up close
    step = scale * _STEP_PX / max(float(rates.px_per_m[0] * abs(rates.climb[0])), 1e-3)
    seconds = abs(interval.seconds)
    far = config.greatest_speed_mps * seconds
    step = max(step, far / _MOST_STEPS)
    reach = _STRIDE * math.ceil(
        (config.aside_mps * seconds + config.aside_m) / GRID_M / _STRIDE)
    gone_m = np.arange(0.0, far + step, step)
    if expected_m is not None:
        gone_m = expected_m + max(_NEAR_SHARE * abs(expected_m), step) * np.linspace(
            -1, 1, _NEAR_STEPS)
        step = float(gone_m[1] - gone_m[0])
    first = _best(sampler, front, interval, gone_m, Travel(0.0, 0.0, 0.0), reach, _STRIDE)
    fine_m = first.gone_m + step * np.linspace(-1, 1, _FINE_STEPS)
    return _best(sampler, front, interval, fine_m, first, 2 * _STRIDE, 1)


def moved(motion: Motion, config: MotionConfig) -> bool:
    """Return whether a motion is that of a vehicle travelling along its lane."""
    return (motion.ncc >= config.least_ncc and motion.moved_px >= config.least_px
            and config.least_speed_mps <= motion.speed_mps <= config.greatest_speed_mps
            and motion.ncc > motion.still_ncc + config.still_margin)


def moving_half(sampler: FrontSampler, front: FrontHypothesis, motion: Motion,
                interval: Interval, noise: float, config: MotionConfig) -> float:
    """
    Return how far from its middle outwards a front looks the same as in the earlier pair.

    Beyond its edges is background, which changes.  If the middle of a front changes, it was partly
    occluded, by a pole or another vehicle, or the match is wrong, so it gives neither place nor
    speed.

    :param sampler: sampler of its lane.
    :param front: the front in the pair.
    :param motion: its motion from the earlier pair.
    :param interval: the pair and the earlier one.
    :param noise: 1-sigma of a grey value.
    :param config: parameters.
    :return: m, at most the half width of the front; 0 where its middle changes.
    """
    half = round(front.half_m / GRID_M)
    sure = min(round(_SURE_HALF_M / GRID_M), half)
    middle = slice(half - sure, half + sure + 1)
    change, allowed = np.zeros(2 * half + 1), np.zeros(2 * half + 1)
    then = replace(front, s_m=front.s_m - motion.gone_m, x_m=front.x_m + motion.aside_m,
                   ahead_m=interval.before.pair.right_lag_s * motion.speed_mps)
    for a, b in zip(_views(sampler, front, half, interval.now),
                    _views(sampler, then, half, interval.before)):
        gain = a[:, middle].std() / max(float(b[:, middle].std()), 1.0)
        b = (b - b[:, middle].mean()) * gain + a[:, middle].mean()
        steep = np.square(np.gradient(a)).sum(axis=0)
        change += np.square(a - b).sum(axis=0)
        allowed += (2 * noise ** 2 + OFF_SAMPLES ** 2 * steep).sum(axis=0)
    change, allowed = (np.convolve(v, np.ones(3), 'same') for v in (change, allowed))
    bad = change > config.change_factor * allowed
    if bad[middle].mean() > config.occluded_share:
        return 0.0
    bad = (bad | bad[::-1])[half + sure:]
    return (sure + int(np.argmax(bad)) - 1 if bad.any() else half) * GRID_M


def _views(sampler: FrontSampler, front: FrontHypothesis, half: int, pair: PairPyramids
           ) -> tuple[Array, Array]:
    """Return the windows (rows, 2 half + 1) of a front in both views."""
    s, x, ahead = (np.array([v]) for v in (front.s_m, front.x_m, front.ahead_m))
    return sampler.left(s, x, half, pair)[0], sampler.right(s, x, half, pair, ahead)[0]


def _best(sampler: FrontSampler, front: FrontHypothesis, interval: Interval, gone_m: Array,
          about: Travel, reach: int, stride: int) -> Travel:
    """
    Return the best match of a front in the earlier pair.

    :param gone_m: (n,) trial distances back along the lane, m.
    :param about: match whose ``aside_m`` is the centre of the search across the lane.
    :param reach: reach of that search either way, in samples.
    :param stride: step of the samples.
    """
    s, x = np.array([front.s_m]), np.array([front.x_m])
    half = stride * round(front.half_m / GRID_M / stride)
    mine = sampler.left(s, x, half, interval.now, stride)[0]
    there = sampler.left(front.s_m - gone_m, np.full(len(gone_m), front.x_m + about.aside_m),
                         half + reach, interval.before, stride)
    scores = slide(mine, there)
    i, j = np.unravel_index(int(np.argmax(scores)), scores.shape)
    return Travel(float(gone_m[i]), about.aside_m + (int(j) * stride - reach) * GRID_M,
                  float(scores[i, j]))
