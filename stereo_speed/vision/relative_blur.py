# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
By how much one view of a scene is more blurred than the other, from their power spectra.

Both views show the same scene from nearly the same place, so their spectra have the same shape
although no pixel of one agrees with the same pixel of the other.  A Gaussian blur of 1-sigma s
multiplies the power at the frequency f by exp(-4 pi^2 f^2 s^2), thus the logarithm of the ratio of
two spectra is a line in f^2, whose slope is the difference of the squared blurs.  Contrast and
exposure shift that line as a whole.
"""
from __future__ import annotations

import math
from typing import Any, NamedTuple, Optional

import cv2
import numpy as np
from numpy.typing import NDArray
import scipy.fft

from ..core.records import Array

_TILE_PX = 128  # side of the tiles whose spectra are averaged
_MOST_TILES = 6, 8  # down and across an image; more would hardly add
_LOWEST, _BINS = 0.02, 20  # lowest frequency, cycles per px, and number of bounds of the bins
_NOISY = 0.4  # frequency from which on the least power is taken for that of the noise
_CLEAR = 8.0  # ratio of power to that of the noise from which on a frequency counts
_LEAST_BINS = 5  # fewer tell no line
_MOST_STD_PX2 = 0.5  # 1-sigma from which on the line is none
_LEAST_BLUR_PX = 0.7  # a smaller difference changes no window of several pixels noticeably


class RelativeBlur(NamedTuple):
    """
    The difference of the squared blurs of two views, of the second less the first.

    :param px2: the difference, px^2.
    :param std_px2: its 1-sigma, as far as the scatter about the line tells, px^2.
    """

    px2: float
    std_px2: float


def relative_blur(first: NDArray[Any], second: NDArray[Any]) -> Optional[RelativeBlur]:
    """
    Return by how much the second view of a scene is more blurred than the first.

    :param first: (H, W) grey image.
    :param second: the other view, of the same size.
    :return: None where the views show too few details.
    """
    if min(first.shape) < _TILE_PX:
        return None
    powers = np.stack([_spectrum(view) for view in (first, second)])
    noise = powers[:, _FREQUENCIES >= _NOISY].min(axis=1, keepdims=True)
    clear = (powers > _CLEAR * noise).all(axis=0) & (_FREQUENCIES < _NOISY)
    if np.count_nonzero(clear) < _LEAST_BINS:
        return None
    # A bin of more frequencies scatters less: its weight is their root.
    weights = np.sqrt(_COUNTS[clear])
    line = weights[:, None] * np.column_stack([
        np.ones(len(weights)), -(2 * np.pi * _FREQUENCIES[clear]) ** 2])
    want = weights * np.log(powers[1, clear] / powers[0, clear])
    found = np.linalg.lstsq(line, want, rcond=None)[0]
    scatter = float(np.sum((want - line @ found) ** 2)) / (len(want) - 2)
    std_px2 = math.sqrt(scatter * float(np.linalg.inv(line.T @ line)[1, 1]))
    return RelativeBlur(float(found[1]), std_px2) if std_px2 < _MOST_STD_PX2 else None


def equally_sharp(first: NDArray[Any], second: NDArray[Any], more_px2: float
                  ) -> tuple[NDArray[Any], NDArray[Any]]:
    """
    Return two views with the blur of the less sharp one; unchanged if they differ little.

    :param first: (H, W) grey image.
    :param second: the other view.
    :param more_px2: squared blur of the second view less that of the first, px^2.
    :return: the views; the sharper one as float32 if it had to be blurred.
    """
    if abs(more_px2) < _LEAST_BLUR_PX ** 2:
        return first, second
    if more_px2 > 0:
        return blurred(first.astype(np.float32), more_px2), second
    return first, blurred(second.astype(np.float32), -more_px2)


def blurred(view: NDArray[np.float32], px2: float) -> NDArray[np.float32]:
    """
    Return a view blurred by a Gaussian.

    :param view: (H, W) image.
    :param px2: its squared 1-sigma, px^2.
    """
    return np.asarray(cv2.GaussianBlur(view, (0, 0), math.sqrt(px2),
                                       borderType=cv2.BORDER_REPLICATE), np.float32)


def _spectrum(view: NDArray[Any]) -> Array:
    """Return the mean power (b,) of a view (H, W) in bins of frequency."""
    tiles = np.stack([view[top:top + _TILE_PX, left:left + _TILE_PX]
                      for top, left in _places(view.shape)]).astype(np.float32)
    tiles = (tiles - tiles.mean(axis=(1, 2), keepdims=True)) * _WINDOW
    waves = scipy.fft.rfft2(tiles)  # in single precision, as that of old numpy versions is not
    power = np.mean(waves.real ** 2 + waves.imag ** 2, axis=0)
    return np.asarray(np.bincount(_BIN, power.ravel()[_INSIDE]) / _COUNTS)


def _places(shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the top left corners of tiles, spread evenly over an image."""
    tops, lefts = (
        np.linspace(0, size - _TILE_PX, min(size // _TILE_PX, most)).astype(int).tolist()
        for size, most in zip(shape, _MOST_TILES))
    return [(top, left) for top in tops for left in lefts]


def _bins() -> tuple[NDArray[np.bool_], NDArray[np.intp], NDArray[np.intp], Array]:
    """Return which frequencies of a tile count, their bins, and size and mean of each bin."""
    f = np.hypot(np.fft.fftfreq(_TILE_PX)[:, None], np.fft.rfftfreq(_TILE_PX)).ravel()
    bounds = np.geomspace(_LOWEST, 0.5, _BINS)
    inside = (f >= bounds[0]) & (f < bounds[-1])
    at = np.searchsorted(bounds, f[inside], side='right') - 1
    counts = np.bincount(at)
    return inside, at, counts, np.asarray(np.bincount(at, f[inside]) / counts)


_INSIDE, _BIN, _COUNTS, _FREQUENCIES = _bins()
_WINDOW = np.outer(np.hanning(_TILE_PX), np.hanning(_TILE_PX)).astype(np.float32)
