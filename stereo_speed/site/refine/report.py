# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The report of a refinement: figures of every line and lane, and warnings."""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from .known_lengths import check_lengths, LengthCheck
from .refiner import RefinedSite
from .speed_effect import lane_speed_std, Setup, speed_error
from ..lane_paths import lane_paths
from ...core.errors import SiteError
from ...core.units import MPH_MPS

ANGLES = ('pan', 'tilt', 'roll')
_MUCH_SWEPT = 0.2  # share of the lines from which headlamps matter; vehicles by day sweep a tenth
_MOVED_SIGMAS = 3.0  # change of the drift since the site was refined from which to warn


@dataclass(frozen=True)
class LineFigures:
    """
    The figures of one line.

    :param name: name of the line.
    :param kind: ``band``, ``edge``, ``as clicked`` or ``surveyed``.
    :param width_m: width of the marking, m.
    :param residual_px: r.m.s. distance of the points from the fitted road, weighted by their
        1-sigmas, left and right, px.
    :param scatter_px: scatter of single cross-sections about the line, left and right, px.
    :param points: number of points, left and right.
    :param painted: share of the line with a visible marking, left and right.
    """

    name: str
    kind: str
    width_m: float
    residual_px: tuple[float, float]
    scatter_px: tuple[float, float]
    points: tuple[int, int]
    painted: tuple[float, float]


@dataclass(frozen=True)
class LaneFigures:
    """
    The figures of one lane.

    :param name: name of the lane.
    :param width_m: distance between its lines, m; NaN if it has not two lines on the road.
    :param width_std_m: its 1-sigma, m.
    :param limit_mps: speed limit, m/s.
    :param change: relative change of measured speeds by the refinement; NaN if the clicks alone
        give no lane.
    :param std: relative 1-sigma of measured speeds by path and rig together.
    """

    name: str
    width_m: float
    width_std_m: float
    limit_mps: float
    change: float
    std: float


@dataclass(frozen=True)
class Report:
    """
    The report of a refinement.

    :param lines: figures of the lines.
    :param lanes: figures of the lanes.
    :param lengths: checks of the known lengths.
    :param warnings: warnings, one sentence each.
    """

    lines: tuple[LineFigures, ...]
    lanes: tuple[LaneFigures, ...]
    lengths: tuple[LengthCheck, ...]
    warnings: tuple[str, ...]


def report(refined: RefinedSite) -> Report:
    """
    Return the report of a refined site.

    :param refined: the site.
    """
    lines = tuple(_line(refined, name) for name in refined.site.lines)
    lanes = tuple(_lanes(refined))
    lengths = tuple(check_lengths(refined))
    return Report(lines, lanes, lengths, tuple(_warnings(refined, lines, lanes, lengths)))


def _line(refined: RefinedSite, name: str) -> LineFigures:
    """Return the figures of one line."""
    unknown = (math.nan, math.nan)
    if name not in refined.found:
        kind = 'as clicked' if name in refined.site.picked else 'surveyed'
        return LineFigures(name, kind, math.nan, unknown, unknown, (0, 0), (0.0, 0.0))
    found = refined.found[name]
    residual = [math.nan, math.nan]
    road = refined.road_with([name])
    if road is not None:
        picks = road.problem.picks
        for right in (0, 1):
            rows = picks.of_line(road.number(name), bool(right))
            residual[right] = float(np.sqrt(np.average(
                road.feet.residual_px[rows]**2, weights=picks.std_px[rows]**-2)))
    return LineFigures(
        name, found[0].shape.kind, found[0].shape.width_m, (residual[0], residual[1]),
        (found[0].scatter_px, found[1].scatter_px), (len(found[0].s_m), len(found[1].s_m)),
        (found[0].used / found[0].sections, found[1].used / found[1].sections))


def _lanes(refined: RefinedSite) -> list[LaneFigures]:
    """Return the figures of the lanes."""
    calibrated = refined.rig.drifted(-np.array(refined.rig.drift_rad))
    before = refined.rough.corrected_rig(calibrated)
    try:
        rough = lane_paths(refined.rough, before, refined.prior)
    except SiteError:
        rough = {}
    out = []
    for spec in refined.site.lanes:
        lane = refined.lanes[spec.name]
        width = (math.nan, math.nan)
        road = refined.road_with(spec.lines)
        if road is not None and len(spec.lines) == 2:
            width = road.spacing(*(road.number(name) for name in spec.lines))
        change = math.nan
        if spec.name in rough:
            high = speed_error(Setup(lane.path, refined.rig), Setup(rough[spec.name].path, before))
            change = -high / (1 + high)
        out.append(LaneFigures(spec.name, *width, spec.speed_limit_mps, change,
                               lane_speed_std(lane, refined.rig)))
    return out


