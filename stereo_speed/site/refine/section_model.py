# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Models of the grey levels across a line: a painted band, or the edge of a kerb.

A band has its own level between two edges a known width apart, and a level on each side; an edge
has two levels. Both are blurred by the pixel and the lens. The place is found by Gauss-Newton
together with the levels, for all cross-sections at once.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtr

from ...core.records import Array

BAND, EDGE = 'band', 'edge'
# Least contrast of a band as a share of that of the best edge.  A kerb shows no band, as a band
# must differ from both of its sides; a painted line beside something lighter shows a weak one.
BAND_SHARE = 0.35
_LEAST_NOISES, LEAST_GREY = 3.0, 4.0  # least contrast, in 1-sigmas of the noise and grey levels
MARGIN_PX = 4.0  # least width of road that is read on either side of a band
_MARGIN_WIDTHS = 0.8  # the same in half widths of the band, for bands that are wide in the image
_STEPS = 6  # Gauss-Newton steps; it converges in four from half a band away
_START_GREY = 10.0  # initial contrast; the first step finds the levels before the place
_SIDES_ALIKE = 0.1  # 1-sigma of the difference between both sides, as a share of the contrast
_REACH_PX = 2.0  # largest distance of the place of an edge from its start
_LEAST_SAMPLES = 8  # fewest samples of a cross-section, twice the number of unknowns
_LEVELS = 4  # unknowns of a band: three levels and the place
_LEAST_RMS = 1e-3  # lower bound of the residual in grey levels, which exact images would undercut
_FLOOR_VARIANCE = 0.25  # added to the variance, so that sections without noise do not dominate
_BLUR_RANGE_PX = 0.2, 4.0  # blur from that of a pixel to that of a lens out of focus
_WIDTH_RANGE_M = 0.03, 0.8  # width of bands from worn edge lines to stop lines
_GAP_PX = 0.7  # blurred gap between a band and its sides in the search
_FLANK_PX = 2.5  # least width of a side in the search
_BAND_INSIDE = 0.3  # largest share of half a band that its blurred edge takes up in the search
_SEEN = 0.9  # least share of a side or band that must lie in the image


@dataclass(frozen=True)
class Shape:
    """
    The common properties of the cross-sections of one line.

    :param kind: ``band`` or ``edge``.
    :param width_m: width of the band, m; 0 for an edge.
    :param blur_px: 1-sigma of the blur across the line in the image, px.
    :param sign: 1 for a band lighter than the road, or an edge lighter on the left; else -1.
    """

    kind: str
    width_m: float
    blur_px: float
    sign: int

    def half_window_m(self, px_per_m: Array) -> Array:
        """Return half the width (n,) over which cross-sections are read, m."""
        half = self.width_m / 2
        return half + np.maximum(MARGIN_PX / px_per_m, _MARGIN_WIDTHS * half)

    def displaced_px(self, px_per_m: Array) -> Array:
        """
        Return the possible bias (n,), px, of a band whose sides differ by its own contrast.

        Where one side changes to the other, such as at a kerb or at grass, is not known.  The
        part of that change that blurs into a narrow band cannot be separated from the band.
        """
        if self.kind == EDGE:
            return np.zeros(len(px_per_m))
        return np.asarray(self.blur_px**2 / (self.width_m * px_per_m))


@dataclass(frozen=True, eq=False)
class Places:
    """
    The places of the line on cross-sections.

    :param across_m: (n,) places of the line, m, from the origin of the cross-section, positive to
        the left.
    :param contrast: (n,) contrasts, grey levels; positive if they have the sign of the shape.
    :param rms: (n,) r.m.s. residuals of the model, grey levels.
    :param std_m: (n,) 1-sigmas of ``across_m`` from the residuals, m.
    :param uneven: (n,) differences between the sides of a band, in contrasts of the band; 0 for an
        edge.
    """

    across_m: Array
    contrast: Array
    rms: Array
    std_m: Array
    uneven: Array


