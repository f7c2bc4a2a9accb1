# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Views that are equally sharp, so that a blurred line lies off alike in both.

A camera out of focus smears what lies beside a marking, such as the verge, into its
cross-sections: its middle seems to lie elsewhere, by up to a tenth of a pixel. In both views alike
that hardly matters; in one of them it looks like a right camera that has turned.
"""
from __future__ import annotations

from dataclasses import replace
import math
from typing import Iterable

import cv2
import numpy as np

from .empty_road import Background, LEAST_NOISE_GREY
from .markings import LocatedLine

Views = tuple[Background, Background]
_LEAST_BLUR_PX = 0.3  # a Gaussian narrower than that falls between the pixels


def equally_sharp(views: Views, lines: Iterable[tuple[LocatedLine, LocatedLine]]) -> Views:
    """
    Return both views with the blur of the duller one; themselves where they are equally sharp.

    :param views: left and right.
    :param lines: as found in both, whose blurs tell how sharp the views are.
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
    """Return a view through a Gaussian of this 1-sigma, with the noise that this leaves."""
    image = cv2.GaussianBlur(view.image, (0, 0), blur_px, borderType=cv2.BORDER_REPLICATE)
    # White noise through a Gaussian keeps this share.
    noise = min(1.0, 1 / (2 * math.sqrt(math.pi) * blur_px)) * view.noise_grey
    return replace(view, image=np.asarray(image, np.float32),
                   noise_grey=max(noise, LEAST_NOISE_GREY))
