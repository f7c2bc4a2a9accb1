# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Estimates from the front itself which view is sharper, and by how much.

A camera out of focus blurs a far front by as much as its details are wide: the views then differ
most where they are most informative, and in one of them the edges of the front merge with the
background.  Blurring the other view by the same amount makes them alike.  Differences of blur are
compared at the same sum of squares of both blurs, so that each averages noise equally.

A lens blurs light; scaling, compression and the noise reduction of a camera blur grey levels.  How
much brighter lamps are than the rest of the front makes the two look different, and the views tell
which it is.

A lens blurs all pairs by the same number of pixels, so the log-likelihoods of pairs add up.  The
first pairs are the most informative: nearer, clipped lamps differ more than the rest of the front.
"""
from __future__ import annotations

import math

import numpy as np

from ..core.records import Array
from ..core.tracker_config import NoiseConfig
from ..vision.ncc import ncc
from ..vision.subpixel import parabola_peak

_SHARES = np.linspace(-1.0, 1.0, 9)  # trial shares of the greatest difference of squared blurs
_LEAST_LACK = 1e-4  # least value of 1 - NCC of two patches


def trial_blurs_px(noise: NoiseConfig) -> list[tuple[float, float]]:
    """Return the trial blurs of the left and the right view, 1-sigmas, px."""
    square = 0.5 * noise.most_blur_px ** 2
    return [(math.sqrt(square * (1 + share)), math.sqrt(square * (1 - share)))
            for share in _SHARES]


def trial_gammas(noise: NoiseConfig) -> tuple[float, ...]:
    """Return the roots of light on which blurs are tried to act: ``noise.gamma``, and none."""
    return tuple(dict.fromkeys((noise.gamma, 1.0)))


def blur_log_likelihoods(patches: Array, pixels: float, noise: NoiseConfig) -> Array:
    """
    Return the log-likelihoods (k, n) of the trial blurs from one pair; those of pairs add up.

    :param patches: (k, n, 2, G) patches of both views for each of :func:`trial_gammas`, with each
        of :func:`trial_blurs_px`.
    :param pixels: number of pixels that they cover in a view.
    :param noise: parameters; here, the greatest difference of blur.
    """
    # Pixels within the extent of the blur are not independent.
    independent = pixels / (2 * math.pi * noise.most_blur_px ** 2)
    lack = np.maximum(1 - ncc(patches[..., 0, :], patches[..., 1, :]), _LEAST_LACK)
    return np.asarray(-0.5 * independent * np.log(lack))


def equal_blurs_px(log_likelihood: Array, noise: NoiseConfig) -> tuple[float, float]:
    """
    Return the blurs that make both views equally sharp, 1-sigmas, px: one of them is 0.

    Both are 0 if the difference is not significant.

    :param log_likelihood: (n,) a row of :func:`blur_log_likelihoods`, summed over pairs.
    :param noise: parameters; here, the greatest difference of blur, and its significance.
    """
    gain = float(log_likelihood.max() - log_likelihood[len(_SHARES) // 2])
    if gain < 0.5 * noise.sharpness_sigmas ** 2:
        return 0.0, 0.0
    place = float(parabola_peak(log_likelihood)[0])
    square = float(np.interp(place, np.arange(len(_SHARES)), _SHARES)) * noise.most_blur_px ** 2
    return math.sqrt(max(square, 0.0)), math.sqrt(max(-square, 0.0))


def likeliest_blurs(log_likelihood: Array, noise: NoiseConfig
                    ) -> tuple[float, tuple[float, float]]:
    """
    Return on which root of light blur acts, and the blurs of :func:`equal_blurs_px`.

    Without blur it is ``noise.gamma``.

    The evidence of a root is what its best blur gains over equal sharpness: another root also
    changes the contrast of the patches, which says nothing about blur.

    :param log_likelihood: (k, n) of :func:`blur_log_likelihoods`, summed over pairs.
    :param noise: parameters; here, as for :func:`equal_blurs_px`.
    """
    gain = log_likelihood.max(axis=1) - log_likelihood[:, len(_SHARES) // 2]
    best = int(gain.argmax())
    blurs_px = equal_blurs_px(log_likelihood[best], noise)
    return trial_gammas(noise)[best] if any(blurs_px) else noise.gamma, blurs_px


def grown_blurs_px(blur_px: tuple[float, float], growth: float) -> tuple[float, float]:
    """
    Return the blurs of both views that keep the total blur proportional to the front's size.

    The blur of a lens keeps its size in pixels while the front grows; taken for a part of the
    front, it would make the front seem to approach more slowly.

    :param blur_px: blurs of the left and the right view that make them equally sharp; one is 0.
    :param growth: growth of the front's area since these were estimated; a factor below 1 adds no
        blur.
    """
    usual_px = max(blur_px)
    more = usual_px ** 2 * (max(growth, 1.0) - 1)
    return math.sqrt(blur_px[0] ** 2 + more), math.sqrt(blur_px[1] ** 2 + more)
