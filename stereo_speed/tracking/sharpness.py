# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Which view is the sharper one, and by how much, as the front itself shows.

A camera out of focus shows a far front blurred by as much as its details are wide: the views then
differ most where they should tell most, and the edges of the front run into the background in one
of them.  Blurred by as much, the other view is like it.  Differences of blur are compared at one
and the same sum of both, so that noise is averaged away alike in all of them.

A lens blurs all pairs by as many pixels, so what they tell adds up.  The first tell the most:
nearer, lamps that clip differ more than the rest of the front.
"""
from __future__ import annotations

import math

import numpy as np

from ..core.config import NoiseConfig
from ..core.records import Array
from ..vision.ncc import ncc
from ..vision.subpixel import parabola_peak

_SHARES = np.linspace(-1.0, 1.0, 9)  # of the greatest difference of the squared blurs
_LEAST_LACK = 1e-4  # of a correlation: patches are never more alike


def trial_blurs_px(noise: NoiseConfig) -> list[tuple[float, float]]:
    """Return the blurs of the left and the right view to compare, 1-sigmas, px."""
    square = 0.5 * noise.most_blur_px ** 2
    return [(math.sqrt(square * (1 + share)), math.sqrt(square * (1 - share)))
            for share in _SHARES]


def blur_log_likelihoods(patches: Array, pixels: float, noise: NoiseConfig) -> Array:
    """
    Return the log-likelihoods (n,) of the differences of blur by one pair; those of pairs add up.

    :param patches: (n, 2, G) of both views with each of :func:`trial_blurs_px`.
    :param pixels: that they cover in a view.
    :param noise: how great a difference may be.
    """
    # Pixels within the blur of both views are alike.
    independent = pixels / (2 * math.pi * noise.most_blur_px ** 2)
    lack = np.maximum(1 - ncc(patches[:, 0], patches[:, 1]), _LEAST_LACK)
    return np.asarray(-0.5 * independent * np.log(lack))


def equal_blurs_px(log_likelihood: Array, noise: NoiseConfig) -> tuple[float, float]:
    """
    Return the blurs that make both views equally sharp, 1-sigmas, px: one of them is 0.

    Both are where the views may well be as sharp as each other.

    :param log_likelihood: (n,) of :func:`blur_log_likelihoods`, added over pairs.
    :param noise: how great a difference may be, and from when on it counts.
    """
    gain = float(log_likelihood.max() - log_likelihood[len(_SHARES) // 2])
    if gain < 0.5 * noise.sharpness_sigmas ** 2:
        return 0.0, 0.0
    place = float(parabola_peak(log_likelihood)[0])
    square = float(np.interp(place, np.arange(len(_SHARES)), _SHARES)) * noise.most_blur_px ** 2
    return math.sqrt(max(square, 0.0)), math.sqrt(max(-square, 0.0))


def grown_blurs_px(blur_px: tuple[float, float], growth: float) -> tuple[float, float]:
    """
    Return the blurs of both views that leave a front as blurred beside its size as it was.

    What a lens blurs keeps its size in pixels while the front grows; taken for a part of the
    front, it would hold the front back.

    :param blur_px: of the left and the right view that made them equally sharp; one of them is 0.
    :param growth: of the area of the front since then; one that shrinks is as blurred as it is.
    """
    usual_px = max(blur_px)
    more = usual_px ** 2 * (max(growth, 1.0) - 1)
    return math.sqrt(blur_px[0] ** 2 + more), math.sqrt(blur_px[1] ** 2 + more)