def fit_sections(shape: Shape, across_m: Array, grey: Array, px_per_m: Array, start_m: Array,
                 noise_grey: float) -> Places:
    """
    Return the place of the line on each cross-section.

    :param across_m: (n, k) places of the samples across the road, m.
    :param grey: (n, k) grey levels; NaN is ignored.
    :param px_per_m: (n,) image scale across the line, px/m.
    :param start_m: (n,) expected places of the line, m, correct to about half the band or the
        blur.
    :param noise_grey: 1-sigma of a grey level, including texture, against which the prior of the
        levels is weighed.
    """
    valid = np.isfinite(grey)
    values = np.where(valid, grey, 0.0)
    weight = (valid & (np.abs(across_m - start_m[:, None])
                       <= shape.half_window_m(px_per_m)[:, None])).astype(float)
    blur = (shape.blur_px / px_per_m)[:, None]
    at, reach = start_m.copy(), np.maximum(shape.width_m / 2, _REACH_PX / px_per_m)
    level = np.full(len(at), _START_GREY)
    for step in range(_STEPS + 1):
        basis, slope = _basis(shape, across_m - at[:, None], blur)
        a = np.concatenate([basis, (level[:, None] * slope)[..., None]], axis=-1)
        if step == 0:
            a = basis
        ridge = _ridge(shape, a.shape[-1], level, noise_grey)
        weighted = np.swapaxes(a * weight[..., None], -1, -2)
        normal = weighted @ a + ridge
        solution = np.linalg.solve(normal, weighted @ values[..., None])[..., 0]
        level = solution[:, basis.shape[-1] - 1]
        if step:
            move = np.clip(solution[:, -1], -0.5 * reach, 0.5 * reach)
            at = np.clip(at + np.nan_to_num(move), start_m - reach, start_m + reach)
    fitted = (basis @ solution[:, :basis.shape[-1], None])[..., 0]
    count = weight.sum(axis=-1)
    rms = np.sqrt(np.sum(weight * (values - fitted)**2, axis=-1) / np.maximum(count - _LEVELS, 1))
    std = np.sqrt(np.maximum(np.linalg.inv(normal)[:, -1, -1], 0)) * np.maximum(rms, _LEAST_RMS)
    bad = count < _LEAST_SAMPLES
    uneven = np.zeros(len(at)) if shape.kind == EDGE else np.abs(
        solution[:, 1] / np.where(level == 0, np.inf, level))
    return Places(np.where(bad, np.nan, at), np.where(bad, 0.0, shape.sign * level), rms, std,
                  uneven)


def _basis(shape: Shape, x: Array, blur: Array) -> tuple[Array, Array]:
    """
    Return the basis functions (n, k, m) of the levels and the derivative of the last by the place.

    The last basis function is that of the contrast.

    :param x: (n, k) distances from the place, m.
    :param blur: (n, 1) 1-sigma of the blur, m.
    """
    def edge(z: Array) -> tuple[Array, Array]:
        return ndtr(z / blur), np.exp(-0.5 * (z / blur)**2) / (blur * np.sqrt(2 * np.pi))
    ones, half = np.ones_like(x), shape.width_m / 2
    if shape.kind == EDGE:
        rise, slope = edge(x)
        return np.stack([ones, rise - 0.5], axis=-1), -slope
    (rise, up), (fall, down) = edge(x + half), edge(x - half)
    # The sides may differ, with half of the step at either edge.
    return np.stack([ones, (rise + fall) / 2 - 0.5, rise - fall], axis=-1), down - up


def _ridge(shape: Shape, size: int, level: Array, noise_grey: float) -> Array:
    """Return the prior information (n, size, size): sides are alike, and a small ridge."""
    out = np.tile(1e-9 * np.eye(size), (len(level), 1, 1))
    if shape.kind == BAND:
        alike = np.maximum(_SIDES_ALIKE * np.abs(level), 1.0)
        out[:, 1, 1] += (noise_grey / alike)**2
    return out


