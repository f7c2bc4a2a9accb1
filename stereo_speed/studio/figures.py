# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Assess a draft: fit the road of its lines, and report its accuracy and its faults.

A line that prevents a fit is reported and left out, so that the others can be shown.
"""
from __future__ import annotations

from dataclasses import asdict, dataclass, replace
import math
import re
from typing import Any, Mapping, Optional

import numpy as np

from .draft import BACK, Draft, LEAST_POINTS, site_data, VIEWS
from ..core.errors import InputError
from ..core.records import Array
from ..core.units import MPH_MPS
from ..geometry.ray_plane import Plane
from ..geometry.rig import StereoRig
from ..pipeline.config import SiteConfig
from ..road.fitted import RoadFit
from ..road.lanes import LanePath
from ..site.extras import as_calibrated
from ..site.file import lines_of, Site, site_of, SurveyedLine
from ..site.lane_paths import fit_roads, in_one_direction, lane_paths
from ..site.refine.refiner import RefinedSite
from ..site.refine.report import ANGLES, report
from ..site.refine.speed_effect import lane_speed_std

WHERE = 'site'
_CURVE_PLACES = 60  # points of a drawn line
_PATH_PLACES = 40  # points of a drawn path
_GOOD_PX, _DOUBTFUL_PX = 0.6, 1.5  # residuals above which a line, and a point, is reported
_LEAST_GOOD = 6  # a line with fewer points in a view is reported
_LANE_M = 2.2, 5.5  # usual widths of a lane
_MOST_FAULTS = 40  # number of faults that are reported
_FAULT = re.compile(r'(lines|lanes|known_lengths)(?:\.([^.\[]+)|\[(\d+)\])?'
                    r'(?:\.(left|right)_image(?:\[(\d+)\])?)?')


@dataclass(frozen=True)
class Note:
    """
    A message to the user.

    :param level: ``error``, ``warning`` or ``todo``.
    :param text: text of the message.
    :param line: number of the line that it concerns.
    :param lane: number of the lane that it concerns.
    :param view: ``left`` or ``right``, if it concerns one view.
    :param index: index of the point that it concerns.
    """

    level: str
    text: str
    line: Optional[int] = None
    lane: Optional[int] = None
    view: Optional[str] = None
    index: Optional[int] = None


@dataclass(frozen=True, eq=False)
class Figures:
    """
    The assessment of a draft.

    :param data: content for the page.
    :param plane: plane of the road; None where there is none.
    """

    data: dict[str, Any]
    plane: Optional[Plane] = None


def judge(draft: Draft, rig: Optional[StereoRig], config: SiteConfig = SiteConfig(),
          refined: Optional[RefinedSite] = None) -> Figures:
    """
    Fit the road of a draft and collect the content for the page.

    :param draft: the draft.
    :param rig: the cameras as calibrated; None where no bag is open.
    :param config: parameters of roads and their refinement.
    :param refined: the refined site; None where the draft was not refined.
    """
    notes = _unfinished(draft)
    data: dict[str, Any] = {'lines': {}, 'lanes': {}, 'top': None, 'notes': [],
                            'rig': _rig(draft, rig, refined), 'lengths': []}
    if rig is None:
        data['notes'] = list(map(asdict, notes))
        return Figures(data)
    site, lanes = _sound(draft, rig, config, notes)
    plane = None
    if site is not None:
        now = site.corrected_rig(rig)
        fits = _fits(site, now, config, notes, draft)
        for fit in fits:
            _add_lines(data['lines'], fit, draft, notes)
        _add_lanes(data['lanes'], lanes, fits, now, draft, notes,
                   config.site_refinement.worst_speed_std)
        if fits:
            plane = fits[0].plane
            data['top'] = _from_above(fits[0], site, lanes, draft)
    if refined is not None:
        data['lengths'], told = _refinement(refined)
        notes += told
    data['ready'] = bool(lanes) and not any(note.level == 'error' for note in notes) \
        and len(lanes) == len(draft.lanes)
    data['notes'] = list(map(asdict, notes))
    return Figures(_finite(data), plane)


def _finite(value: Any) -> Any:
    """Return values with rounded numbers, and None for non-finite ones."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(inner) for inner in value]
    if isinstance(value, np.ndarray):
        return _finite(value.tolist())
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    return value


