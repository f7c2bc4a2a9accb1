# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
A site while it is being drawn: like a site file, but possibly unfinished.

Lines and lanes have numbers that do not change when they are renamed. A lane may run against the
order in which its lines were clicked; the site file then has those lines in the order of travel.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Iterable, Mapping, Optional, TypeVar

import numpy as np

from ..core.records import Array, InitialFront
from ..geometry.rig import StereoRig
from ..road.problem import RoadPrior
from ..site.extras import DashPeriod, LinesApart, PointsApart, RigCorrection
from ..site.file import PickedLine, Site, SurveyedLine
from ..site.write import speed_text

VIEWS = ('left', 'right')
BACK = '_back'  # suffix of the reversed copy of a line that lanes of both directions share
CORNERS = 4  # corners of a front
ENDS = 2  # end points of a length between two points
LEAST_POINTS = 2  # least number of points of a line in each view
FILE_DIGITS = 4  # decimals of pixels in a site file


@dataclass(frozen=True)
class Point:
    """
    A point of a line in one raw view.

    :param u: px to the right.
    :param v: px down.
    :param std_px: 1-sigma across the line, if found in the image; None for a click.
    """

    u: float
    v: float
    std_px: Optional[float] = None


class InTwoViews:
    """An item with points in both raw views."""

    left: tuple[Point, ...]
    right: tuple[Point, ...]

    def view(self, name: str) -> tuple[Point, ...]:
        """Return the points of one view, ``left`` or ``right``."""
        return self.left if name == 'left' else self.right


Drawn = TypeVar('Drawn', 'DraftLine', 'DraftLength', 'DraftFront')


def with_view(thing: Drawn, name: str, points: Iterable[Point]) -> Drawn:
    """Return an item with other points in one view."""
    points = tuple(points)
    return replace(thing, left=points) if name == 'left' else replace(thing, right=points)


@dataclass(frozen=True)
class DraftLine(InTwoViews):
    """
    A line.

    :param number: number of the line.
    :param name: name of the line.
    :param left: points in the left view, in order.
    :param right: points in the right view, in the same direction.
    :param points_m: points (x, y, z) of a surveyed line, m.
    :param std_m: 1-sigma of a surveyed line's points, m.
    """

    number: int
    name: str
    left: tuple[Point, ...] = ()
    right: tuple[Point, ...] = ()
    points_m: tuple[tuple[float, ...], ...] = ()
    std_m: Optional[float] = None

    @property
    def complete(self) -> bool:
        """Return whether the line has enough points."""
        return bool(self.points_m) or min(len(self.left), len(self.right)) >= LEAST_POINTS


@dataclass(frozen=True)
class DraftLane:
    """
    A lane.

    :param number: number of the lane.
    :param name: name of the lane.
    :param right: number of the line on the driver's right.
    :param left: number of the line on the driver's left.
    :param path: number of the line that is its path, instead of right and left lines.
    :param speed_limit: speed limit as text, with its unit.
    :param backward: whether travel runs against the order of the lines' points.
    :param class_limits: limits for classes of vehicles, as in the file.
    :param path_std: relative 1-sigma of speeds by errors of its path that its lines do not tell.
    """

    number: int
    name: str
    right: Optional[int] = None
    left: Optional[int] = None
    path: Optional[int] = None
    speed_limit: str = '50 km/h'
    backward: bool = False
    class_limits: tuple[tuple[str, str], ...] = ()
    path_std: float = 0.0

    @property
    def lines(self) -> tuple[int, ...]:
        """Return the numbers of its lines."""
        return tuple(n for n in (self.path, self.right, self.left) if n is not None)

    @property
    def complete(self) -> bool:
        """Return whether the lane has its path, or both its lines."""
        return self.path is not None or (self.right is not None and self.left is not None)