def _warnings(refined: RefinedSite, lines: tuple[LineFigures, ...],
              lanes: tuple[LaneFigures, ...], lengths: tuple[LengthCheck, ...]) -> list[str]:
    """Return the warnings."""
    config, out = refined.config, _rig_warnings(refined)
    swept = _swept_share(refined)
    if swept > _MUCH_SWEPT:
        out.append(f'headlamps sweep {100 * swept:.0f} % of the lines, which may displace what is '
                   'found by more than its 1-sigma: refine the site by day')
    if refined.views[0].pairs < config.few_pairs:
        out.insert(0, f'only {refined.views[0].pairs} pairs: the background may still show '
                   'passing vehicles')
    if refined.kept_clicks:
        out.append(f'lines kept as clicked: {refined.kept_clicks}')
    for lane in lanes:
        if lane.std > config.worst_speed_std:
            out.append(f'{lane.name}: 1-sigma of speeds by path and rig is {100 * lane.std:.2f} % '
                       f'({lane.std * lane.limit_mps / MPH_MPS:.2f} mph at the speed limit)')
    for name in refined.lost:
        out.append(f'{name}: no marking or kerb found at the clicks; line kept as clicked')
    for name in refined.partly_clicked:
        out.append(f'{name}: kept as clicked far away, where it is narrower than a pixel, as what '
                   'is found there for it or another line lies beside the clicks')
    for line in lines:
        worst = max(line.residual_px)
        if worst > config.worst_residual_px:
            out.append(f'{line.name}: marking lies {worst:.2f} px r.m.s. off the road fitted to '
                       'all lines')
    for length in lengths:
        if length.wrong:
            out.append(f'{length.name}: measured {length.measured_m:.4f} m ± '
                       f'{length.measured_std_m:.4f} m, known {length.known_m:g} m ± '
                       f'{length.known_std_m:g} m: {length.off_sigmas:+.1f} sigmas apart')
        elif not math.isfinite(length.measured_m):
            out.append(f'{length.name}: cannot be measured at this site')
    return out


def _swept_share(refined: RefinedSite) -> float:
    """Return the share of the found lines where the light changes over time, as by headlamps."""
    swept = [np.zeros(0, dtype=bool)]
    for name in refined.found:
        road = refined.road_with([name])
        if road is None:
            continue
        for right, uv in enumerate(refined.rough.picked[name].views_px):
            view = refined.line_view(road, name, bool(right))
            swept.append(view.sections(uv[[0, -1]], refined.config.steady_share).swept)
    every = np.concatenate(swept)
    return float(every.mean()) if len(every) else 0.0


def _rig_warnings(refined: RefinedSite) -> list[str]:
    """Return the warnings about the rig."""
    drift, out = refined.drift, []
    for angle, value, std in zip(ANGLES, drift.drift_rad, drift.std_rad):
        if value:
            out.append(f'the right camera has moved since the calibration: {angle} '
                       f'{np.degrees(value):+.4f}° ± {np.degrees(std):.4f}°; the refined '
                       'site corrects this, but calibrate the rig again')
    if not drift.moved and drift.moved_probability > refined.config.doubtful_probability:
        out.append('the right camera may have moved since the calibration (probability '
                   f'{drift.moved_probability:.2f}); this is not corrected but included in the '
                   '1-sigma of speeds')
    before = refined.rough.correction
    if before is not None:
        step = drift.drift_rad - before.drift_rad
        step_std = np.sqrt(np.diag(drift.covariance_rad2 + before.covariance_rad2))
        out += [f'the right camera has moved since the site was refined: {angle} '
                f'{np.degrees(change):+.4f}° ± {np.degrees(sigma):.4f}°; refine it again'
                for angle, change, sigma in zip(ANGLES, step, step_std)
                if abs(change) > _MOVED_SIGMAS * sigma]
    return out


