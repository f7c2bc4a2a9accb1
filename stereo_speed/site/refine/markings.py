# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Paint, or a kerb, along one line in one raw view, to a few hundredths of a pixel.

First the whole line is looked for near the rough clicks, as a band or an edge that keeps its
distance from them over its whole length; what stands or passes in front of it does not. Then
every cut is measured by itself, those without paint are left out by their contrast, and stretches
of the line are taken together, each with the 1-sigma that its own scatter shows.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Optional

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from .cross_sections import Cuts, cuts_along, read_cuts, SplineImage
from .section_model import BAND, detect, EDGE, fit_profiles, Places, Shape, tuned
from ...core.records import Array
from ...road.fit import RoadFit

SEARCH_PX = 8.0  # how far from the rough line the paint may lie
WIDTHS_M = (0.08, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3)
FLOOR_PX = 0.012  # 1-sigma of a stretch that more cuts do not improve: texture, wear, the lens
MOST_STRETCHES, LEAST_STRETCH_PX, LEAST_CUTS = 40, 9.0, 4
TUNED_CUTS = 60  # from which width and blur are found
_PAINTED = 0.5  # of the usual contrast; cuts with less are gaps, or covered
_BAND_SHARE = 0.35  # of an edge's contrast that a band must show to be one
_LEAST_CONTRAST = 3.0  # times the noise, and
_LEAST_GREY = 4.0
_SAMPLES = 81, 37  # on a cut: to look, to measure
_BLUR_PX = 0.6  # to start with
_CORRELATED = 2.0  # neighbouring cuts that say the same


@dataclass(frozen=True, eq=False)
class LocatedLine:
    """
    One line as found in one view.

    :param uv_px: (n, 2) raw pixels in the middle of the band or on the edge, in order.
    :param std_px: (n,) 1-sigma across the line.
    :param s_m: (n,) their reference arc lengths.
    :param shape: of the profiles.
    :param scatter_px: robust scatter of single cuts.
    :param cuts: how many there were.
    :param used: how many of them are in the points.
    """

    uv_px: Array
    std_px: Array
    s_m: Array
    shape: Shape
    scatter_px: float
    cuts: int
    used: int

    def take(self, where: NDArray[np.bool_]) -> LocatedLine:
        """Keep some of the points."""
        return replace(self, uv_px=self.uv_px[where], std_px=self.std_px[where],
                       s_m=self.s_m[where])


def locate(fit: RoadFit, image: SplineImage, line: int, right: bool, ends_px: Array,
           noise_grey: float, shape: Optional[Shape] = None) -> Optional[LocatedLine]:
    """
    Find a line in a view.

    :param fit: the road as it is known, right to some px.
    :param image: the clean view.
    :param line: number of the line in the fit.
    :param right: the right view.
    :param ends_px: (2, 2) where the line begins and ends, roughly.
    :param noise_grey: 1-sigma of the grey levels.
    :param shape: the profiles' shape, where an earlier search found it: then the line is known
        to about a pixel.
    :return: None where nothing runs along the rough line.
    """
    cuts = cuts_along(fit, line, right, ends_px)
    if len(cuts.s_m) < 2 * LEAST_CUTS:
        return None
    start = np.zeros(len(cuts.s_m))
    if shape is None:
        found = _search(fit, image, line, right, cuts, noise_grey)
        if found is None:
            return None
        shape, start, contrast = found
    else:
        x, grey = _read(fit, image, line, right, cuts, start, shape)
        contrast = fit_profiles(shape, x, grey, cuts.px_per_m, start, noise_grey).contrast
    if not (contrast > 0).any():
        return None
    best = _spread_best(contrast, TUNED_CUTS)
    x, grey = _read(fit, image, line, right, cuts.take(best), start[best], shape)
    shape = tuned(shape, x, grey, cuts.px_per_m[best], start[best], noise_grey)
    x, grey = _read(fit, image, line, right, cuts, start, shape)
    places = fit_profiles(shape, x, grey, cuts.px_per_m, start, noise_grey)
    return _gathered(fit, line, right, cuts, places, shape, noise_grey)


