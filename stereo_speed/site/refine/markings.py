# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Location of a lane marking or kerb along one line in one raw view, to a few hundredths of a pixel.

The line is first searched as a whole near the rough clicks, as a band or an edge that keeps its
distance from them over its whole length; objects in front of it do not. Then each cross-section
is measured separately, those without a marking are left out by their contrast, and the
cross-sections of each segment of the line are combined, with a 1-sigma from their own scatter.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Mapping, NamedTuple, Optional, Sequence

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from .config import RefineConfig
from .cross_sections import CrossSections, LineView
from .section_model import (
    BAND, BAND_SHARE, detect, EDGE, fit_sections, least_contrast_grey, Places, Shape, tuned)
from ...core.records import Array
from ...estimation.robust import robust_std

WIDTHS_M = (0.08, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3)  # widths of common markings
MOST_SEGMENTS, LEAST_SEGMENT_PX = 40, 9.0  # more or shorter segments would share their errors
LEAST_SECTIONS = 4  # fewest cross-sections of a segment, for place, slope and scatter
TUNED_SECTIONS = 60  # cross-sections used to find width and blur; more add little

# The search for the line as a whole.
_SEARCH_SAMPLES = 81  # least number of samples of a cross-section, half a pixel apart or more
_SAMPLES_PER_PX = 4  # samples per px of a wide search, to either side
_SIDE_M = 0.4  # width of road read beyond the search range, for the sides of wide bands
_READ_SHARE = 0.45  # share of the distance to the next line that may be read
_LEAST_READ_M = 0.3  # width that is read even if lines are closer
_START_BLUR_PX = 0.6  # initial blur, that of a pixel and a good lens
_USUAL_QUANTILE = 0.85  # of contrasts; its value is the usual one, as dashes cover a quarter
_NEAR_PX = 1.5  # largest distance of a place of the line from the smooth curve through it
_COHERENT_SHARE = 0.5  # of places near one curve; below it contrast counts less, as for noise

# The smooth curve through the places of a line.
_VOTE_PX = 1.0  # distance within which places vote for each other
_VOTE_EVERY = 3  # step between candidates of the vote; neighbours get the same votes
_GATES = ((0, 3.0), (1, 3.0), (1, 2.0), (2, 2.0), (3, 1.5), (3, 1.0), (3, 1.0))  # degree, px
_POINTS_PER_TERM = 3  # fewest places per coefficient of the curve
_FLAT_PX = 0.2  # deviation below which all places have the same weight
_RIDGE = 0.02, 0.1  # regularises the higher terms, so that ends without support stay flat

# Width and blur.
_GOOD = 0.7  # quantile of the contrasts, and share of it, from which a cross-section is chosen

# Segments.
_SAMPLES = 37  # samples of a cross-section for measuring, a quarter of a pixel apart
_MOST_RMS = 4.0  # residual, in usual ones, from which a cross-section shows something else
_ROUNDS = 6  # rounds of reweighting
_HUBER, _STRAY = 2.0, 4.0  # sigmas from which cross-sections get less weight, and none
_LEAST_SPREAD_PX = 0.02  # lower bound of the scatter, which exact images would undercut
# 1-sigma of the slope of a line in its segment: the road may be wrong by so much over so far.
_SLOPE_PX, _SLOPE_LEVER_PX = 0.3, 20.0


