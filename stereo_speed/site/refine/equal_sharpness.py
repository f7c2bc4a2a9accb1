# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Equalisation of the sharpness of both views, so that blur displaces a line alike in both.

A camera out of focus smears the surroundings of a marking, such as the verge, into its
cross-sections, which displaces its middle by up to a tenth of a pixel. The same displacement in
both views hardly matters; in only one view it looks like a rotation of the right camera.

The lines themselves tell the difference of blur: a lens blurs light, which spreads bright lines in
grey levels by more than the scene as a whole (``vision/relative_blur.py``).
"""
from __future__ import annotations

from dataclasses import replace
import math
from typing import Iterable

import numpy as np

from .empty_road import Background, LEAST_NOISE_GREY
from .markings import LocatedLine
from ...vision.relative_blur import blurred

Views = tuple[Background, Background]
_LEAST_BLUR_PX = 0.3  # a narrower Gaussian is not resolved by the pixels


def equally_sharp(views: Views, lines: Iterable[tuple[LocatedLine, LocatedLine]]) -> Views:
    """
    Return both views with the blur of the less sharp one; unchanged if they are equally sharp.

    :param views: left and right view.
    :param lines: lines found in both views, whose blur measures the sharpness of the views.
    """
    more_px2 = [right.shape.blur_px ** 2 - left.shape.blur_px ** 2 for left, right in lines]
    difference_px2 = float(np.median(more_px2)) if more_px2 else 0.0
    blur_px = math.sqrt(abs(difference_px2))
    if blur_px < _LEAST_BLUR_PX:
        return views
    left, right = views
    if difference_px2 > 0:
        return _blurred(left, blur_px), right
    return left, _blurred(right, blur_px)


def _blurred(view: Background, blur_px: float) -> Background:
    """Return a view blurred by a Gaussian of this 1-sigma, with its noise reduced accordingly."""
    # A Gaussian filter leaves this share of white noise.
    noise = min(1.0, 1 / (2 * math.sqrt(math.pi) * blur_px)) * view.noise_grey
    return replace(view, image=blurred(view.image, blur_px ** 2),
                   noise_grey=max(noise, LEAST_NOISE_GREY))