def _read(fit: RoadFit, image: SplineImage, line: int, right: bool, cuts: Cuts, start_m: Array,
          shape: Shape) -> tuple[Array, Array]:
    """Read cuts about the places where the line is expected: places and levels (n, k)."""
    half = shape.half_window_m(cuts.px_per_m)
    x = start_m[:, None] + half[:, None] * np.linspace(-1, 1, _SAMPLES[1])
    return x, read_cuts(image, fit, line, right, cuts, x)


def _search(fit: RoadFit, image: SplineImage, line: int, right: bool, cuts: Cuts,
            noise_grey: float) -> Optional[tuple[Shape, Array, Array]]:
    """Look for the line: its rough shape, where it runs (n,), and contrasts (n,)."""
    offsets = fit.problem.model.offsets(fit.x)
    apart = np.abs(np.delete(offsets, line) - offsets[line])
    room = 0.45 * float(apart.min()) if apart.size else np.inf
    half = np.minimum(SEARCH_PX / cuts.px_per_m + 0.4, max(room, 0.3))
    x = half[:, None] * np.linspace(-1, 1, _SAMPLES[0])
    grey = read_cuts(image, fit, line, right, cuts, x)
    reach = np.minimum(SEARCH_PX / cuts.px_per_m, half)
    grey_edges = detect(x, grey, cuts.px_per_m, 0.0)
    edge = max((_followed(x, c, cuts, reach, 0.0, sign) for c, sign in zip(grey_edges, (1, -1))),
               key=lambda f: f[0])
    bands = [_followed(x, c, cuts, reach, width, sign) for width in WIDTHS_M
             for c, sign in zip(detect(x, grey, cuts.px_per_m, width), (1, -1))]
    band = max(bands, key=lambda f: f[0])
    least = max(_LEAST_CONTRAST * noise_grey, _LEAST_GREY)
    for found, wanted in ((band, max(least, _BAND_SHARE * edge[4])), (edge, least)):
        _, shape, start, contrast, usual = found
        if usual >= wanted:
            return shape, start, contrast
    return None


def _followed(x: Array, contrast: Array, cuts: Cuts, reach_m: Array, width_m: float, sign: int
              ) -> tuple[float, Shape, Array, Array, float]:
    """
    Follow one kind of line over all cuts.

    :param x: (n, k) places on the cuts.
    :param contrast: (n, k) there.
    :return: its score, its shape, where it runs (n,), its contrast there (n,), and the usual
        contrast of what is painted.
    """
    shape = Shape(BAND if width_m else EDGE, width_m, _BLUR_PX, sign)
    contrast = np.where(np.abs(x) <= reach_m[:, None], contrast, -np.inf)
    best = np.argmax(contrast, axis=1)
    rows = np.arange(len(x))
    peak = contrast[rows, best]
    peak = np.where(np.isfinite(peak), peak, -1.0)
    off_px = x[rows, best] * cuts.px_per_m
    usual = float(np.quantile(peak, 0.85))
    good = peak > _PAINTED * max(usual, 1e-6)
    if good.sum() < LEAST_CUTS:
        return -1.0, shape, np.zeros(len(x)), peak, 0.0
    curve = _consensus(cuts.arc_px, off_px, good)
    start = curve / cuts.px_per_m
    near = good & (np.abs(off_px - curve) < 1.5)
    size = np.sqrt(width_m * cuts.px_per_m[near]) if width_m else np.ones(near.sum())
    # what is there by chance is not there in a row
    usual = usual * min(1.0, near.sum() / max(0.5 * good.sum(), 1))
    return float(np.sum(peak[near] * size)), shape, start, np.where(near, peak, 0.0), usual


def _consensus(arc: Array, off_px: Array, good: NDArray[np.bool_]) -> Array:
    """Run a smooth curve (n,) through most of the places (n,) that are good."""
    u = 2 * (arc - arc[0]) / max(arc[-1] - arc[0], 1.0) - 1
    values = off_px[good]
    votes = (np.abs(values[:, None] - values[None, ::3]) < 1.0).sum(axis=0)
    curve = np.full(len(arc), values[::3][np.argmax(votes)])
    for degree, gate in ((0, 3.0), (1, 3.0), (1, 2.0), (2, 2.0), (3, 1.5), (3, 1.0), (3, 1.0)):
        near = good & (np.abs(off_px - curve) < gate)
        if near.sum() < 3 * (degree + 2):
            break
        weight = 1 / np.maximum(np.abs(off_px - curve)[near], 0.2)**0.5
        basis = legendre.legvander(u, degree)
        # ends without support stay where the middle is
        ridge = 0.02 * near.sum() * np.diag(np.arange(degree + 1.0))
        a = basis[near] * weight[:, None]
        curve = basis @ np.linalg.lstsq(
            np.vstack([a, np.sqrt(ridge) * 0.1]),
            np.append(off_px[near] * weight, np.zeros(degree + 1)), rcond=None)[0]
    return curve