@dataclass(frozen=True, eq=False)
class LocatedLine:
    """
    One line as found in one view.

    :param uv_px: (n, 2) raw pixels in the middle of the band or on the edge, in order.
    :param std_px: (n,) 1-sigmas across the line, px.
    :param s_m: (n,) reference arc lengths of the points, m.
    :param shape: shape of the cross-sections.
    :param scatter_px: robust scatter of single cross-sections, px.
    :param sections: number of cross-sections.
    :param used: number of cross-sections that the points are made of.
    :param clicked: (n,) whether a point was not found but clicked, apart from what displaces all
        clicks; None where none was.
    """

    uv_px: Array
    std_px: Array
    s_m: Array
    shape: Shape
    scatter_px: float
    sections: int
    used: int
    clicked: Optional[NDArray[np.bool_]] = None

    @property
    def is_clicked(self) -> NDArray[np.bool_]:
        """Return whether each point (n,) was not found but clicked."""
        return np.zeros(len(self.s_m), dtype=bool) if self.clicked is None else self.clicked

    def take(self, where: NDArray[np.bool_] | NDArray[np.intp]) -> LocatedLine:
        """Return the line with the points of a mask, or of indices in their order."""
        return replace(self, uv_px=self.uv_px[where], std_px=self.std_px[where],
                       s_m=self.s_m[where], clicked=self.is_clicked[where])


Found = Mapping[str, tuple[LocatedLine, LocatedLine]]  # lines in the left and the right view


class _Candidate(NamedTuple):
    """
    One kind of line, followed over all cross-sections.

    :param score: sum of its contrasts.
    :param sections: the cross-sections.
    :param shape: its rough shape.
    :param start_m: (n,) its place on each cross-section, m.
    :param contrast: (n,) contrast there, grey levels; 0 where it is not seen.
    :param usual: usual contrast where it is painted, grey levels.
    """

    score: float
    sections: CrossSections
    shape: Shape
    start_m: Array
    contrast: Array
    usual: float

    @property
    def rough(self) -> tuple[CrossSections, Shape, Array, Array]:
        """Return cross-sections, shape, places and contrasts, to measure the line from."""
        return self.sections, self.shape, self.start_m, self.contrast


class _Candidates(NamedTuple):
    """
    What may be a line in one view.

    :param bands: best light and best dark band.
    :param edges: edge that is lighter on its left, and on its right.
    :param edge_grey: usual contrast of the best edge, be it one of light, grey levels.
    :param least: least usual contrast of a line that is there, grey levels.
    """

    bands: Sequence[_Candidate]
    edges: Sequence[_Candidate]
    edge_grey: float
    least: float

    def is_seen(self, one: _Candidate) -> bool:
        """Return whether the contrast of a candidate is that of a line."""
        return one.usual >= (self.least if one.shape.kind == EDGE else max(
            self.least, BAND_SHARE * self.edge_grey))

    @property
    def best(self) -> Optional[_Candidate]:
        """Return a band if there is one, else an edge."""
        return next((one for one in (_highest(self.bands), _highest(self.edges))
                     if self.is_seen(one)), None)


class _Segment(NamedTuple):
    """
    The combined cross-sections of a segment of a line.

    :param arc_px: place along the line in the image, px.
    :param off_px: place across the line, px.
    :param std_px: 1-sigma of ``off_px``, px.
    :param used: effective number of cross-sections.
    """

    arc_px: float
    off_px: float
    std_px: float
    used: int


def locate(view: LineView, ends_px: Array, shape: Optional[Shape] = None,
           config: RefineConfig = RefineConfig()) -> Optional[LocatedLine]:
    """
    Find a line in a view.

    :param view: the line, in a road that is correct to some pixels.
    :param ends_px: (2, 2) approximate ends of the line, raw pixels.
    :param shape: shape of its cross-sections from an earlier search, after which the line is known
        to about a pixel; None to search for it.
    :param config: parameters of search and measurement.
    :return: None if no marking runs along the rough line.
    """
    sections = view.sections(ends_px, config.steady_share)
    if shape is None:
        found = _search(view, sections, config).best
        return None if found is None else _measured(view, *found.rough, config)
    sections = sections.take(_trusted(shape, sections))
    if len(sections.s_m) < 2 * LEAST_SECTIONS:
        return None
    start = np.zeros(len(sections.s_m))
    x, grey = _read(view, sections, start, shape)
    contrast = fit_sections(shape, x, grey, sections.px_per_m, start, view.noise_grey).contrast
    return _measured(view, sections, shape, start, contrast, config)


