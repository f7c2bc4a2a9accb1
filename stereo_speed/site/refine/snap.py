# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Moving a clicked point onto a nearby marking, in one view and before a road is known.

It uses the models of grey levels that measure whole lines, with short cross-sections that are
perpendicular to the line in the image and have the pixel as their unit.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Optional

import numpy as np
from numpy.typing import NDArray

from .empty_road import Background
from .section_model import (
    BAND, BAND_SHARE, detect, EDGE, fit_sections, least_contrast_grey, LEAST_GREY, Places, Shape)
from ...core.records import Array
from ...estimation.robust import robust_std

REACH_PX = 8.0  # largest distance of a marking from the click
_WIDTHS_PX = (0.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0)  # widths tried, 0 for an edge
_BLURS_PX = (0.5, 0.8, 1.2, 1.8)  # blurs tried
_HALF_LENGTH_PX, _SECTIONS = 10.0, 15  # half length of the measured piece, and its cross-sections
_STEP_PX = 0.5  # spacing of the samples of a cross-section
_ROUNDS = 3  # rounds of measuring, each along the direction found before
_LEAST_SECTIONS = 7  # fewest cross-sections that must show the marking
_MOST_SLOPE = 0.2  # largest slope of a marking relative to its expected direction
_MIDDLE_STD = 0.01  # 1-sigma of a band's middle by perspective and wear, as a share of its width
_PAINTED = 0.5  # share of the usual contrast below which a cross-section shows no marking
_NEAR_PX = 1.5  # largest distance from the median place for cross-sections of one marking
_STRAY = 3.0  # sigmas beyond which a cross-section is an outlier
_MOST_STD_PX = 0.3  # largest useful 1-sigma of a point, that of a careful click
_FLOOR_PX = 0.02  # 1-sigma that more cross-sections do not reduce
_STANDS_OUT = 2.5  # least contrast in multiples of that of the texture beside the marking
_BESIDE_PX, _TEXTURE = 4.0, 0.9  # distance of that texture, and quantile of its contrasts
_PENALTY = 0.03  # reduction of the score per pixel from the click, so that nearer markings win
_RADIUS_PX, _COHERENT = 8, 0.35  # radius of a patch with a direction, and its least coherence


@dataclass(frozen=True, eq=False)
class Snapped:
    """
    A point on a marking.

    :param uv_px: (2,) raw pixel in the middle of the band, or on the edge.
    :param std_px: 1-sigma across the marking, px.
    :param kind: ``band`` or ``edge``.
    """

    uv_px: Array
    std_px: float
    kind: str


def snap(view: Background, uv_px: Array, direction: Optional[Array] = None) -> Optional[Snapped]:
    """
    Return the point of a marking that is nearest to a click; None if there is no marking.

    :param view: the view without traffic.
    :param uv_px: (2,) clicked raw pixel.
    :param direction: (2,) direction of the line there; None to estimate it from the image.
    """
    at = np.asarray(uv_px, dtype=np.float64)
    length = 0.0 if direction is None else float(np.linalg.norm(direction))
    along = np.asarray(direction) / length if length > 0 else _image_direction(view, at)
    if along is None:
        return None
    shape, centre = _detected(view, _Sections.across(view, at, along)), at
    if shape is None:
        return None
    for _ in range(_ROUNDS):
        sections = _Sections.across(view, centre, along)
        line = _line(view, sections, shape)
        if line is None:
            return None
        offset, slope, std = line
        if abs(slope) > _MOST_SLOPE:
            return None
        normal = _normal(along)
        centre = centre + offset * normal
        along = (along + slope * normal) / math.hypot(1.0, slope)
        shape = replace(shape, at_px=0.0)
    # Move across the line only: keep the click's place along it.
    centre = centre + float((at - centre) @ along) * along
    if float(np.linalg.norm(centre - at)) > REACH_PX or std > _MOST_STD_PX:
        return None
    return Snapped(centre, std, shape.kind)


def _normal(along: Array) -> Array:
    """Return the perpendicular (2,) of a direction."""
    return np.array([-along[1], along[0]])


def _image_direction(view: Background, at: Array) -> Optional[Array]:
    """Return the direction (2,) of the structure at a place; None if it has no clear one."""
    u, v = (int(round(float(x))) for x in at)
    r = _RADIUS_PX
    patch = view.image[max(v - r, 0):v + r + 1, max(u - r, 0):u + r + 1].astype(np.float64)
    if min(patch.shape) < r:
        return None
    dv, du = np.gradient(patch)
    y, x = np.indices(patch.shape)
    weight = np.exp(-2.0 * ((x - x.mean())**2 + (y - y.mean())**2) / r**2)
    a, b, c = (float((weight * p).sum()) for p in (du * du, du * dv, dv * dv))
    strength = math.hypot(a - c, 2 * b)
    least = float(weight.sum()) * view.noise_grey**2
    if strength < _COHERENT * (a + c) or a + c < least:
        return None
    across = 0.5 * math.atan2(2 * b, a - c)
    return np.array([-math.sin(across), math.cos(across)])