def summary_lines(refined: RefinedSite, figures: Report) -> list[str]:
    """
    Return a report as lines of text.

    :param refined: the site.
    :param figures: its report, from :func:`report`.
    """
    views = refined.views
    out = [f'background of {views[0].pairs} pairs, noise {views[0].noise_grey:.1f} and '
           f'{views[1].noise_grey:.1f} grey levels',
           f'{"line":<14} {"kind":<10} {"width m":>8} {"residual px":>14} {"scatter px":>14} '
           f'{"points":>9} {"painted %":>11}']
    for line in figures.lines:
        if not line.points[0]:
            out.append(f'{line.name:<14} {line.kind}')
            continue
        out.append(f'{line.name:<14} {line.kind:<10} {line.width_m:>8.3f} '
                   f'{_both(line.residual_px, ".3f"):>14} {_both(line.scatter_px, ".3f"):>14} '
                   f'{_both(line.points, "d"):>9} '
                   f'{_both(tuple(100 * p for p in line.painted), ".0f"):>11}')
    if refined.road is not None:
        shape = refined.road.problem.model.shape
        kind = f'curved ({shape.curvature} coefficients)' if shape.curvature else 'straight'
        bent = [text for count, text in (
            (shape.tilt, 'grade and crossfall in the bend'),
            (shape.vertical, f'changing grade ({shape.vertical})'),
            (shape.twist, f'changing crossfall ({shape.twist})'),
            (shape.vertical_curve, 'vertical curve'), (shape.run_off, 'run-off')) if count]
        out.append(f'road: {kind}, {", ".join(bent) or "plane surface"}')
    for lane in figures.lanes:
        mph = lane.limit_mps / MPH_MPS
        width = '' if math.isnan(lane.width_m) else \
            f'{lane.width_m:.4f} m ± {1e3 * lane.width_std_m:.1f} mm wide; '
        change = '' if math.isnan(lane.change) else \
            f'refinement changes speeds by {100 * lane.change:+.3f} % ' \
            f'({lane.change * mph:+.3f} mph at the speed limit); '
        out.append(f'{lane.name}: {width}{change}1-sigma of path and rig '
                   f'{100 * lane.std:.3f} % ({lane.std * mph:.3f} mph)')
    for length in figures.lengths:
        if math.isfinite(length.measured_m):
            out.append(f'{length.name}: {length.measured_m:.4f} m ± {length.measured_std_m:.4f} m,'
                       f' known {length.known_m:g} m ± {length.known_std_m:g} m')
    return out + _rig_lines(refined) + [f'warning: {text}' for text in figures.warnings]


def summary(refined: RefinedSite, figures: Report) -> dict[str, Any]:
    """
    Return the figures that are stored with the results, as plain values.

    :param refined: the site.
    :param figures: its report, from :func:`report`.
    """
    drift = refined.drift
    return {
        'turn_deg': {a: round(float(v), 5) for a, v in zip(ANGLES, np.degrees(drift.drift_rad))},
        'turn_std_deg': {a: round(float(v), 5) for a, v in zip(ANGLES, np.degrees(drift.std_rad))},
        'moved_probability': round(drift.moved_probability, 4),
        'residual_px': {line.name: [round(v, 4) for v in line.residual_px]
                        for line in figures.lines if line.points[0]},
        'path_and_rig_std': {lane.name: round(lane.std, 6) for lane in figures.lanes},
        'kept_clicks': refined.kept_clicks,
        'warnings': list(figures.warnings)}


def _rig_lines(refined: RefinedSite) -> list[str]:
    """Return the lines of text about the rig."""
    drift, epipolar = refined.drift, refined.epipolar
    shown = ', '.join(f'{angle} {np.degrees(value):+.4f}° ± {np.degrees(std):.4f}°'
                      for angle, value, std in zip(ANGLES, drift.shown_rad, drift.shown_std_rad))
    out = [] if refined.road is None else [
        f'right camera against its calibration: {shown}; moved with probability '
        f'{drift.moved_probability:.3f}']
    if epipolar is not None:
        out.append(f'background: {epipolar.details} details {epipolar.residual_px:.3f} px off '
                   'their epipolar lines')
    return out


def _both(values: tuple[float, ...], form: str) -> str:
    """Return figures of both views as text."""
    return ' '.join(format(v, form) for v in values)