def _unfinished(draft: Draft) -> list[Note]:
    """Return notes on the unfinished parts."""
    out = []
    if not draft.lines:
        out.append(Note('todo', 'add a line and click along a marking or a kerb in both views'))
    for line in draft.lines:
        for view in VIEWS:
            count = len(line.view(view))
            if not line.points_m and count < LEAST_POINTS:
                out.append(Note('todo', f'{line.name}: {count} points in the {view} view, '
                                f'{LEAST_POINTS} or more are needed', line.number, view=view))
    if not draft.lanes and draft.lines:
        out.append(Note('todo', 'make a lane of two lines'))
    for lane in draft.lanes:
        if not lane.complete:
            out.append(Note('todo', f"{lane.name}: choose the line on the driver's right and "
                            'that on the left', lane=lane.number))
    return out


def _fault_note(error: InputError, draft: Draft, data: Mapping[str, Any]) -> Note:
    """Return a fault of a site as a note on its line or lane."""
    text = f'{error.what}: found {error.found}, wanted {error.wanted}'
    match = _FAULT.search(error.what)
    if match is None:
        return Note('error', text)
    kind, name, number, view, index = match.groups()
    line = lane = None
    at = None if index is None else int(index)
    if kind == 'lines' and name:
        found = draft.line_named(name)
        line = None if found is None else found.number
        if found is not None and at is not None and view and found.name != name + BACK \
                and _written_reversed(draft, found.number):
            at = len(found.view(view)) - 1 - at
    elif kind == 'lanes' and number:
        lanes = data.get('lanes', [])
        entry = lanes[int(number)]['name'] if int(number) < len(lanes) else None
        lane = next((x.number for x in draft.lanes if x.name == entry), None)
    return Note('error', text, line, lane, view, at)


def _written_reversed(draft: Draft, number: int) -> bool:
    """Return whether all lanes that use a line run against the order of its points."""
    ways = {lane.backward for lane in draft.lanes if number in lane.lines}
    return ways == {True}


def _sound(draft: Draft, rig: StereoRig, config: SiteConfig, notes: list[Note]
           ) -> tuple[Optional[Site], dict[str, LanePath]]:
    """Return the site of the valid parts of a draft, and its lanes; faults become notes."""
    rest = draft
    for _ in range(_MOST_FAULTS):
        data = site_data(rest)
        if not data['lines']:
            return None, {}
        try:
            if not data['lanes']:
                site = Site(WHERE, rest.name, lines_of(WHERE, data['lines']), (),
                            rest.rig_correction)
                in_one_direction(site, site.corrected_rig(rig))
                return site, {}
            site = replace(site_of(WHERE, data), correction=rest.rig_correction)
            return site, lane_paths(site, site.corrected_rig(rig), config.road)
        except InputError as error:
            note = _fault_note(error, rest, data)
            notes.append(note)
            smaller = _without(rest, note)
            if smaller is None:
                return None, {}
            rest = smaller
    return None, {}


def _without(draft: Draft, note: Note) -> Optional[Draft]:
    """Return a draft without the item of a note; None where the note concerns all."""
    if note.line is not None:
        lines = tuple(line for line in draft.lines if line.number != note.line)
        lanes = tuple(lane for lane in draft.lanes if note.line not in lane.lines)
        return replace(draft, lines=lines, lanes=lanes, lengths=())
    if note.lane is not None:
        return replace(draft, lanes=tuple(x for x in draft.lanes if x.number != note.lane))
    if draft.lengths and 'known_lengths' in note.text:
        return replace(draft, lengths=())
    if draft.lanes:
        return replace(draft, lanes=())
    return None


def _fits(site: Site, rig: StereoRig, config: SiteConfig, notes: list[Note], draft: Draft
          ) -> list[RoadFit]:
    """Return the road of all picked lines, or one per lane where no common road fits."""
    one_way, _ = in_one_direction(site, rig)
    try:
        return fit_roads(one_way, rig, None, config.road)
    except InputError as error:
        note = _fault_note(error, draft, {})
        if note not in notes:
            notes.append(note)
        return []