def locate_both(views: Sequence[LineView], ends_px: Sequence[Array],
                before: Optional[tuple[LocatedLine, LocatedLine]] = None,
                config: RefineConfig = RefineConfig()
                ) -> Optional[tuple[LocatedLine, LocatedLine]]:
    """
    Find a line in both views, as a line of the same kind.

    Where a shadow lies along a marking, a band may be most conspicuous in one view and an edge in
    the other. They are not the same place on the road, and a rig whose right camera has rotated
    would see such a pair.

    :param views: the line in the left and in the right view, as for :func:`locate`.
    :param ends_px: its approximate ends in each view, as for :func:`locate`.
    :param before: the line as found along a worse road; None to search for it.
    :param config: parameters of search and measurement.
    :return: None if no such marking runs along the rough line in both views.
    """
    if before is not None:
        found = [locate(view, ends, line.shape, config)
                 for view, ends, line in zip(views, ends_px, before)]
    else:
        rough = _of_one_kind([
            _search(view, view.sections(ends, config.steady_share), config)
            for view, ends in zip(views, ends_px)])
        found = [_measured(view, *one.rough, config) for view, one in zip(views, rough)]
    both = [line for line in found if line is not None]
    return (both[0], both[1]) if len(both) == 2 else None


def _trusted(shape: Shape, sections: CrossSections) -> NDArray[np.bool_]:
    """
    Return which cross-sections (n,) can show a line of some shape.

    Where headlamps sweep the road, only light bands are paint. An edge, or what is darker than
    its sides, may be their light.
    """
    return ~sections.swept | (shape.kind == BAND and shape.sign > 0)


def _measured(view: LineView, sections: CrossSections, shape: Shape, start: Array,
              contrast: Array, config: RefineConfig) -> Optional[LocatedLine]:
    """
    Return the line measured from about where it is; None if too few sections show it.

    :param start: (n,) about its place on each cross-section, m.
    :param contrast: (n,) contrast there, grey levels; 0 where it is not seen.
    """
    if not (contrast > 0).any():
        return None
    scale = sections.px_per_m
    best = _spread_best(contrast, TUNED_SECTIONS)
    x, grey = _read(view, sections.take(best), start[best], shape)
    shape = tuned(shape, x, grey, scale[best], start[best], view.noise_grey)
    x, grey = _read(view, sections, start, shape)
    places = fit_sections(shape, x, grey, scale, start, view.noise_grey)
    return _combined(view, sections, places, shape, config)


def _read(view: LineView, sections: CrossSections, start_m: Array, shape: Shape
          ) -> tuple[Array, Array]:
    """Return places and grey levels (n, k) around the expected line."""
    half = shape.half_window_m(sections.px_per_m)
    x = start_m[:, None] + half[:, None] * np.linspace(-1, 1, _SAMPLES)
    return x, view.read(sections, x)


def _search(view: LineView, sections: CrossSections, config: RefineConfig) -> _Candidates:
    """Return what may be the line."""
    offsets = view.fit.problem.model.offsets(view.fit.x)
    apart = np.abs(np.delete(offsets, view.line) - offsets[view.line])
    read_m = _READ_SHARE * float(apart.min()) if apart.size else np.inf
    scale = sections.px_per_m
    half = np.minimum(config.search_px / scale + _SIDE_M, max(read_m, _LEAST_READ_M))
    samples = max(_SEARCH_SAMPLES, int(_SAMPLES_PER_PX * config.search_px))
    x = half[:, None] * np.linspace(-1, 1, samples)
    grey = view.read(sections, x)
    within = np.abs(x) <= np.minimum(config.search_px / scale, half)[:, None]

    def follow(width_m: float, everywhere: bool = False) -> list[_Candidate]:
        out = []
        for contrast, sign in zip(detect(x, grey, scale, width_m), (1, -1)):
            shape = Shape(BAND if width_m else EDGE, width_m, _START_BLUR_PX, sign)
            where = np.ones(len(x), dtype=bool) if everywhere else _trusted(shape, sections)
            out.append(_follow(x[where], np.where(within, contrast, -np.inf)[where],
                               sections.take(where), shape, config))
        return out

    bands, edges = [follow(width_m) for width_m in WIDTHS_M], follow(0.0)
    anywhere = follow(0.0, everywhere=True) if sections.swept.any() else edges
    return _Candidates([_highest(of_sign) for of_sign in zip(*bands)], edges,
                       _highest(anywhere).usual, least_contrast_grey(view.noise_grey))


