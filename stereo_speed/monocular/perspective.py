# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Where the horizon lies, from the initial boxes.

Over level ground and without roll, the height of an upright object in the image is its height as
a share of the camera's, times the rows from the horizon down to its foot. One size that grows
with the foot's row thus takes the place of a free one: ``h = ratio * (foot - horizon)``.
"""
from __future__ import annotations

from typing import Sequence

import numpy as np

from .boxes import Target
from .config import MonocularConfig
from ..core.records import Array

_STEPS = 400  # of the grid of rows, a few per cent of the distance to the horizon each
_NEAREST = 0.5  # of the horizon above the highest foot, in heights of the smallest box
_FARTHEST = 100.0  # of the horizon above the highest foot, in heights of the largest box
_LEAST_PX = 1e-3  # from the horizon to the foot, so that no size is divided by 0
_MOST_GROWTH = 2.0  # of a size between frames, and of its shrinking


def draw_horizons(targets: Sequence[Target], config: MonocularConfig, count: int,
                  rng: np.random.Generator) -> Array:
    """Draw rows (count,) of the horizon from what the initial boxes say of it, px."""
    rows, weights = horizon_posterior(targets, config)
    return rng.choice(rows, count, p=weights)


def horizon_posterior(targets: Sequence[Target],
                      config: MonocularConfig) -> tuple[Array, Array]:
    """
    Return the posterior of the horizon's row on a grid.

    The logarithms of the targets' ratios are alike within ``mark_height_spread`` and their mean
    is near that of ``mark_ratio``; so one box gives a rough guess, and boxes far and near a
    sharp one.

    :param targets: upright ones, as marked.
    :return: rows (M,) px, and their probabilities (M,).
    """
    boxes = np.array([t.box_px for t in targets])
    foot, height = boxes[:, 1] + boxes[:, 3], boxes[:, 3]
    above = np.geomspace(_NEAREST * height.min(), _FARTHEST * height.max(), _STEPS)
    rows = foot.min() - above
    log_ratio = np.log(height[:, None] / (foot[:, None] - rows[None]))
    rest = log_ratio - np.log(config.mark_ratio)
    # the common mean is integrated out
    count = len(targets)
    covariance = config.mark_height_spread ** 2 * np.eye(count) + config.mark_ratio_spread ** 2
    log_p = -0.5 * np.einsum('im,ij,jm->m', rest, np.linalg.inv(covariance), rest)
    p = np.exp(log_p - log_p.max())
    return rows, p / p.sum()


def perspective_growth(foot_before_px: Array, foot_px: Array, horizon_px: Array) -> Array:
    """
    Return the factor (N,) by which a size grows as the foot moves from row to row.

    It is bounded: no target grows or shrinks more than twofold between frames.
    """
    before = np.maximum(foot_before_px - horizon_px, _LEAST_PX)
    return np.clip((foot_px - horizon_px) / before, 1.0 / _MOST_GROWTH, _MOST_GROWTH)
