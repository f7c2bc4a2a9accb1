# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What a refinement has to say: figures of every line and lane, and warnings."""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from .known_lengths import check_lengths, LengthCheck
from .refiner import RefinedSite
from .speed_effect import heading_effect, speed_error
from ..lane_paths import lane_paths
from ...core.errors import SiteError
from ...core.units import MPH_MPS

FEW_PAIRS = 5
MUCH_PX = 0.15  # r.m.s. residual of paint that deserves a look
MAY_HAVE_MOVED = 0.2  # probability that deserves a word
MUCH_SHARE = 0.0025  # 1-sigma of speeds, or their change, that deserves a word
ANGLES = ('pan', 'tilt', 'roll')


@dataclass(frozen=True)
class LineFigures:
    """
    One line.

    :param name: of the line.
    :param kind: ``band``, ``edge``, ``as clicked`` or ``surveyed``.
    :param width_m: of the paint.
    :param residual_px: r.m.s. distance of the points from the fitted road, each counting as its
        1-sigma says, left and right.
    :param scatter_px: of single cuts about the line, left and right.
    :param points: number of points, left and right.
    :param painted: share of the line with paint in sight, left and right.
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
    One lane.

    :param name: of the lane.
    :param width_m: between its lines; NaN without two.
    :param width_std_m: its 1-sigma.
    :param limit_mps: its speed limit.
    :param change: of measured speeds by the refinement, as a share; NaN where the clicks alone
        make no lane.
    :param std: 1-sigma of measured speeds by path and rig together, as a share.
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
    Everything that is told.

    :param lines: figures of the lines.
    :param lanes: figures of the lanes.
    :param lengths: known lengths checked.
    :param warnings: one sentence each.
    """

    lines: tuple[LineFigures, ...]
    lanes: tuple[LaneFigures, ...]
    lengths: tuple[LengthCheck, ...]
    warnings: tuple[str, ...]


def report(refined: RefinedSite) -> Report:
    """
    Gather the figures of a refined site.

    :param refined: the site.
    """
    lines = tuple(_line(refined, name) for name in refined.site.lines)
    lanes = tuple(_lanes(refined))
    lengths = tuple(check_lengths(refined))
    return Report(lines, lanes, lengths, tuple(_warnings(refined, lines, lanes, lengths)))


def _line(refined: RefinedSite, name: str) -> LineFigures:
    """Gather the figures of one line."""
    nothing = (math.nan, math.nan)
    if name not in refined.found:
        kind = 'surveyed' if refined.site.lines[name].points_m is not None else 'as clicked'
        return LineFigures(name, kind, math.nan, nothing, nothing, (0, 0), (0.0, 0.0))
    found = refined.found[name]
    residual = [math.nan, math.nan]
    if refined.road is not None and name in refined.road_lines:
        picks = refined.road.problem.picks
        for right in (0, 1):
            mine = (picks.line == refined.road_lines.index(name)) & (picks.right == bool(right))
            weight = picks.std_px[mine]**-2
            residual[right] = float(np.sqrt(np.average(
                refined.road.feet.residual_px[mine]**2, weights=weight)))
    return LineFigures(
        name, found[0].shape.kind, found[0].shape.width_m, (residual[0], residual[1]),
        (found[0].scatter_px, found[1].scatter_px), (len(found[0].s_m), len(found[1].s_m)),
        (found[0].used / found[0].cuts, found[1].used / found[1].cuts))


def _lanes(refined: RefinedSite) -> list[LaneFigures]:
    """Gather the figures of the lanes."""
    calibrated = refined.rig.turned(-np.array(refined.rig.turn_rad))
    before = refined.rough.corrected_rig(calibrated)
    try:
        rough = lane_paths(refined.rough, before)
    except SiteError:
        rough = {}
    out = []
    for spec in refined.site.lanes:
        lane = refined.lanes[spec.name]
        width = (math.nan, math.nan)
        road = refined.road
        if road is not None and len(spec.lines) == 2 and set(spec.lines) <= set(
                refined.road_lines):
            a, b = (4 + refined.road_lines.index(n) for n in spec.lines)
            c = road.covariance
            width = (abs(float(road.x[a] - road.x[b])),
                     float(np.sqrt(c[a, a] + c[b, b] - 2 * c[a, b])))
        change = math.nan
        if spec.name in rough:
            change = speed_error((lane.path, refined.rig), (rough[spec.name].path, before))
        heading = heading_effect(lane.path, refined.rig, lane.heading_std_rad)
        heading = 0.0 if math.isnan(heading) else heading
        out.append(LaneFigures(spec.name, *width, spec.speed_limit_mps, change,
                               math.hypot(lane.scale_std, heading)))
    return out


