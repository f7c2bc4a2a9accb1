# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reports on many passes: traffic statistics, and verification against a reference."""
from __future__ import annotations

from typing import Optional, Sequence

from matplotlib.figure import Figure
import numpy as np

from .page import page_html, Picture, Section
from .plots import new_figure, show_legend
from ..core.units import SpeedUnit
from ..survey.reference import COVERAGE, reliability_shown, Verification
from ..survey.traffic import PACE_MPS, TrafficGroup, Vehicle

_BLUE, _ORANGE, _GREY = '#0072b2', '#d55e00', '#5b6470'
_MOST_BINS = 60


def traffic_columns(unit: SpeedUnit) -> list[str]:
    """Return the column headings of a traffic report's table."""
    return ['', 'passes', 'measured', f'mean, {unit.name}', 'sd', 'median', '85th percentile',
            f'pace, {unit.name}', 'in the pace', 'greatest', 'over the limit']


def traffic_rows(groups: Sequence[TrafficGroup], unit: SpeedUnit) -> list[list[str]]:
    """Return the table rows of a traffic report, one for each group."""
    rows = []
    for one in groups:
        f = one.figures
        pace = '-' if f.pace_low_mps is None else (
            f'{unit.of(f.pace_low_mps, 1)} to {unit.of(f.pace_low_mps + PACE_MPS, 1)}')
        name = 'all' if one.by == 'all' else f'{one.by} {one.group}'
        rows.append([name, str(f.passes), str(f.measured), *(unit.of(v, 1) for v in (
            f.mean_mps, f.std_mps, f.median_mps, f.p85_mps)), pace, _percent(f.pace_share),
            unit.of(f.max_mps, 1), _percent(f.over_share)])
    return rows


def _percent(share: Optional[float]) -> str:
    return '-' if share is None else f'{100 * share:.1f} %'


def traffic_page(groups: Sequence[TrafficGroup], vehicles: Sequence[Vehicle], unit: SpeedUnit
                 ) -> str:
    """Return the report of the traffic as HTML."""
    pictures = [Picture.of('Distribution of the speeds', histogram(vehicles, unit))]
    if any(one.by == 'hour' for one in groups):
        pictures.append(Picture.of('By hour of the day', hours(groups, unit)))
    return page_html('Traffic', [
        Section('Figures', columns=traffic_columns(unit), rows=traffic_rows(groups, unit),
                text=['The pace is the 10 mph range that contains most vehicles. Rejected passes '
                      'have no speed and count as passes only.']),
        Section('Plots', pictures=pictures)])


def histogram(vehicles: Sequence[Vehicle], unit: SpeedUnit) -> Figure:
    """Draw a histogram of the speeds by lane."""
    figure, axes = new_figure(9.0, 4.2)
    lanes = sorted({v.lane for v in vehicles})
    speeds = [[v.speed_mps / unit.mps for v in vehicles
               if v.lane == lane and v.speed_mps is not None] for lane in lanes]
    known = [s for some in speeds for s in some]
    if known:
        low, high = np.floor(min(known)), np.ceil(max(known)) + 1e-9
        width = max(1.0, np.ceil((high - low) / _MOST_BINS))
        axes.hist(speeds, bins=np.arange(low, high + width, width).tolist(), stacked=True,
                  label=lanes)
    axes.set(xlabel=f'speed, {unit.name}', ylabel='vehicles')
    show_legend(figure, axes)
    return figure


def hours(groups: Sequence[TrafficGroup], unit: SpeedUnit) -> Figure:
    """Draw mean, 85th percentile and number of vehicles by hour of the day."""
    figure, axes = new_figure(9.0, 4.2)
    some = [g for g in groups if g.by == 'hour' and g.figures.mean_mps is not None]
    at = [int(g.group) for g in some]
    for name, colour, values in (
            ('mean', _BLUE, [g.figures.mean_mps for g in some]),
            ('85th percentile', _ORANGE, [g.figures.p85_mps for g in some])):
        axes.plot(at, [(v or 0.0) / unit.mps for v in values], 'o-', color=colour, label=name)
    axes.set(xlabel='hour of the day', ylabel=f'speed, {unit.name}', xlim=(-0.5, 23.5))
    right = axes.twinx()
    right.bar(at, [g.figures.measured for g in some], color=_GREY, alpha=0.2)
    right.set_ylabel('vehicles measured')
    show_legend(figure, axes)
    return figure


def verification_page(found: Verification, unit: SpeedUnit) -> str:
    """Return the report of a verification as HTML."""
    failures = found.counted - found.within
    verdict = 'within the limits of error' if found.is_within else (
        'not assessed, because none counts' if not found.counted
        else 'NOT within the limits of error')
    figures: list[tuple[str, str]] = [
        ('reference vehicles', str(len(found.matches))),
        ('errors counted', str(found.counted)),
        ('no pass found', str(found.without_pass)), ('pass rejected', str(found.rejected)),
        ('reference too uncertain', str(found.not_good_enough)),
        ('passes without a reference vehicle', str(found.strangers)),
        (f'mean error, {unit.name}', unit.signed(found.mean_mps, 3)),
        ('standard deviation', unit.of(found.std_mps, 3)),
        ('worst error relative to its limit', unit.signed(found.worst_mps, 3)),
        ('within ±3 km/h, ±3 % above 100 km/h', f'{found.within} of {found.counted}'),
        ('reliability demonstrated at 95 % confidence',
         f'{100 * reliability_shown(found.counted, failures):.2f} %')]
    return page_html('Verification against a reference', [
        Section('Result', text=[
            f'The errors are {verdict}.', 'A reference counts if its expanded uncertainty '
            f'({COVERAGE:g} of its 1-sigmas) is at most a third of the limit of error. Speeds '
            'are means over a pass; errors are measured minus reference speeds.'],
            columns=['', ''], rows=figures),
        Section('Passes needed', columns=['claim', 'needed', 'counted', 'missing'],
                rows=[(c.name, c.wanted, c.had, c.missing) for c in found.claims],
                text=['These are numbers of passes only. Conformity takes more than numbers, '
                      'and software cannot declare it.']),
        Section('Errors', pictures=[Picture.of('Errors against speed, with their limits',
                                               error_figure(found, unit))])])


def error_figure(found: Verification, unit: SpeedUnit) -> Figure:
    """Draw the errors over the speeds, with the limits of error."""
    figure, axes = new_figure(9.0, 4.2)
    some = [m for m in found.matches if m.counts]
    speeds = np.array([m.reference.speed_mps for m in some])
    order = np.argsort(speeds)
    limits = np.array([m.reference.limit_mps for m in some])
    axes.plot(speeds / unit.mps, [(m.error_mps or 0.0) / unit.mps for m in some], 'o', ms=4,
              color=_BLUE, label='errors')
    for sign, label in ((1, 'limits of error'), (-1, None)):
        axes.plot(speeds[order] / unit.mps, sign * limits[order] / unit.mps, color=_ORANGE,
                  label=label)
    axes.set(xlabel=f'reference speed, {unit.name}', ylabel=f'error, {unit.name}')
    show_legend(figure, axes)
    return figure