@dataclass(frozen=True)
class DraftLength(InTwoViews):
    """
    A known length.

    :param number: number of the length.
    :param name: name of the length.
    :param length_m: the length, m.
    :param std_m: its 1-sigma, m.
    :param kind: ``between`` two lines, of ``dashes`` of a line, or of two ``points``.
    :param lines: numbers of the two lines, or of the dashed line.
    :param left: its two points in the left view.
    :param right: the same two points in the right view.
    :param pick_std_px: 1-sigma of the points.
    """

    number: int
    name: str
    length_m: float
    std_m: float
    kind: str = 'between'
    lines: tuple[int, ...] = ()
    left: tuple[Point, ...] = ()
    right: tuple[Point, ...] = ()
    pick_std_px: Optional[float] = None

    @property
    def complete(self) -> bool:
        """Return whether the length has all points or lines that its kind needs."""
        if self.kind == 'points':
            return len(self.left) == len(self.right) == ENDS
        return len(self.lines) == (2 if self.kind == 'between' else 1)


@dataclass(frozen=True)
class DraftFront(InTwoViews):
    """
    A front of a vehicle that is being annotated.

    :param number: number of the front.
    :param frame: index of the pair.
    :param left: corners in the left view, clockwise from the image's top-left corner.
    :param right: corners in the right view.
    :param of: number of the vehicle's first mark, if this is a further one, for truth.
    """

    number: int
    frame: int
    left: tuple[Point, ...] = ()
    right: tuple[Point, ...] = ()
    of: Optional[int] = None

    @property
    def complete(self) -> bool:
        """Return whether all corners are set."""
        return len(self.left) == len(self.right) == CORNERS


@dataclass(frozen=True)
class Draft:
    """
    The state of a drawing.

    :param name: name of the site.
    :param lines: lines, in the order of their creation.
    :param lanes: lanes, in the order of the file.
    :param lengths: known lengths.
    :param fronts: annotated fronts.
    :param correction: pan, tilt and roll of the right camera, rad, then the nine elements of their
        covariance; None where the rig was not checked.
    :param tolerances: tolerances of the rig, as in the file.
    :param calibrated: date of the rig's calibration, as in the file; None where it has none.
    :param next_id: number for the next new item.
    """

    name: str = 'site'
    lines: tuple[DraftLine, ...] = ()
    lanes: tuple[DraftLane, ...] = ()
    lengths: tuple[DraftLength, ...] = ()
    fronts: tuple[DraftFront, ...] = ()
    correction: Optional[tuple[float, ...]] = None
    tolerances: Mapping[str, float] = field(default_factory=dict)
    calibrated: Optional[str] = None
    next_id: int = 1

    def line_named(self, name: str) -> Optional[DraftLine]:
        """Return the line with a name of the file, in either direction; None without one."""
        named = {line.name: line for line in self.lines}
        return named.get(name) or named.get(name.removesuffix(BACK))

    @property
    def rig_correction(self) -> Optional[RigCorrection]:
        """Return the extrinsic drift in the form of a site."""
        if self.correction is None:
            return None
        return RigCorrection(np.array(self.correction[:3]),
                             np.array(self.correction[3:]).reshape(3, 3))

    def rig_now(self, rig: StereoRig) -> StereoRig:
        """Return the calibrated rig with the draft's extrinsic drift applied."""
        known = self.rig_correction
        return rig if known is None else rig.drifted(known.drift_rad)


def as_numbers(correction: Optional[RigCorrection]) -> Optional[tuple[float, ...]]:
    """Return an extrinsic drift in the form of a draft."""
    if correction is None:
        return None
    return (*correction.drift_rad.tolist(), *correction.covariance_rad2.ravel().tolist())


def points_of(uv_px: Array, std_px: Optional[Array] = None) -> tuple[Point, ...]:
    """Return :class:`Point` items of pixels (n, 2), with their 1-sigmas (n,) where known."""
    stds = [None] * len(uv_px) if std_px is None else std_px.tolist()
    return tuple(Point(u, v, std) for (u, v), std in zip(uv_px.tolist(), stds))