def _add_lines(out: dict[str, Any], fit: RoadFit, draft: Draft, notes: list[Note]) -> None:
    """Add each fitted line: its curves, residuals and offset."""
    offsets = fit.problem.model.offsets(fit.x)
    picks = fit.problem.picks
    for number, name in enumerate(fit.names):
        line = draft.line_named(name)
        if line is None or str(line.number) in out:
            continue
        s = np.linspace(*fit.line_range_m(number), _CURVE_PLACES)
        points = fit.points(number, s, np.zeros_like(s))
        entry: dict[str, Any] = {'offset_m': float(offsets[number]), 'views': {}}
        entry['length_m'] = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        for right, view in enumerate(VIEWS):
            mine = picks.of_line(number, bool(right))
            off, uv = np.abs(fit.feet.residual_px[mine]), picks.uv_px[mine]
            residual = _by_point(line.view(view), uv, off)
            entry['views'][view] = {
                'curve': _drawn(fit.seen(points, bool(right))),
                'residual_px': residual,
                'rms_px': float(np.sqrt(np.mean(off**2)))}
            _tell_points(notes, line.number, line.name, view, residual)
        out[str(line.number)] = entry


def _by_point(points: tuple[Any, ...], uv_px: Array, off_px: Array) -> list[float]:
    """Return residuals in the order of a draft's points, which a fit may have reversed."""
    if len(points) and len(uv_px) == len(points) and \
            abs(points[0].u - uv_px[0, 0]) + abs(points[0].v - uv_px[0, 1]) > 1e-3:
        off_px = off_px[::-1]
    return [float(value) for value in off_px]


def _drawn(uv_px: Array) -> list[list[float]]:
    """Return a curve of raw pixels (n, 2) without its invisible points."""
    return [[round(u, 2), round(v, 2)] for u, v in uv_px.tolist()
            if math.isfinite(u) and math.isfinite(v)]


def _tell_points(notes: list[Note], line: int, name: str, view: str, residual: list[float]
                 ) -> None:
    """Report the worst point of a line, and lines with few points."""
    worst = int(np.argmax(residual))
    usual = float(np.median(residual))
    if residual[worst] > max(_DOUBTFUL_PX, 4 * usual):
        notes.append(Note('warning', f'{name}: point {worst + 1} of the {view} view lies '
                          f'{residual[worst]:.1f} px off the road', line, view=view, index=worst))
    elif usual > _GOOD_PX:
        notes.append(Note('warning', f'{name}: points of the {view} view lie {usual:.1f} px off '
                          'the road', line, view=view))
    if len(residual) < _LEAST_GOOD:
        notes.append(Note('todo', f'{name}: {len(residual)} points in the {view} view; a dozen '
                          'tell more', line, view=view))


def _add_lanes(out: dict[str, Any], lanes: Mapping[str, LanePath], fits: list[RoadFit],
               rig: StereoRig, draft: Draft, notes: list[Note], worst_speed_std: float) -> None:
    """Add each lane: its path in both views, width, length and the 1-sigma it adds to speeds."""
    for spec in draft.lanes:
        lane = lanes.get(spec.name)
        if lane is None:
            continue
        s = np.linspace(0.0, lane.path.length_m, _PATH_PLACES)
        left, right, seen_left, seen_right = rig.project(lane.path.position(s))
        width, width_std = _width(spec.lines, fits, draft)
        std = lane_speed_std(lane, rig)
        limit = lane.speed_limit_mps or 0.0
        out[str(spec.number)] = {
            'width_m': width, 'width_std_m': width_std, 'length_m': lane.path.length_m,
            'residual_px': lane.residual_px, 'speed_std': std,
            'speed_std_mph': std * limit / MPH_MPS, 'limit_mps': limit,
            'heading_std_deg': [float(x) for x in np.degrees(lane.heading_std_rad)],
            'paths': {'left': _drawn(left[seen_left]), 'right': _drawn(right[seen_right])}}
        if math.isfinite(width) and not _LANE_M[0] <= width <= _LANE_M[1]:
            notes.append(Note('warning', f'{spec.name}: {width:.2f} m wide, which is unusual; '
                              'are these its lines?', lane=spec.number))
        if std > worst_speed_std:
            notes.append(Note('warning', f'{spec.name}: the clicks leave speeds uncertain by '
                              f'{100 * std:.2f} %', lane=spec.number))