def _spread_best(contrast: Array, count: int) -> NDArray[np.bool_]:
    """Choose up to so many cuts of good contrast, evenly along the line."""
    usual = np.quantile(contrast[contrast > 0], 0.7)
    good = np.flatnonzero(contrast > 0.7 * usual)
    chosen = good[np.unique(np.linspace(0, len(good) - 1, count).astype(int))]
    out = np.zeros(len(contrast), dtype=bool)
    out[chosen] = True
    return out


def _gathered(fit: RoadFit, line: int, right: bool, cuts: Cuts, places: Places, shape: Shape,
              noise_grey: float) -> Optional[LocatedLine]:
    """Take the cuts of each stretch together."""
    off_px = places.across_m * cuts.px_per_m
    usual = np.quantile(places.contrast, 0.85)
    good = np.isfinite(off_px) & (places.contrast > _PAINTED * usual) & (
        places.contrast > max(_LEAST_CONTRAST * noise_grey, _LEAST_GREY) / 2)
    if good.sum() < 2 * LEAST_CUTS:
        return None
    good &= places.rms < 4 * np.median(places.rms[good])
    rough = _consensus(cuts.arc_px, off_px, good)
    good &= np.abs(off_px - rough) < 1.5
    if good.sum() < 2 * LEAST_CUTS:
        return None
    length = cuts.arc_px[-1] - cuts.arc_px[0]
    size = max(length / MOST_STRETCHES, LEAST_STRETCH_PX)
    stretch = ((cuts.arc_px - cuts.arc_px[0]) / size).astype(int)
    points, used = [], 0
    for number in np.unique(stretch[good]):
        mine = np.flatnonzero(good & (stretch == number))
        point = _stretch(cuts.arc_px[mine], off_px[mine])
        if point is not None:
            arc, off, std, count = point
            used += count
            points.append((np.interp(arc, cuts.arc_px, cuts.s_m),
                           off / np.interp(arc, cuts.arc_px, cuts.px_per_m), std))
    if len(points) < 3:
        return None
    s, across, std = np.array(points).T
    uv = fit.seen(fit.points(line, s, across), right)
    scatter = 1.4826 * float(np.median(np.abs((off_px - rough)[good])))
    return LocatedLine(uv, std, s, shape, scatter, len(good), used)


def _stretch(arc: Array, off: Array) -> Optional[tuple[float, float, float, int]]:
    """
    Take cuts together: place along and across the line, 1-sigma, all px, and how many count.

    :param arc: (n,) px along the line.
    :param off: (n,) px across it.
    """
    if len(arc) < LEAST_CUTS:
        return None
    weight = np.ones(len(arc))
    fitted = np.full(len(arc), np.median(off))
    for _ in range(6):
        spread = max(1.4826 * float(np.median(np.abs(off - fitted))), 0.02)
        weight = np.clip(2.0 * spread / np.maximum(np.abs(off - fitted), 1e-9), 0, 1)
        weight[np.abs(off - fitted) > 4 * spread] = 0.0
        middle = np.average(arc, weights=weight)
        lever = arc - middle
        a = np.stack([np.ones(len(arc)), lever / 20.0], axis=-1)
        # a slope only as far as the model of the road may be wrong
        normal = a.T @ (weight[:, None] * a) + np.diag([0.0, (spread / 0.3)**2])
        solution = np.linalg.solve(normal, a.T @ (weight * off))
        fitted = a @ solution
    count = float(weight.sum())
    if count < LEAST_CUTS:
        return None
    left = np.sqrt(np.sum(weight * (off - fitted)**2) / max(count - 2, 1))
    std = float(np.hypot(left * np.sqrt(_CORRELATED / count), FLOOR_PX))
    return float(middle), float(solution[0]), std, int(round(count))
