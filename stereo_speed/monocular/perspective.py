# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The row of the horizon, estimated from the initial boxes.

Over level ground and without roll, the image height of an upright object is its height as a share
of the camera's, times the number of rows from the horizon to its foot. So its size follows from
the row of its foot instead of being free: ``h = ratio * (foot - horizon)``.
"""
from __future__ import annotations

from typing import Sequence

import numpy as np

from .boxes import Target
from .config import MonocularConfig
from ..core.records import Array

_STEPS = 400  # rows of the grid, spaced by a few per cent of the distance to the horizon
_NEAREST = 0.5  # least height of the horizon above the highest foot, in smallest box heights
_FARTHEST = 100.0  # largest height of the horizon above that foot, in largest box heights
_LEAST_PX = 1e-3  # least distance from horizon to foot; avoids a division by 0
_MOST_GROWTH = 2.0  # largest factor of growth or shrinkage between frames


def draw_horizons(targets: Sequence[Target], config: MonocularConfig, count: int,
                  rng: np.random.Generator) -> Array:
    """Draw rows (count,) of the horizon from its posterior given the initial boxes, px."""
    rows, weights = horizon_posterior(targets, config)
    return rng.choice(rows, count, p=weights)


def horizon_posterior(targets: Sequence[Target],
                      config: MonocularConfig) -> tuple[Array, Array]:
    """
    Return the posterior of the horizon's row on a grid.

    The log ratios of the targets agree within ``mark_height_spread``, and their mean is near the
    logarithm of ``mark_ratio``; so one box gives a rough estimate, and boxes near and far a sharp
    one.

    :param targets: upright targets, as marked.
    :return: rows (M,) px, and their probabilities (M,).
    """
    boxes = np.array([t.box_px for t in targets])
    foot, height = boxes[:, 1] + boxes[:, 3], boxes[:, 3]
    above = np.geomspace(_NEAREST * height.min(), _FARTHEST * height.max(), _STEPS)
    rows = foot.min() - above
    log_ratio = np.log(height[:, None] / (foot[:, None] - rows[None]))
    rest = log_ratio - np.log(config.mark_ratio)
    # the common mean is marginalised
    count = len(targets)
    covariance = config.mark_height_spread ** 2 * np.eye(count) + config.mark_ratio_spread ** 2
    log_p = -0.5 * np.einsum('im,ij,jm->m', rest, np.linalg.inv(covariance), rest)
    p = np.exp(log_p - log_p.max())
    return rows, p / p.sum()


def perspective_growth(foot_before_px: Array, foot_px: Array, horizon_px: Array) -> Array:
    """
    Return the factor (N,) by which a size grows as the foot moves between rows.

    It is bounded to at most twofold growth or shrinkage between frames.
    """
    before = np.maximum(foot_before_px - horizon_px, _LEAST_PX)
    return np.clip((foot_px - horizon_px) / before, 1.0 / _MOST_GROWTH, _MOST_GROWTH)