def pixels_of(points: Iterable[Point]) -> Array:
    """Return the raw pixels (n, 2) of points."""
    return np.array([(p.u, p.v) for p in points], dtype=np.float64).reshape(-1, 2)


def draft_of(site: Site) -> Draft:
    """Return a draft of a site that was read from a file."""
    lines, ids = [], {}
    for number, (name, line) in enumerate(site.lines.items(), 1):
        ids[name] = number
        if isinstance(line, PickedLine):
            left_std_px, right_std_px = line.views_std_px or (None, None)
            lines.append(DraftLine(number, name, points_of(line.left_px, left_std_px),
                                   points_of(line.right_px, right_std_px)))
        elif isinstance(line, SurveyedLine):
            points = tuple(map(tuple, line.points_m.tolist()))
            lines.append(DraftLine(number, name, points_m=points, std_m=line.std_m))
    number = len(lines) + 1
    lanes = []
    for number, lane in enumerate(site.lanes, number):
        right, left, path = (None if n is None else ids[n]
                             for n in (lane.right, lane.left, lane.path))
        classes = tuple((str(name), speed_text(limit))
                        for name, limit in lane.class_limits_mps.items())
        lanes.append(DraftLane(number, lane.name, right, left, path,
                               speed_text(lane.speed_limit_mps), class_limits=classes,
                               path_std=lane.path_std))
    lengths = []
    number = len(lines) + len(lanes)
    for number, known in enumerate(site.known_lengths, number + 1):
        length = DraftLength(number, known.name, known.length_m, known.std_m)
        if isinstance(known.of, LinesApart):
            length = replace(length, lines=tuple(ids[n] for n in known.of.lines))
        elif isinstance(known.of, DashPeriod):
            length = replace(length, kind='dashes', lines=(ids[known.of.line],))
        elif isinstance(known.of, PointsApart):
            length = replace(length, kind='points', left=points_of(known.of.left_px),
                             right=points_of(known.of.right_px),
                             pick_std_px=known.of.pick_std_px)
        lengths.append(length)
    return Draft(site.name, tuple(lines), tuple(lanes), tuple(lengths), (),
                 as_numbers(site.correction), dict(site.tolerances),
                 None if site.calibrated is None else site.calibrated.isoformat(), number + 1)


def fronts_of(fronts: Iterable[InitialFront], first_id: int) -> tuple[DraftFront, ...]:
    """Return annotated fronts in the form of a draft, numbered from ``first_id``."""
    return tuple(DraftFront(number, front.frame, points_of(front.left_px),
                            points_of(front.right_px))
                 for number, front in enumerate(fronts, first_id))


class Names:
    """
    Names of a draft's lines in a site file, where lines follow the direction of travel.

    :param draft: the draft.
    """

    def __init__(self, draft: Draft) -> None:
        self._lines = {line.number: line for line in draft.lines}
        back = {n for lane in draft.lanes if lane.backward for n in lane.lines}
        ahead = {n for lane in draft.lanes if not lane.backward for n in lane.lines}
        self._both = back & ahead
        self._turned = back - ahead

    def of(self, number: int, backward: bool) -> str:
        """Return the name of a line for a lane of the given direction."""
        name = self._lines[number].name
        return name + BACK if backward and number in self._both else name

    def entries(self, line: DraftLine) -> list[tuple[str, bool]]:
        """Return the names under which a line is written, each with whether it is reversed."""
        if line.number in self._both:
            return [(line.name, False), (line.name + BACK, True)]
        return [(line.name, line.number in self._turned)]