def _width(numbers: tuple[int, ...], fits: list[RoadFit], draft: Draft) -> tuple[float, float]:
    """Return the width of a lane and its 1-sigma; NaN where no road has both its lines."""
    for fit in fits:
        of = {line.number: i for i, name in enumerate(fit.names)
              if (line := draft.line_named(name)) is not None}
        if len(numbers) == 2 and all(n in of for n in numbers):
            return fit.spacing(of[numbers[0]], of[numbers[1]])
    return math.nan, math.nan


def _from_above(fit: RoadFit, site: Site, lanes: Mapping[str, LanePath], draft: Draft
                ) -> dict[str, Any]:
    """Return lines, lanes and camera from above, in m along the road and to its left."""
    points, frames = fit.problem.model.reference(fit.x)
    middle = len(points) // 2
    origin, axes = points[middle], frames[middle]

    def flat(place: Array) -> list[list[float]]:
        return [[round(a, 3), round(b, 3)] for a, b in ((place - origin) @ axes[:, :2]).tolist()]
    out: dict[str, Any] = {'lines': {}, 'lanes': {}, 'camera': flat(np.zeros((1, 3)))[0],
                           'axis': flat(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 5.0]]))}
    for number, name in enumerate(fit.names):
        line = draft.line_named(name)
        if line is not None:
            s = np.linspace(*fit.line_range_m(number), _CURVE_PLACES)
            out['lines'][str(line.number)] = flat(fit.points(number, s, np.zeros_like(s)))
    for name, entry in site.lines.items():
        line = draft.line_named(name)
        if isinstance(entry, SurveyedLine) and line is not None:
            out['lines'][str(line.number)] = flat(entry.points_m)
    for spec in draft.lanes:
        lane = lanes.get(spec.name)
        if lane is not None:
            s = np.linspace(0.0, lane.path.length_m, _PATH_PLACES)
            out['lanes'][str(spec.number)] = flat(lane.path.position(s))
    height = float((np.zeros(3) - origin) @ axes[:, 2])
    return {**out, 'camera_height_m': height}


def _rig(draft: Draft, rig: Optional[StereoRig], refined: Optional[RefinedSite]
         ) -> dict[str, Any]:
    """Return the state of the rig as numbers and text."""
    correction = draft.rig_correction
    known = as_calibrated() if correction is None else correction
    std = np.degrees(np.sqrt(np.diag(known.covariance_rad2)))
    out: dict[str, Any] = {
        'looked_at': correction is not None,
        'angles': [{'name': name, 'deg': float(value), 'std_deg': float(sigma)}
                   for name, value, sigma in zip(ANGLES, np.degrees(known.drift_rad), std)]}
    if rig is not None:
        out.update(baseline_m=rig.baseline_m, focal_px=float(rig.left.K[0, 0]),
                   size=[rig.left.width_px, rig.left.height_px])
    if refined is not None:
        out['moved_probability'] = refined.drift.moved_probability
    return out


def _refinement(refined: RefinedSite) -> tuple[list[dict[str, Any]], list[Note]]:
    """Return the checked lengths and the warnings of a refinement."""
    found = report(refined)
    lengths = [{'name': x.name, 'known_m': x.known_m, 'known_std_m': x.known_std_m,
                'measured_m': x.measured_m, 'measured_std_m': x.measured_std_m,
                'wrong': bool(x.wrong)} for x in found.lengths]
    return lengths, [Note('warning', text) for text in found.warnings]


def neighbours(figures: Figures, draft: Draft) -> list[tuple[int, int]]:
    """
    Return the pairs of neighbouring lines, right and left, that are a lane's width apart.

    Existing lanes are left out. Right and left are as seen along the order of the clicks.
    """
    placed = sorted((entry['offset_m'], int(number))
                    for number, entry in figures.data['lines'].items())
    there = {frozenset(lane.lines) for lane in draft.lanes}
    return [(right, left) for (a, right), (b, left) in zip(placed, placed[1:])
            if _LANE_M[0] <= b - a <= _LANE_M[1] and frozenset((right, left)) not in there]
