# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Whether a face came along its lane: where it was in an earlier pair."""
from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from .config import DetectorConfig
from .front_refiner import FrontHypothesis, FrontRefiner, GRID_M
from .patches import correlate, slide
from .pyramid import PairPyramids
from ..core.records import Array

_ASIDE_MPS = 3.5  # fastest change of lanes
_ASIDE_M = 0.15  # and what the path may be wrong
_MOST_STEPS = 240
_FINE_STEPS = 7
_STEP_PX = 1.0  # between the places tried
_STRIDE = 2
_SURE_HALF_M = 0.6
_OFF_SAMPLES = 0.5  # by which two samplings of a face may be displaced
_TIMES_ALLOWED = 3.0
_HIDDEN_SHARE = 0.2  # of the middle of a face may change
_LEAST_PX = 2.0  # what moved less in the image did not move


@dataclass(frozen=True)
class Motion:
    """
    Where a face was.

    :param speed_mps: along the lane.
    :param gone_m: how far back along the lane it was.
    :param aside_m: and how far to the left of where it is now.
    :param ncc: correlation with the face as it was there.
    :param still_ncc: correlation with what was then where the face is now.
    :param moved_px: how far it moved in the left view.
    """

    speed_mps: float
    gone_m: float
    aside_m: float
    ncc: float
    still_ncc: float
    moved_px: float


def find_motion(finder: FrontRefiner, face: FrontHypothesis, now: PairPyramids, before: PairPyramids,
                config: DetectorConfig) -> Motion:
    """
    Find where a face was in an earlier pair.

    :param finder: of its lane.
    :param face: in the pair.
    :param now: the pair.
    :param before: the earlier pair.
    :param config: parameters.
    """
    dt = (now.stamp_ns - before.stamp_ns) * 1e-9
    s, x = np.array([face.s_m]), np.array([face.x_m])
    rates = finder.geometry.rates(s)
    scale = max(1.0, float(rates.px_per_m[0]) * GRID_M)  # coarser pixels are used up close
    step = scale * _STEP_PX / max(float(rates.px_per_m[0] * abs(rates.climb[0])), 1e-3)
    far = config.greatest_speed_mps * dt
    step = max(step, far / _MOST_STEPS)
    reach = _STRIDE * math.ceil((_ASIDE_MPS * dt + _ASIDE_M) / GRID_M / _STRIDE)
    gone, aside, _ = _best(finder, face, (now, before), np.arange(0.0, far + step, step),
                           (0.0, reach), _STRIDE)
    fine = gone + step * np.linspace(-1, 1, _FINE_STEPS)
    gone, aside, ncc = _best(finder, face, (now, before), fine, (aside, 2 * _STRIDE), 1)
    half = round(face.half_m / GRID_M)
    mine, then = (finder.windows(s, x, half, v.left, False) for v in (now, before))
    still = correlate(mine - mine.mean(), then - then.mean())
    here, there = (finder.geometry.project(
        np.array([face.s_m - d]), np.array([face.x_m + a]), finder.heights_m[:1])[0][0, 0, 0]
        for d, a in ((0.0, 0.0), (gone, aside)))
    return Motion(gone / dt, gone, aside, ncc, float(still[0]),
                  float(np.linalg.norm(here - there)))


def moved(motion: Motion, config: DetectorConfig) -> bool:
    """Say whether a motion is that of a vehicle along its lane."""
    return (motion.ncc >= config.least_motion_ncc and motion.moved_px >= _LEAST_PX
            and config.least_speed_mps <= motion.speed_mps <= config.greatest_speed_mps
            and motion.ncc > motion.still_ncc + 0.05)


def moving_half(finder: FrontRefiner, face: FrontHypothesis, motion: Motion, now: PairPyramids,
                before: PairPyramids, noise: float) -> float:
    """
    Find how much of a face, from its axis outwards, looks as it did where it came from.

    What is beyond its edges lies deeper and changes.  A face whose middle changes was hidden in
    part, by a pole or another vehicle, or is not what was there: it tells neither place nor speed.

    :param finder: of its lane.
    :param face: in the pair.
    :param motion: from the earlier pair.
    :param now: the pair.
    :param before: the earlier pair.
    :param noise: 1-sigma of a grey value.
    :return: m, at most the half width of the face; 0 where its middle changes.
    """
    half = round(face.half_m / GRID_M)
    sure = min(round(_SURE_HALF_M / GRID_M), half)
    middle = slice(half - sure, half + sure + 1)
    change, allowed = np.zeros(2 * half + 1), np.zeros(2 * half + 1)
    here = np.array([face.s_m]), np.array([face.x_m])
    there = here[0] - motion.gone_m, here[1] + motion.aside_m
    for view, earlier, right in ((now.left, before.left, False), (now.right, before.right, True)):
        a = finder.windows(*here, half, view, right)[0]
        b = finder.windows(*there, half, earlier, right)[0]
        gain = a[:, middle].std() / max(float(b[:, middle].std()), 1.0)
        b = (b - b[:, middle].mean()) * gain + a[:, middle].mean()
        steep = np.square(np.gradient(a)).sum(axis=0)
        change += np.square(a - b).sum(axis=0)
        allowed += (2 * noise ** 2 + _OFF_SAMPLES ** 2 * steep).sum(axis=0)
    change, allowed = (np.convolve(v, np.ones(3), 'same') for v in (change, allowed))
    bad = change > _TIMES_ALLOWED * allowed
    if bad[middle].mean() > _HIDDEN_SHARE:
        return 0.0
    bad = (bad | bad[::-1])[half + sure:]
    return (sure + int(np.argmax(bad)) - 1 if bad.any() else half) * GRID_M


def _best(finder: FrontRefiner, face: FrontHypothesis, views: tuple[PairPyramids, PairPyramids], gone_m: Array,
          aside: tuple[float, int], stride: int) -> tuple[float, float, float]:
    """
    Find where the face fits best in the earlier pair.

    :param gone_m: (n,) metres back along the lane to try.
    :param aside: metres to the left of where it is now, and samples either way to try.
    :param stride: of the samples.
    :return: metres back, metres to the left, correlation.
    """
    s, x = np.array([face.s_m]), np.array([face.x_m])
    half = stride * round(face.half_m / GRID_M / stride)
    mine = finder.windows(s, x, half, views[0].left, False, stride)[0]
    there = finder.windows(face.s_m - gone_m, np.full(len(gone_m), face.x_m + aside[0]),
                           half + aside[1], views[1].left, False, stride)
    scores = slide(mine, there)
    i, j = np.unravel_index(int(np.argmax(scores)), scores.shape)
    return (float(gone_m[i]), aside[0] + (int(j) * stride - aside[1]) * GRID_M,
            float(scores[i, j]))
