# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of known lengths with those measured in the refined site."""
from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from .refiner import RefinedSite
from ..extras import DashPeriod, LinesApart, PointsApart
from ...core.records import Array

_SAMPLES = 9  # samples across a dash
_INNER = 1 / 3  # half width of the part of a dash that is read, as a share of the dash's width
_STEP_PX = 0.1  # step for finite differences by a clicked point
_GAP, _DASH = 0.1, 0.95  # quantiles of the grey levels along a dashed line for gap and dash
_MOST_STEP = 0.1  # largest spacing, in periods, of two cross-sections that enclose a dash end
_LEAST_ENDS = 3  # fewest ends of dashes for a spacing, as two have no scatter
_END_STD_M = 0.01  # lower bound of the 1-sigma of the end of a dash


@dataclass(frozen=True)
class LengthCheck:
    """
    A known length compared with the measured one.

    :param name: name of the length.
    :param known_m: known length, m.
    :param known_std_m: its 1-sigma, m.
    :param measured_m: length measured in the site, m; NaN if it cannot be measured.
    :param measured_std_m: its 1-sigma, m.
    :param most_sigmas: largest difference that is acceptable, in combined sigmas.
    """

    name: str
    known_m: float
    known_std_m: float
    measured_m: float
    measured_std_m: float
    most_sigmas: float

    @property
    def off_sigmas(self) -> float:
        """Return the difference of measured and known length, in combined sigmas."""
        return (self.measured_m - self.known_m) / math.hypot(
            self.known_std_m, self.measured_std_m)

    @property
    def wrong(self) -> bool:
        """Return whether the difference is larger than acceptable."""
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
    """Return the relative 1-sigma of all lengths by the drift of the right camera."""
    return max((lane.scale_std for lane in refined.lanes.values()), default=0.0)


def _between(refined: RefinedSite, names: tuple[str, str]) -> tuple[float, float]:
    """Return the distance of two lines across the road and its 1-sigma, m."""
    road = refined.road_with(names)
    if road is None:
        return math.nan, math.nan
    length, std = road.spacing(road.number(names[0]), road.number(names[1]))
    return length, math.hypot(std, length * _scale_std(refined))


def _two_points(refined: RefinedSite, points: PointsApart) -> tuple[float, float]:
    """Return the distance of two points picked in both views and its 1-sigma, m."""
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
    """Return the length of a dash with its gap, from both views, and its 1-sigma, m."""
    road = refined.road_with([name])
    if road is None or name not in refined.found:
        return math.nan, math.nan
    spacings = []
    for right, ends in enumerate(refined.rough.picked[name].views_px):
        view = refined.line_view(road, name, bool(right))
        sections = view.sections(ends[[0, -1]])
        half = refined.found[name][right].shape.width_m * _INNER
        x = np.tile(half * np.linspace(-1, 1, _SAMPLES), (len(sections.s_m), 1))
        grey = np.nanmean(view.read(sections, x), axis=1)
        spacings += [spacing_of(dash_ends(sections.s_m, grey, rising, expected_m), expected_m)
                     for rising in (True, False)]
    values = np.array([spacing for spacing in spacings if np.isfinite(spacing[0])])
    if not len(values):
        return math.nan, math.nan
    weight = values[:, 1]**-2
    mean = float(np.average(values[:, 0], weights=weight))
    spread = float(np.sqrt(1 / weight.sum()))
    # A line on the outside of a curve is longer than the reference line.
    ends = road.points(road.number(name), np.array([-0.5, 0.5]), np.zeros(2))
    mean *= float(np.linalg.norm(ends[1] - ends[0]))
    return mean, math.hypot(spread, mean * _scale_std(refined))


def dash_ends(s: Array, grey: Array, rising: bool, expected_m: float) -> Array:
    """
    Return the reference arc lengths (m,) where the dashes of a line begin, or end.

    :param s: (n,) reference arc lengths, m; empty if the line is not seen.
    :param grey: (n,) grey levels there; NaN is ignored.
    :param rising: whether to return begins, in the order of arc lengths, instead of ends.
    :param expected_m: approximate length of a dash with its gap, m.
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
    Return the spacing of periodic places, some of which may be missing, and its 1-sigma, m.

    Both are NaN if the places are not periodic.

    :param places: (n,) places in ascending order, m.
    :param expected_m: approximate spacing, m.
    """
    if len(places) < _LEAST_ENDS:
        return math.nan, math.nan
    number = np.concatenate([[0.0], np.cumsum(np.round(np.diff(places) / expected_m))])
    if (np.diff(number) < 1).any():
        return math.nan, math.nan
    slope, intercept = np.polyfit(number, places, 1)
    residual = places - slope * number - intercept
    scatter = max(float(np.sqrt(np.sum(residual**2) / (len(places) - 2))), _END_STD_M)
    return float(slope), scatter / float(np.sqrt(np.sum((number - number.mean())**2)))
