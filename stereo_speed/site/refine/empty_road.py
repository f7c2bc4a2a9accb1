# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The background: an image of each view without traffic, from few or many pairs.

The median over time is not affected by what passes in fewer than half of the pairs. The mean of
the values near the median has less noise than the median itself, and no quantisation.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from typing import Iterable, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from ...core.errors import InputError
from ...core.records import StereoPair
from ...core.sampling import EvenSampler
from ...estimation.robust import robust_std, SIGMAS_PER_MEDIAN
from ...vision.grey import white_level
from ...vision.spline_image import SplineImage

MOST_PAIRS = 31  # enough pairs: beyond them texture and lens limit the precision, not noise
MOST_BYTES = 128 * 2**20  # limit of the memory for the images of one view
_BLOCK_ROWS = 64  # rows of the image stack that are processed at once, to stay in the cache
_GATE = 2.5  # sigmas of the noise within which values enter the mean
LEAST_NOISE_GREY = 0.5  # lower bound of the noise of an image with integer grey levels
_WHITE_GREY = 255.0  # grey level that white becomes, of images of any number of bits
LIGHT_STEP_PX = 2  # spacing of the places where changes of light are measured
_CLIPPED_GREY = 240.0  # grey levels from which clipping makes a pixel useless for the exposure
_DARKEST = 0.01  # lower bound of the relative exposure of an image
_LIGHT_IMAGES = 5  # fewest images that distinguish changes of light from noise
_LIGHT_NOISES = 5.0  # least change in sigmas, whose estimates from few images scatter by a third


@dataclass(frozen=True, eq=False)
class Background:
    """
    One view without its traffic.

    :param image: (H, W) float32 grey levels.
    :param noise_grey: 1-sigma of the noise of a single image, grey levels.
    :param pairs: number of images that it was computed from.
    :param change: 1-sigma over time of every second pixel in both directions, as a share of its
        grey level and apart from exposure; 0 where noise may explain it, None if there were too
        few images.
    """

    image: NDArray[np.float32]
    noise_grey: float
    pairs: int
    change: Optional[NDArray[np.float32]] = None

    @cached_property
    def spline(self) -> SplineImage:
        """Return the image as a spline, for reading between pixels."""
        return SplineImage(self.image)


def spread_pairs(pairs: Iterable[StereoPair], most: int = MOST_PAIRS) -> list[StereoPair]:
    """
    Return at most so many pairs of a stream of any length, evenly spread over it.

    Of large images fewer pairs are returned, so that those of a view fit into ``MOST_BYTES``.

    :param pairs: the stream, which is read to its end.
    :param most: largest number of pairs, 2 or more.
    """
    sampler: Optional[EvenSampler[StereoPair]] = None
    for pair in pairs:
        if sampler is None:
            sampler = EvenSampler(max(min(most, MOST_BYTES // pair.left.nbytes), 2))
        if sampler.wants():
            sampler.add(pair)
    return [] if sampler is None else sampler.items()


def clean_background(images: list[NDArray[np.generic]], where: object,
                     white: Optional[int] = None) -> Background:
    """
    Return the background of one view.

    :param images: (H, W) uint8 or uint16, all of one size; scaled to 0 to 255.
    :param where: source of the images, for the error.
    :param white: largest grey level of the camera; None to tell it from the images.
    :raises InputError: no images.
    """
    if not images:
        raise InputError(where, 'pairs', 'none', 'at least one pair of images')
    scale = _WHITE_GREY / (white_level(images) if white is None else white)
    out = np.empty(images[0].shape, np.float32)
    spreads = []
    for top in range(0, len(out), _BLOCK_ROWS):
        rows = slice(top, top + _BLOCK_ROWS)
        block = np.stack([image[rows] for image in images]).astype(np.float32) * scale
        middle = np.median(block, axis=0)
        off = np.abs(block - middle)
        spread = _spread(off, len(images))
        spreads.append(spread)
        # The nearest values always count, as the median of two may be far from both.
        near = off <= np.maximum(max(_GATE * spread, 1.0), off.min(axis=0))
        out[rows] = (block * near).sum(axis=0) / near.sum(axis=0)
    noise = float(np.median(spreads)) if len(images) > 2 else _noise_of_one(out)
    change = _change(images, scale, out, noise) if len(images) >= _LIGHT_IMAGES else None
    return Background(out, noise, len(images), change)


def _change(images: list[NDArray[np.generic]], scale: float, still: NDArray[np.float32],
            noise: float) -> NDArray[np.float32]:
    """
    Return the change of places over time, see :attr:`Background.change`.

    What passes in fewer than half of the images does not count; headlamps sweeping the road do.

    :param scale: grey levels per unit of the images.
    :param still: (H, W) the background, grey levels.
    :param noise: noise of a single image, grey levels.
    """
    every = slice(None, None, LIGHT_STEP_PX)
    middle = still[every, every]
    lit = (middle > _LIGHT_NOISES * noise) & (middle < _CLIPPED_GREY)
    off = np.empty((len(images), *middle.shape), np.float32)
    for row, image in zip(off, images):
        grey = scale * image[every, every].astype(np.float32)
        exposure = float(np.median(grey[lit] / middle[lit])) if lit.any() else 1.0
        np.abs(grey / max(exposure, _DARKEST) - middle, out=row)
    std = SIGMAS_PER_MEDIAN * np.median(off, axis=0)
    usual = max(float(np.median(std)), LEAST_NOISE_GREY)  # most of a view has steady light
    return np.where(std > _LIGHT_NOISES * usual, std / np.maximum(middle, usual), 0.0).astype(
        np.float32)


def _spread(off: NDArray[np.float32], count: int) -> float:
    """Return the noise of a block from deviations from its median; infinite for two images."""
    lost = max(count - 1, 1) / count  # correction, as few values lie close to their own median
    return max(robust_std(off) / lost, LEAST_NOISE_GREY) if count > 2 else np.inf


def _noise_of_one(image: NDArray[np.float32]) -> float:
    """Return the noise of one image from second differences along its rows."""
    second = image[:, 2:] - 2 * image[:, 1:-1] + image[:, :-2]
    return max(robust_std(second) / math.sqrt(6.0), LEAST_NOISE_GREY)


def backgrounds(pairs: Iterable[StereoPair], where: object = 'pairs'
                ) -> tuple[Background, Background]:
    """
    Return the backgrounds of both views from a stream of pairs.

    :param pairs: few or many pairs.
    :param where: source of the pairs, for the error.
    """
    return of_both_views(spread_pairs(pairs), where)


def of_both_views(pairs: Sequence[StereoPair], where: object) -> tuple[Background, Background]:
    """
    Return the backgrounds of both views, with one scale of grey levels.

    :param pairs: few pairs.
    :param where: source of the pairs, for the error.
    """
    sides = [pair.left for pair in pairs], [pair.right for pair in pairs]
    white = white_level([*sides[0], *sides[1]])
    left, right = (clean_background(images, where, white) for images in sides)
    return left, right


def as_picture(background: Background) -> NDArray[np.uint8]:
    """Return a background as (H, W) uint8."""
    return np.asarray(np.clip(np.rint(background.image), 0, 255), dtype=np.uint8)