@dataclass(frozen=True, eq=False)
class _Sections:
    """
    Short cross-sections of one piece of a line.

    :param along_px: (n,) places of the cross-sections along the line, px.
    :param across_px: (n, k) places of the samples across the line, px.
    :param grey: (n, k) grey levels there, NaN outside the image.
    """

    along_px: Array
    across_px: Array
    grey: Array

    @classmethod
    def across(cls, view: Background, centre: Array, along: Array) -> _Sections:
        """Return the cross-sections around a place."""
        t = np.linspace(-_HALF_LENGTH_PX, _HALF_LENGTH_PX, _SECTIONS)
        half = REACH_PX + 1.1 * _WIDTHS_PX[-1]
        x = np.tile(np.arange(-half, half + _STEP_PX / 2, _STEP_PX), (len(t), 1))
        uv = centre + t[:, None, None] * along + x[..., None] * _normal(along)
        return cls(t, x, view.spline(uv))


def _detected(view: Background, sections: _Sections) -> Optional[_Start]:
    """Return the band near the click, or the edge if there is no band."""
    ones, x = np.ones(_SECTIONS), sections.across_px
    reachable = np.abs(x[0]) <= REACH_PX
    worth = 1 - _PENALTY * np.abs(x[0])
    best: dict[str, tuple[float, _Start]] = {}
    for width in _WIDTHS_PX:
        kind = BAND if width else EDGE
        for contrast, sign in zip(detect(x, sections.grey, ones, width), (1, -1)):
            finite = np.isfinite(contrast)
            usual = np.where(finite.sum(axis=0) >= _LEAST_SECTIONS,
                             np.where(finite, contrast, 0.0).sum(axis=0)
                             / np.maximum(finite.sum(axis=0), 1), -np.inf)
            score = np.where(reachable, usual * worth, -np.inf)
            peak = int(np.argmax(score))
            beside = np.isfinite(usual) & (np.abs(x[0] - x[0, peak]) > width + _BESIDE_PX)
            texture = float(np.quantile(usual[beside], _TEXTURE)) if beside.any() else 0.0
            if usual[peak] < _STANDS_OUT * texture:
                continue
            start = _Start(kind, width, 0.8, sign, float(x[0, peak]), float(usual[peak]))
            # Of bands with equal contrast, the widest one is the complete band.
            value = float(score[peak]) * (1 + 0.01 * width)
            if value > best.get(kind, (-np.inf, start))[0]:
                best[kind] = value, start
    least = least_contrast_grey(view.noise_grey)
    band, edge = (best[kind][1] if kind in best else None for kind in (BAND, EDGE))
    strongest = 0.0 if edge is None else edge.contrast
    if band is not None and band.contrast >= max(least, BAND_SHARE * strongest):
        return _tuned(view, sections, band)
    return _tuned(view, sections, edge) if edge is not None and strongest >= least else None


@dataclass(frozen=True)
class _Start(Shape):
    """
    A rough shape and its place.

    :param at_px: place across the line, px.
    :param contrast: contrast, grey levels.
    """

    at_px: float = 0.0
    contrast: float = 0.0


def _fitted(view: Background, sections: _Sections, shape: Shape, at_px: float) -> Places:
    """Return the places of the marking on all cross-sections, near one place."""
    ones = np.ones(len(sections.along_px))
    return fit_sections(shape, sections.across_px, sections.grey, ones, at_px * ones,
                        view.noise_grey)


def _tuned(view: Background, sections: _Sections, start: _Start) -> _Start:
    """Return the shape with the width and blur that leave the smallest residuals."""
    widths = [start.width_m] if start.kind == EDGE else [
        start.width_m * share for share in (0.6, 0.8, 1.0, 1.25, 1.6)]
    tried = [_Start(start.kind, width, blur, start.sign, start.at_px, start.contrast)
             for width in widths for blur in _BLURS_PX]

    def misfit(shape: _Start) -> float:
        places = _fitted(view, sections, shape, shape.at_px)
        painted = places.contrast > _PAINTED * start.contrast
        return float(np.median(places.rms[painted])) if painted.any() else math.inf
    return min(tried, key=misfit)


def _line(view: Background, sections: _Sections, shape: _Start
          ) -> Optional[tuple[float, float, float]]:
    """Return offset, slope and 1-sigma of the marking at the centre; None if too few agree."""
    places = _fitted(view, sections, shape, shape.at_px)
    x, t = places.across_m, sections.along_px
    least = max(_PAINTED * float(np.quantile(places.contrast, 0.8)), LEAST_GREY / 2)
    good: NDArray[np.bool_] = np.isfinite(x) & (places.contrast > least)
    if good.sum() < _LEAST_SECTIONS:
        return None
    good &= np.abs(x - np.median(x[good])) < _NEAR_PX + 0.2 * np.abs(t)
    for _ in range(2):
        if good.sum() < _LEAST_SECTIONS:
            return None
        slope, offset = np.polyfit(t[good], x[good], 1)
        off = x - offset - slope * t
        spread = max(robust_std(off[good]), _FLOOR_PX)
        good &= np.abs(off) < _STRAY * spread
    std = math.hypot(spread / math.sqrt(max(float(good.sum()) / 2, 1.0)), _FLOOR_PX,
                     _MIDDLE_STD * shape.width_m)
    return float(offset), float(slope), std