def _of_one_kind(views: Sequence[_Candidates]) -> list[_Candidate]:
    """
    Return the best candidate in each view if these are of one kind, else the best pair that is.

    :return: empty if there is no such pair.
    """
    best = [view.best for view in views]
    found = [one for one in best if one is not None]
    if len(found) < len(best):
        return []
    if len({(one.shape.kind, one.shape.sign) for one in found}) == 1:
        return found
    for of_kind in ([view.bands for view in views], [view.edges for view in views]):
        pairs = [list(pair) for pair in zip(*of_kind)
                 if all(view.is_seen(one) for view, one in zip(views, pair))]
        if pairs:
            return max(pairs, key=lambda pair: sum(one.score for one in pair))
    return []


def _highest(candidates: Sequence[_Candidate]) -> _Candidate:
    return max(candidates, key=lambda candidate: candidate.score)


def _follow(x: Array, contrast: Array, sections: CrossSections, shape: Shape,
            config: RefineConfig) -> _Candidate:
    """
    Follow one kind of line over all cross-sections.

    :param x: (n, k) places on the cross-sections, m.
    :param contrast: (n, k) contrasts there; -inf outside the search range.
    """
    if len(x) < 2 * LEAST_SECTIONS:
        return _Candidate(-1.0, sections, shape, np.zeros(len(x)), np.zeros(len(x)), 0.0)
    best = np.argmax(contrast, axis=1)
    rows = np.arange(len(x))
    peak = contrast[rows, best]
    peak = np.where(np.isfinite(peak), peak, -1.0)
    off_px = x[rows, best] * sections.px_per_m
    usual = float(np.quantile(peak, _USUAL_QUANTILE))
    good = peak > config.painted_share * max(usual, 1e-6)
    if good.sum() < LEAST_SECTIONS:
        return _Candidate(-1.0, sections, shape, np.zeros(len(x)), peak, 0.0)
    curve = _consensus(sections.arc_px, off_px, good)
    near = good & (np.abs(off_px - curve) < _NEAR_PX)
    size = np.sqrt(shape.width_m * sections.px_per_m[near]) if shape.width_m else np.ones(
        near.sum())
    usual = usual * min(1.0, near.sum() / max(_COHERENT_SHARE * good.sum(), 1))
    return _Candidate(float(np.sum(peak[near] * size)), sections, shape, curve / sections.px_per_m,
                      np.where(near, peak, 0.0), usual)


def _consensus(arc_px: Array, off_px: Array, good: NDArray[np.bool_]) -> Array:
    """Return a smooth curve (n,) through the majority of the good places (n,)."""
    u = 2 * (arc_px - arc_px[0]) / max(arc_px[-1] - arc_px[0], 1.0) - 1
    values = off_px[good]
    candidates = values[::_VOTE_EVERY]
    votes = (np.abs(values[:, None] - candidates[None]) < _VOTE_PX).sum(axis=0)
    curve = np.full(len(arc_px), candidates[np.argmax(votes)])
    for degree, gate in _GATES:
        near = good & (np.abs(off_px - curve) < gate)
        if near.sum() < _POINTS_PER_TERM * (degree + 2):
            break
        weight = 1 / np.maximum(np.abs(off_px - curve)[near], _FLAT_PX)**0.5
        basis = legendre.legvander(u, degree)
        ridge = _RIDGE[0] * near.sum() * np.diag(np.arange(degree + 1.0))
        a = basis[near] * weight[:, None]
        curve = basis @ np.linalg.lstsq(
            np.vstack([a, np.sqrt(ridge) * _RIDGE[1]]),
            np.append(off_px[near] * weight, np.zeros(degree + 1)), rcond=None)[0]
    return curve


