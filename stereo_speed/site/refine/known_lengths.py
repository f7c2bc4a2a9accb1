# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Known lengths against what the refined site makes of them."""
from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from .refiner import RefinedSite
from ..extras import DashPeriod, LinesApart, PointsApart
from ...core.records import Array

_SAMPLES = 9  # across a dash
_INNER = 1 / 3  # of its width to either side that is read
_STEP_PX = 0.1  # of the differences by a clicked point
_GAP, _DASH = 0.1, 0.95  # quantiles of the grey levels along a dashed line
_MOST_STEP = 0.1  # periods between cross-sections; further apart they place no end of a dash
_LEAST_ENDS = 3  # of dashes; two have no scatter
_END_STD_M = 0.01  # no end of a dash is sharper


@dataclass(frozen=True)
class LengthCheck:
    """
    A known length and what was measured.

    :param name: of the length.
    :param known_m: what is known.
    :param known_std_m: its 1-sigma.
    :param measured_m: what the site makes of it; NaN where it cannot be seen.
    :param measured_std_m: its 1-sigma.
    :param most_sigmas: by which they may differ.
    """

    name: str
    known_m: float
    known_std_m: float
    measured_m: float
    measured_std_m: float
    most_sigmas: float

    @property
    def off_sigmas(self) -> float:
        """How far both are apart, in sigmas of both together."""
        return (self.measured_m - self.known_m) / math.hypot(
            self.known_std_m, self.measured_std_m)

    @property
    def wrong(self) -> bool:
        """Return whether they are further apart than chance allows."""
        return math.isfinite(self.measured_m) and not abs(self.off_sigmas) <= self.most_sigmas


def check_lengths(refined: RefinedSite) -> list[LengthCheck]:
    """
    Measure every known length of a site.

    :param refined: the site.
    """
    out = []
    for known in refined.site.known_lengths:
        if isinstance(known.of, LinesApart):
            value = _between(refined, known.of.lines)
        elif isinstance(known.of, DashPeriod):
            value = _period(refined, known.of.line, known.length_m)
        else:
            value = _two_points(refined, known.of)
        out.append(LengthCheck(known.name, known.length_m, known.std_m, *value,
                               refined.config.length_sigmas))
    return out


def _scale_std(refined: RefinedSite) -> float:
    """Return what the drift of the right camera leaves uncertain of all lengths, as a share."""
    return max((lane.scale_std for lane in refined.lanes.values()), default=0.0)


def _between(refined: RefinedSite, names: tuple[str, str]) -> tuple[float, float]:
    """Return the distance of two lines across the road, and its 1-sigma."""
    road = refined.road_with(names)
    if road is None:
        return math.nan, math.nan
    length, std = road.spacing(road.number(names[0]), road.number(names[1]))
    return length, math.hypot(std, length * _scale_std(refined))


def _two_points(refined: RefinedSite, points: PointsApart) -> tuple[float, float]:
    """Return the distance of two points picked in both views, and its 1-sigma."""
    rig, picks = refined.rig, np.stack([points.left_px, points.right_px])
    std = refined.prior.pick_std_px if points.pick_std_px is None else points.pick_std_px

    def length(uv: Array) -> float:
        ends = rig.triangulate(uv[0], uv[1])
        return float(np.linalg.norm(ends[1] - ends[0]))

    measured = length(picks)
    variance = (measured * _scale_std(refined))**2
    for index in np.ndindex(picks.shape):
        moved = picks.copy()
        moved[index] += _STEP_PX
        variance += ((length(moved) - measured) / _STEP_PX * std)**2
    return measured, math.sqrt(variance)


def _period(refined: RefinedSite, name: str, expected_m: float) -> tuple[float, float]:
    """Return the length of a dash and its gap, from both views, and its 1-sigma."""
    road = refined.road_with([name])
    if road is None or name not in refined.found:
        return math.nan, math.nan
    found = []
    for right, ends in enumerate(refined.rough.picked[name].views_px):
        view = refined.line_view(road, name, bool(right))
        sections = view.sections(ends[[0, -1]])
        half = refined.found[name][right].shape.width_m * _INNER
        x = np.tile(half * np.linspace(-1, 1, _SAMPLES), (len(sections.s_m), 1))
        grey = np.nanmean(view.read(sections, x), axis=1)
        found += [spacing_of(dash_ends(sections.s_m, grey, rising, expected_m), expected_m)
                  for rising in (True, False)]
    values = np.array([f for f in found if np.isfinite(f[0])])
    if not len(values):
        return math.nan, math.nan
    weight = values[:, 1]**-2
    mean = float(np.average(values[:, 0], weights=weight))
    spread = float(np.sqrt(1 / weight.sum()))
    # a line on the outside of a curve is longer than the reference
    ends = road.points(road.number(name), np.array([-0.5, 0.5]), np.zeros(2))
    mean *= float(np.linalg.norm(ends[1] - ends[0]))
    return mean, math.hypot(spread, mean * _scale_std(refined))


def dash_ends(s: Array, grey: Array, rising: bool, expected_m: float) -> Array:
    """
    Return where the dashes of a line begin, or end: reference arc lengths (m,).

    :param s: (n,) reference arc lengths; none where the line is not seen.
    :param grey: (n,) grey levels there; NaN does not count.
    :param rising: where they begin, in the order of arc lengths.
    :param expected_m: about the length of a dash and its gap.
    """
    good = np.isfinite(grey)
    if not good.any():
        return np.zeros(0)
    s, grey = s[good], grey[good]
    order = np.argsort(s)
    s, grey = s[order], grey[order]
    low, high = np.quantile(grey, [_GAP, _DASH])
    level = (low + high) / 2
    above = grey > level
    change = np.flatnonzero((~above[:-1] & above[1:]) if rising else (above[:-1] & ~above[1:]))
    change = change[(s[change + 1] - s[change]) < _MOST_STEP * expected_m]
    share = (level - grey[change]) / (grey[change + 1] - grey[change])
    return np.asarray(s[change] + share * (s[change + 1] - s[change]))


def spacing_of(places: Array, expected_m: float) -> tuple[float, float]:
    """
    Return the spacing of places that repeat, about as expected, and its 1-sigma.

    Some may be missing. NaN where they do not repeat.

    :param places: (n,) ascending.
    :param expected_m: about the spacing.
    """
    if len(places) < _LEAST_ENDS:
        return math.nan, math.nan
    number = np.concatenate([[0.0], np.cumsum(np.round(np.diff(places) / expected_m))])
    if (np.diff(number) < 1).any():
        return math.nan, math.nan
    slope, intercept = np.polyfit(number, places, 1)
    left = places - slope * number - intercept
    scatter = max(float(np.sqrt(np.sum(left**2) / (len(places) - 2))), _END_STD_M)
    return float(slope), scatter / float(np.sqrt(np.sum((number - number.mean())**2)))
