# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The report of a run: its passes, plots of each vehicle, the site, settings and warnings."""
from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
import json
from typing import Any, Mapping, Optional, Sequence

from .evidence_pictures import jpeg
from .overlay import Image
from .page import page_html, Picture, Section
from .plots import road_figure, speed_figure
from .survey import histogram
from ..core.passes import PassResult, SecondEstimate, Verdict
from ..core.records import TrackUpdate
from ..core.units import SpeedUnit
from ..road.lanes import LanePath
from ..survey.traffic import Vehicle

MOST_PROFILES = 60  # plots of single vehicles; more would make the file too large for a browser
_JPEG_QUALITY = 88


@dataclass(frozen=True, kw_only=True)
class RunFacts:
    """
    The content of a report of a run.

    :param name: name of the bag.
    :param updates: updates of the run's tracks.
    :param passes: passes of the run.
    :param lanes: lane name to lane path.
    :param site: the lanes' paths drawn over an image; None where there is none.
    :param frames: annotated images of the run.
    :param summary: content of ``summary.json``.
    :param warnings: warnings to the reader, a line each.
    """

    name: str
    updates: Sequence[TrackUpdate]
    passes: Sequence[PassResult]
    lanes: Mapping[str, LanePath]
    site: Optional[Image]
    frames: Optional[Image]
    summary: Mapping[str, Any]
    warnings: Sequence[str]


def replay_page(facts: RunFacts, unit: SpeedUnit) -> str:
    """Return the report of a run as one HTML file; the same run gives the same bytes."""
    passes = sorted(facts.passes, key=lambda p: p.track)
    return page_html(f'Speeds: {facts.name}', [
        Section('Warnings', text=[*facts.warnings, *_rejections(passes)] or ['None.']),
        _table(passes, facts.lanes, unit),
        Section('Distribution', pictures=[Picture.of(
            'Measured speeds by lane', histogram([_vehicle(p) for p in passes], unit))]),
        _profiles(facts, passes, unit), _site(facts),
        Section('Settings', text=['All settings and inputs that determine this run.'],
                details=json.dumps(facts.summary, indent=2, sort_keys=True, default=str))])


def _rejections(passes: Sequence[PassResult]) -> list[str]:
    reasons = Counter(str(p.reason) for p in passes if p.verdict is Verdict.REJECTED)
    return [f'{count} of {len(passes)} passes rejected: {reason}'
            for reason, count in sorted(reasons.items())]


def _table(passes: Sequence[PassResult], lanes: Mapping[str, LanePath], unit: SpeedUnit
           ) -> Section:
    rows = []
    for p in passes:
        second, lane = p.second or SecondEstimate(None, None, 0), lanes.get(p.lane)
        rows.append((
            p.track, p.lane if p.lane_to == p.lane else f'{p.lane} → {p.lane_to}',
            p.direction or '-', '-' if p.vehicle is None else p.vehicle.name, p.pairs,
            unit.of(p.speed_mps), unit.of(p.speed_std_mps),
            unit.of(second.speed_mps), unit.of(second.speed_std_mps),
            unit.of(None if lane is None else lane.speed_limit_mps, 0),
            p.verdict.value + (f' ({p.reason})' if p.reason else '')))
    return Section('Passes', columns=(
        'track', 'lane', 'direction', 'class', 'pairs', f'speed, {unit.name}', '1-sigma',
        'second estimate', '1-sigma', 'limit', 'verdict'), rows=rows)


def _vehicle(p: PassResult) -> Vehicle:
    return Vehicle(first_ns=p.first_ns, last_ns=p.last_ns, lane=p.lane, speed_mps=p.speed_mps)


def _profiles(facts: RunFacts, passes: Sequence[PassResult], unit: SpeedUnit) -> Section:
    """Return a plot of the speed over time for each vehicle."""
    shown = passes[:MOST_PROFILES]
    text = [] if len(shown) == len(passes) else [
        f'The first {len(shown)} of {len(passes)} passes.']
    pictures = []
    for one in shown:
        updates = [u for u in facts.updates if u.track == one.track]
        if updates:
            pictures.append(Picture.of(f'Vehicle {one.track}: {one.lane}, {one.verdict.value}',
                                       speed_figure(updates, [one], facts.lanes, unit=unit)))
    return Section('Vehicles', text=text, pictures=pictures)


def _site(facts: RunFacts) -> Section:
    """Return the lane paths over an image, the positions from above, and some images."""
    pictures = [Picture(caption, jpeg(image, _JPEG_QUALITY), 'jpeg') for caption, image in (
        ('Paths of the lanes, drawn on the left image', facts.site),
        ('Some pairs of the run', facts.frames)) if image is not None]
    if facts.updates:
        pictures.insert(1, Picture.of('From above', road_figure(facts.updates, facts.lanes)))
    return Section('Site', pictures=pictures)