def line_data(line: DraftLine, reverse: bool = False) -> dict[str, Any]:
    """Return a line in the form of a site file."""
    way = slice(None, None, -1 if reverse else 1)
    if line.points_m:
        out: dict[str, Any] = {'points_m': [list(p) for p in line.points_m][way]}
        return out if line.std_m is None else {**out, 'std_m': line.std_m}
    out = {f'{view}_image': [[round(p.u, FILE_DIGITS), round(p.v, FILE_DIGITS)]
                             for p in line.view(view)][way] for view in VIEWS}
    stds = {f'{view}_std_px': [p.std_px for p in line.view(view)][way] for view in VIEWS}
    if any(std is not None for values in stds.values() for std in values):
        clicked = RoadPrior().pick_std_px
        for key, values in stds.items():
            out[key] = [clicked if std is None else std for std in values]
    return out


def site_data(draft: Draft) -> dict[str, Any]:
    """
    Return the complete parts of a draft in the form of a site file.

    Lanes are included if all their lines are complete; mandatory parts may be missing.
    """
    names = Names(draft)
    whole = [line for line in draft.lines if line.complete]
    there = {line.number for line in whole}
    data: dict[str, Any] = {'stereo_speed_site': 1, 'name': draft.name}
    data['lines'] = {name: line_data(line, reverse)
                     for line in whole for name, reverse in names.entries(line)}
    data['lanes'] = []
    for lane in draft.lanes:
        if not (lane.complete and there.issuperset(lane.lines)):
            continue
        keys = ('path',) if lane.path is not None else ('right', 'left')
        lines = {key: names.of(getattr(lane, key), lane.backward) for key in keys}
        data['lanes'].append({'name': lane.name, **lines, 'speed_limit': lane.speed_limit,
                              **({'class_limits': dict(lane.class_limits)}
                                 if lane.class_limits else {}),
                              **({'path_std': lane.path_std} if lane.path_std else {})})
    lengths = [length_data(known, names) for known in draft.lengths
               if known.complete and there.issuperset(known.lines)]
    if lengths:
        data['known_lengths'] = lengths
    if draft.tolerances:
        data['tolerances'] = dict(draft.tolerances)
    if draft.calibrated is not None:
        data['calibrated'] = draft.calibrated
    return data


def length_data(known: DraftLength, names: Names) -> dict[str, Any]:
    """Return a known length in the form of a site file."""
    out: dict[str, Any] = {'name': known.name, 'length_m': known.length_m, 'std_m': known.std_m}
    if known.kind == 'between':
        out['between'] = [names.of(n, False) for n in known.lines]
    elif known.kind == 'dashes':
        out['dashes'] = names.of(known.lines[0], False)
    else:
        for view in VIEWS:
            out[f'{view}_image'] = [[p.u, p.v] for p in known.view(view)]
        if known.pick_std_px is not None:
            out['pick_std_px'] = known.pick_std_px
    return out


def init_data(draft: Draft) -> dict[str, Any]:
    """Return the complete annotated fronts in the form of an init file."""
    def corners(points: tuple[Point, ...]) -> list[list[float]]:
        return [[round(p.u, 2), round(p.v, 2)] for p in points]
    return {'stereo_speed_init': 1, 'vehicles': [
        {'frame': front.frame, 'left_image': corners(front.left),
         'right_image': corners(front.right)} for front in draft.fronts
        if front.complete and front.of is None]}


def with_refined(draft: Draft, site: Site) -> Draft:
    """
    Return a draft whose clicked points are replaced by those of the refined site.

    :param draft: the draft that was refined.
    :param site: the refined site.
    """
    names, lines = Names(draft), []
    for line in draft.lines:
        name, reverse = names.entries(line)[0]
        found = site.picked.get(name)
        if found is not None:
            found = found.in_reverse() if reverse else found
            line = replace(line, left=points_of(found.left_px, found.left_std_px),
                           right=points_of(found.right_px, found.right_std_px))
        lines.append(line)
    path_stds = {lane.name: lane.path_std for lane in site.lanes}
    lanes = tuple(replace(lane, path_std=path_stds.get(lane.name, lane.path_std))
                  for lane in draft.lanes)
    return replace(draft, lines=tuple(lines), lanes=lanes,
                   correction=as_numbers(site.correction))