def tuned(shape: Shape, across_m: Array, grey: Array, px_per_m: Array, start_m: Array,
          noise_grey: float) -> Shape:
    """Return the shape with the width and blur that fit the cross-sections of a line best."""
    def shape_at(x: Array) -> Shape:
        width = float(np.exp(x[1])) if len(x) > 1 else 0.0
        return replace(shape, blur_px=float(np.exp(x[0])), width_m=width)

    window = np.abs(across_m - start_m[:, None]) <= shape.half_window_m(px_per_m)[:, None]
    grey = np.where(window, grey, np.nan)  # the same samples for every width

    def cost(x: Array) -> float:
        ranges = (_BLUR_RANGE_PX, _WIDTH_RANGE_M)[:len(x)]
        if not all(np.log(low) <= value <= np.log(high) for value, (low, high) in zip(x, ranges)):
            return 1e9
        places = fit_sections(shape_at(x), across_m, grey, px_per_m, start_m, noise_grey)
        return float(np.mean(np.log(places.rms**2 + _FLOOR_VARIANCE)))

    start = [np.log(shape.blur_px)]
    if shape.kind == BAND:
        start.append(np.log(shape.width_m))
    result = minimize(cost, start, method='Nelder-Mead', options={
        'maxfev': 45, 'xatol': 0.01, 'fatol': 1e-4, 'initial_simplex': _simplex(start)})
    return shape_at(result.x)


def _simplex(start: list[float]) -> Array:
    """Return an initial simplex whose vertices differ by about a fifth of width and blur."""
    return np.array(start) + np.vstack([np.zeros(len(start)), 0.2 * np.eye(len(start))])


def least_contrast_grey(noise_grey: float) -> float:
    """Return the least contrast of a marking, in grey levels, for the noise of an image."""
    return max(_LEAST_NOISES * noise_grey, LEAST_GREY)


def detect(across_m: Array, grey: Array, px_per_m: Array, width_m: float
           ) -> tuple[Array, Array]:
    """
    Return the contrasts of a band, or of an edge, at all places of each cross-section.

    A band must differ from both of its sides, so that an edge is not taken as a band.

    :param across_m: (n, k) evenly spaced places on each cross-section, m.
    :param grey: (n, k) grey levels.
    :param px_per_m: (n,) image scale across the line, px/m.
    :param width_m: width of the band, m; 0 for an edge.
    :return: contrasts (n, k) of a light and (n, k) of a dark band, or of an edge lighter on the
        left and on the right; -inf where it does not fit on the cross-section.
    """
    step = (across_m[:, 1] - across_m[:, 0])[:, None]
    known = np.isfinite(grey)
    summed = _running(np.where(known, grey, 0.0)), _running(known.astype(float))
    place = np.arange(across_m.shape[1])[None, :] + 0.5
    gap = _GAP_PX / px_per_m[:, None] / step
    flank = np.maximum(_FLANK_PX / px_per_m, width_m / 2)[:, None] / step
    half = width_m / 2 / step

    def mean(low: Array, high: Array) -> Array:
        total, count = (_at(s, high) - _at(s, low) for s in summed)
        inside = (low >= 0) & (high <= across_m.shape[1]) & (count > _SEEN * (high - low))
        return np.where(inside, total / np.maximum(count, 1e-9), np.nan)

    left = mean(place + half + gap, place + half + gap + flank)
    right = mean(place - half - gap - flank, place - half - gap)
    if width_m == 0:
        light, dark = left - right, right - left
    else:
        inner = np.minimum(gap, _BAND_INSIDE * half)
        middle = mean(place - half + inner, place + half - inner)
        light = middle - np.maximum(left, right)
        dark = np.minimum(left, right) - middle
    return np.nan_to_num(light, nan=-np.inf), np.nan_to_num(dark, nan=-np.inf)


def _running(values: Array) -> Array:
    """Return the running sums (n, k + 1) along cross-sections."""
    return np.concatenate([np.zeros((len(values), 1)), np.cumsum(values, axis=1)], axis=1)


def _at(summed: Array, index: Array) -> Array:
    """Return running sums, interpolated between samples."""
    index = np.clip(index, 0, summed.shape[1] - 1.000001)
    low = index.astype(int)
    rows = np.arange(len(summed))[:, None]
    share = index - low
    return np.asarray(summed[rows, low] * (1 - share) + summed[rows, low + 1] * share)