def _warnings(refined: RefinedSite, lines: tuple[LineFigures, ...],
              lanes: tuple[LaneFigures, ...], lengths: tuple[LengthCheck, ...]) -> list[str]:
    """Say what a person must know."""
    out = []
    turn = refined.turn
    if refined.views[0].pairs < FEW_PAIRS:
        out.append(f'only {refined.views[0].pairs} pairs: what passed may still be in the '
                   'background')
    for angle, value, left in zip(ANGLES, turn.turn_rad, np.sqrt(np.diag(turn.covariance_rad2))):
        if value:
            out.append(f'the right camera has moved since the calibration: {angle} '
                       f'{np.degrees(value):+.4f}° ± {np.degrees(left):.4f}°; refining corrects '
                       'it, but calibrate the rig again')
    if not turn.moved and turn.moved_probability > MAY_HAVE_MOVED:
        out.append('the right camera may have moved since the calibration (probability '
                   f'{turn.moved_probability:.2f}); nothing is corrected, speeds are the more '
                   'uncertain for it')
    before = refined.rough.correction
    if before is not None:
        step = turn.turn_rad - before.turn_rad
        std = np.sqrt(np.diag(turn.covariance_rad2 + before.covariance_rad2))
        out += [f'the right camera has moved since the site was refined: {angle} '
                f'{np.degrees(change):+.4f}° ± {np.degrees(sigma):.4f}°; refine it again'
                for angle, change, sigma in zip(ANGLES, step, std) if abs(change) > 3 * sigma]
    for lane in lanes:
        if lane.std > MUCH_SHARE:
            out.append(f'{lane.name}: path and rig leave speeds uncertain by {100 * lane.std:.2f} '
                       f'% (± {lane.std * lane.limit_mps / MPH_MPS:.2f} mph at the limit)')
    for name in refined.lost:
        out.append(f'{name}: neither paint nor kerb found in both views; left as it was clicked')
    for line in lines:
        worst = max(line.residual_px)
        if worst > MUCH_PX:
            out.append(f'{line.name}: paint {worst:.2f} px r.m.s. off the road that all lines '
                       'make together')
    for length in lengths:
        if length.wrong:
            out.append(f'{length.name}: {length.measured_m:.4f} m ± {length.measured_std_m:.4f} '
                       f'm found, {length.known_m:g} m ± {length.known_std_m:g} m known: '
                       f'{length.off_sigmas:+.1f} sigmas apart')
        elif not math.isfinite(length.measured_m):
            out.append(f'{length.name}: cannot be measured here')
    return out


def summary_lines(refined: RefinedSite, figures: Report) -> list[str]:
    """
    Put a report into words, a line each.

    :param refined: the site.
    :param figures: from :func:`report`.
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
        model = refined.road.problem.model
        kind = 'straight' if model.turns == 0 else f'curved ({model.turns} coefficients)'
        out.append(f'road: {kind}, {"plane" if model.bends == 0 else "bent"} surface')
    for lane in figures.lanes:
        mph = lane.limit_mps / MPH_MPS
        width = '' if math.isnan(lane.width_m) else \
            f'{lane.width_m:.4f} m ± {1e3 * lane.width_std_m:.1f} mm wide; '
        change = '' if math.isnan(lane.change) else \
            f'speeds by {100 * lane.change:+.3f} % ({lane.change * mph:+.3f} mph at the limit) ' \
            'before; '
        out.append(f'{lane.name}: {width}{change}1-sigma of path and rig '
                   f'{100 * lane.std:.3f} % ({lane.std * mph:.3f} mph)')
    for length in figures.lengths:
        if math.isfinite(length.measured_m):
            out.append(f'{length.name}: {length.measured_m:.4f} m ± {length.measured_std_m:.4f} m,'
                       f' known {length.known_m:g} m ± {length.known_std_m:g} m')
    return out + _rig_lines(refined) + [f'warning: {text}' for text in figures.warnings]


def summary(refined: RefinedSite, figures: Report) -> dict[str, Any]:
    """
    Give the figures that belong beside the results: plain values.

    :param refined: the site.
    :param figures: from :func:`report`.
    """
    turn = refined.turn
    left = np.degrees(np.sqrt(np.diag(turn.covariance_rad2)))
    return {
        'turn_deg': {a: round(float(v), 5) for a, v in zip(ANGLES, np.degrees(turn.turn_rad))},
        'turn_std_deg': {a: round(float(v), 5) for a, v in zip(ANGLES, left)},
        'moved_probability': round(turn.moved_probability, 4),
        'residual_px': {line.name: [round(v, 4) for v in line.residual_px]
                        for line in figures.lines if line.points[0]},
        'path_and_rig_std': {lane.name: round(lane.std, 6) for lane in figures.lanes},
        'warnings': list(figures.warnings)}


def _rig_lines(refined: RefinedSite) -> list[str]:
    """Say what the rig looks like."""
    turn, epipolar = refined.turn, refined.epipolar
    shown = ', '.join(f'{angle} {np.degrees(value):+.4f}° ± {np.degrees(std):.4f}°'
                      for angle, value, std in zip(ANGLES, turn.shown_rad, turn.shown_std_rad))
    out = [] if refined.road is None else [
        f'right camera against its calibration: {shown}; moved with probability '
        f'{turn.moved_probability:.3f}']
    if epipolar is not None:
        out.append(f'background: {epipolar.details} details {epipolar.residual_px:.3f} px off '
                   'their epipolar lines')
    return out


def _both(values: tuple[float, ...], form: str) -> str:
    """Print figures of both views."""
    return ' '.join(format(v, form) for v in values)
