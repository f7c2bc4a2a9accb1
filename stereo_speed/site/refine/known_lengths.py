# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Known lengths against what the refined site makes of them."""
from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from .cross_sections import cuts_along, read_cuts, SplineImage
from .refiner import RefinedSite
from ..extras import KnownLength
from ...core.records import Array

OFF_SIGMAS = 3.0
_PATCH = 9  # samples across the paint


@dataclass(frozen=True)
class LengthCheck:
    """
    A known length and what was measured.

    :param name: of the length.
    :param known_m: what is known.
    :param known_std_m: its 1-sigma.
    :param measured_m: what the site makes of it; NaN where it cannot be seen.
    :param measured_std_m: its 1-sigma.
    """

    name: str
    known_m: float
    known_std_m: float
    measured_m: float
    measured_std_m: float

    @property
    def off_sigmas(self) -> float:
        """How far both are apart, in sigmas of both together."""
        return (self.measured_m - self.known_m) / math.hypot(
            self.known_std_m, self.measured_std_m)

    @property
    def wrong(self) -> bool:
        """Say whether they are further apart than chance allows."""
        return not abs(self.off_sigmas) <= OFF_SIGMAS if math.isfinite(self.measured_m) else False


def check_lengths(refined: RefinedSite) -> list[LengthCheck]:
    """
    Measure every known length of a site.

    :param refined: the site.
    """
    out = []
    for known in refined.site.known_lengths:
        if known.between is not None:
            value = _between(refined, known.between)
        elif known.dashes is not None:
            value = _period(refined, known.dashes, known.length_m)
        else:
            value = _two_points(refined, known)
        out.append(LengthCheck(known.name, known.length_m, known.std_m, *value))
    return out


def _scale_std(refined: RefinedSite) -> float:
    """Give what the turn of the right camera leaves uncertain of all lengths, as a share."""
    return max((lane.scale_std for lane in refined.lanes.values()), default=0.0)


def _between(refined: RefinedSite, names: tuple[str, str]) -> tuple[float, float]:
    """Measure the distance of two lines across the road."""
    road = refined.road
    if road is None or not set(names) <= set(refined.road_lines):
        return math.nan, math.nan
    a, b = (4 + refined.road_lines.index(n) for n in names)
    variance = road.covariance[a, a] + road.covariance[b, b] - 2 * road.covariance[a, b]
    length = abs(float(road.x[a] - road.x[b]))
    return length, math.hypot(math.sqrt(variance), length * _scale_std(refined))


def _two_points(refined: RefinedSite, known: KnownLength) -> tuple[float, float]:
    """Measure the distance of two points picked in both views."""
    rig, picks = refined.rig, np.stack([known.left_px, known.right_px])

    def length(uv: Array) -> float:
        ends = rig.triangulate(uv[0], uv[1])
        return float(np.linalg.norm(ends[1] - ends[0]))

    measured = length(picks)
    variance = (measured * _scale_std(refined))**2
    for index in np.ndindex(picks.shape):
        moved = picks.copy()
        moved[index] += 0.1
        variance += ((length(moved) - measured) / 0.1 * known.pick_std_px)**2
    return measured, math.sqrt(variance)


def _period(refined: RefinedSite, name: str, expected_m: float) -> tuple[float, float]:
    """Measure a dash and its gap: the period of the paint along a line, in both views."""
    road = refined.road
    if road is None or name not in refined.road_lines or name not in refined.found:
        return math.nan, math.nan
    number, found = refined.road_lines.index(name), []
    for right, view in enumerate(refined.views):
        line, picks = refined.rough.lines[name], ('left_px', 'right_px')[right]
        cuts = cuts_along(road, number, bool(right), getattr(line, picks)[[0, -1]])
        half = refined.found[name][right].shape.width_m / 3
        x = np.tile(half * np.linspace(-1, 1, _PATCH), (len(cuts.s_m), 1))
        grey = np.nanmean(read_cuts(
            SplineImage(view.image), road, number, bool(right), cuts, x), axis=1)
        starts = [_crossings(cuts.s_m, grey, rising, expected_m) for rising in (True, False)]
        found += [_spacing(s, expected_m) for s in starts]
    values = np.array([f for f in found if np.isfinite(f[0])])
    if not len(values):
        return math.nan, math.nan
    weight = values[:, 1]**-2
    mean = float(np.average(values[:, 0], weights=weight))
    spread = float(np.sqrt(1 / weight.sum()))
    # a line on the outside of a bend is longer than the reference
    ends = road.points(number, np.array([-0.5, 0.5]), np.zeros(2))
    mean *= float(np.linalg.norm(ends[1] - ends[0]))
    return mean, math.hypot(spread, mean * _scale_std(refined))


def _crossings(s: Array, grey: Array, rising: bool, expected_m: float) -> Array:
    """Find where the paint begins, or ends, along a line: reference arc lengths."""
    good = np.isfinite(grey)
    s, grey = s[good], grey[good]
    order = np.argsort(s)
    s, grey = s[order], grey[order]
    low, high = np.quantile(grey, [0.1, 0.95])
    level = (low + high) / 2
    above = grey > level
    change = np.flatnonzero((~above[:-1] & above[1:]) if rising else (above[:-1] & ~above[1:]))
    # where a step of the cuts is a good part of a dash nothing can be told
    change = change[(s[change + 1] - s[change]) < 0.1 * expected_m]
    share = (level - grey[change]) / (grey[change + 1] - grey[change])
    return s[change] + share * (s[change + 1] - s[change])


def _spacing(places: Array, expected_m: float) -> tuple[float, float]:
    """Give the spacing of places that repeat, about as expected, and its 1-sigma."""
    if len(places) < 3:
        return math.nan, math.nan
    number = np.concatenate([[0.0], np.cumsum(np.round(np.diff(places) / expected_m))])
    if (np.diff(number) < 1).any():
        return math.nan, math.nan
    slope, intercept = np.polyfit(number, places, 1)
    left = places - slope * number - intercept
    scatter = max(float(np.sqrt(np.sum(left**2) / (len(places) - 2))), 0.01)
    return float(slope), scatter / float(np.sqrt(np.sum((number - number.mean())**2)))