def _spread_best(contrast: Array, count: int) -> NDArray[np.bool_]:
    """Return a mask (n,) of up to so many cross-sections of good contrast, evenly spread."""
    usual = np.quantile(contrast[contrast > 0], _GOOD)
    good = np.flatnonzero(contrast > _GOOD * usual)
    chosen = good[np.unique(np.linspace(0, len(good) - 1, count).astype(int))]
    out = np.zeros(len(contrast), dtype=bool)
    out[chosen] = True
    return out


def _combined(view: LineView, sections: CrossSections, places: Places, shape: Shape,
              config: RefineConfig) -> Optional[LocatedLine]:
    """Return the line from its combined segments; None if too few cross-sections show it."""
    arc, off_px = sections.arc_px, places.across_m * sections.px_per_m
    usual = np.quantile(places.contrast, _USUAL_QUANTILE)
    good = np.isfinite(off_px) & (places.contrast > config.painted_share * usual) & (
        places.contrast > least_contrast_grey(view.noise_grey) / 2)
    if good.sum() < 2 * LEAST_SECTIONS:
        return None
    good &= places.rms < _MOST_RMS * np.median(places.rms[good])
    rough = _consensus(arc, off_px, good)
    good &= np.abs(off_px - rough) < _NEAR_PX
    if good.sum() < 2 * LEAST_SECTIONS:
        return None
    size = max((arc[-1] - arc[0]) / MOST_SEGMENTS, LEAST_SEGMENT_PX)
    number = ((arc - arc[0]) / size).astype(int)
    groups = (np.flatnonzero(good & (number == n)) for n in np.unique(number[good]))
    segments = [s for s in (_segment(arc[g], off_px[g], config) for g in groups) if s is not None]
    if len(segments) < 3:
        return None
    at = np.array([s.arc_px for s in segments])
    s_m, px_per_m = (np.interp(at, arc, values) for values in (sections.s_m, sections.px_per_m))
    across_m = np.array([s.off_px for s in segments]) / px_per_m
    beside_px = np.interp(at, arc[good], places.uneven[good]) * shape.displaced_px(px_per_m)
    return LocatedLine(
        view.seen(s_m, across_m), np.hypot([s.std_px for s in segments], beside_px), s_m, shape,
        robust_std((off_px - rough)[good]), len(good), sum(s.used for s in segments))


def _segment(arc: Array, off: Array, config: RefineConfig) -> Optional[_Segment]:
    """
    Return a segment of combined cross-sections; None if too few agree.

    :param arc: (n,) places along the line, px.
    :param off: (n,) places across the line, px.
    """
    if len(arc) < LEAST_SECTIONS:
        return None
    fitted = np.full(len(arc), np.median(off))
    for _ in range(_ROUNDS):
        spread = max(robust_std(off - fitted), _LEAST_SPREAD_PX)
        weight = np.clip(_HUBER * spread / np.maximum(np.abs(off - fitted), 1e-9), 0, 1)
        weight[np.abs(off - fitted) > _STRAY * spread] = 0.0
        middle = np.average(arc, weights=weight)
        a = np.stack([np.ones(len(arc)), (arc - middle) / _SLOPE_LEVER_PX], axis=-1)
        normal = a.T @ (weight[:, None] * a) + np.diag([0.0, (spread / _SLOPE_PX)**2])
        solution = np.linalg.solve(normal, a.T @ (weight * off))
        fitted = a @ solution
    count = float(weight.sum())
    if count < LEAST_SECTIONS:
        return None
    rms = np.sqrt(np.sum(weight * (off - fitted)**2) / max(count - 2, 1))
    std = float(np.hypot(rms * np.sqrt(config.correlated_sections / count), config.floor_std_px))
    return _Segment(float(middle), float(solution[0]), std, int(round(count)))
