# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reading of site files: lines, lanes and knowledge of the rig."""
from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import date
from itertools import combinations
from pathlib import Path as FilePath
from typing import Any, Mapping, Optional, Union

import numpy as np

from .checks import crossing, out_of_order
from .extras import KnownLength, read_correction, read_length, RigCorrection
from ..core.errors import SiteError
from ..core.passes import VehicleClass
from ..core.records import Array
from ..core.strict_yaml import load_yaml, read_text, StrictMapping
from ..core.tracker_config import check_tolerance, TOLERANCES
from ..geometry.rig import StereoRig

LEAST_ROAD_M = 5.0  # least length of a line; the direction of a shorter one is too uncertain
LEAST_STD_PX, MOST_STD_PX = 1e-6, 100.0  # a 1-sigma beyond these is a mistake in the file
LEAST_STD_M, MOST_STD_M = 1e-6, 10.0  # likewise in metres
MOST_PATH_STD = 1.0  # upper bound of the relative 1-sigma of speeds by errors of a path
_ROUNDING_RAD = 1e-8  # rounding of the angles of a site file, six digits of a degree
VIEWS = ('left_image', 'right_image')
CLASSES = tuple(str(name) for name in VehicleClass if name is not VehicleClass.UNKNOWN)


@dataclass(frozen=True, eq=False)
class PickedLine:
    """
    A line of the road that was picked independently in both views.

    :param name: name of the line.
    :param left_px: (n, 2) raw pixels in order along travel.
    :param right_px: (m, 2) raw pixels in order along travel.
    :param left_std_px: (n,) 1-sigmas of the left points across the line, px; None for clicks.
    :param right_std_px: (m,) 1-sigmas of the right points across the line, px; None for clicks.
    """

    name: str
    left_px: Array
    right_px: Array
    left_std_px: Optional[Array] = None
    right_std_px: Optional[Array] = None

    @property
    def views_px(self) -> tuple[Array, Array]:
        """Return the points of both views."""
        return self.left_px, self.right_px

    @property
    def views_std_px(self) -> Optional[tuple[Array, Array]]:
        """Return the 1-sigmas of both views; None for clicks."""
        if self.left_std_px is None or self.right_std_px is None:
            return None
        return self.left_std_px, self.right_std_px

    def in_reverse(self) -> PickedLine:
        """Return the line with its points in reverse order."""
        stds = self.views_std_px or (None, None)
        left, right = (None if std is None else std[::-1] for std in stds)
        return PickedLine(self.name, self.left_px[::-1], self.right_px[::-1], left, right)


@dataclass(frozen=True, eq=False)
class SurveyedLine:
    """
    A line of the road that was surveyed.

    :param name: name of the line.
    :param points_m: (k, 3) points in order along travel, left optical frame, m.
    :param std_m: 1-sigma of each point across the line, m; None if the file gives none.
    """

    name: str
    points_m: Array
    std_m: Optional[float] = None


SiteLine = Union[PickedLine, SurveyedLine]


@dataclass(frozen=True)
class LaneSpec:
    """
    A lane as specified in the file: by its two lines, or by the line that is its path.

    :param name: name of the lane.
    :param right: name of the line on the driver's right, or None.
    :param left: name of the line on the driver's left, or None.
    :param path: name of the line that is the path itself, or None.
    :param speed_limit_mps: speed limit, m/s.
    :param class_limits_mps: speed limits that differ from it for some vehicle classes, m/s.
    :param path_std: relative 1-sigma of speeds by errors of its path that its lines do not tell.
    """

    name: str
    right: Optional[str]
    left: Optional[str]
    path: Optional[str]
    speed_limit_mps: float
    class_limits_mps: Mapping[VehicleClass, float] = field(default_factory=dict)
    path_std: float = 0.0

    def limit_mps(self, name: VehicleClass) -> float:
        """Return the speed limit of a class, m/s; for an unknown class, the highest limit."""
        if name is VehicleClass.UNKNOWN:
            return max(self.speed_limit_mps, *self.class_limits_mps.values(), 0.0)
        return self.class_limits_mps.get(name, self.speed_limit_mps)

    @property
    def lines(self) -> tuple[str, ...]:
        """Return the names of its lines: the path, or right and left."""
        return tuple(n for n in (self.path, self.right, self.left) if n is not None)


@dataclass(frozen=True, eq=False)
class Site:
    """
    A site, as its file describes it.

    :param where: path of the file, for messages.
    :param name: name of the site; the file's stem if it gives none.
    :param lines: lines by name.
    :param lanes: lanes in the order of the file.
    :param correction: extrinsic drift since the calibration; None if it was never estimated.
    :param known_lengths: lengths by which the site can be checked.
    :param tolerances: 1-sigmas of focal length, baseline and stamps of this rig, as far as the
        file gives them; they replace the tracker's parameters of the same names.
    :param calibrated: day of the rig's calibration; None if the file does not give it.
    :param text: the file as it was when it was read; empty for a site that was made otherwise.
    """

    where: str
    name: str
    lines: Mapping[str, SiteLine]
    lanes: tuple[LaneSpec, ...]
    correction: Optional[RigCorrection] = None
    known_lengths: tuple[KnownLength, ...] = ()
    tolerances: Mapping[str, float] = field(default_factory=dict)
    calibrated: Optional[date] = None
    text: str = field(default='', compare=False, repr=False)

    @property
    def picked(self) -> dict[str, PickedLine]:
        """Return the picked lines, by name."""
        return {n: line for n, line in self.lines.items() if isinstance(line, PickedLine)}

    def corrected_rig(self, rig: StereoRig) -> StereoRig:
        """
        Return the rig with the correction applied, which is the rig to measure with.

        :param rig: rig as calibrated, or as returned by this method.
        """
        if self.correction is None or not np.any(self.correction.drift_rad) \
                or self.fits(rig):
            return rig
        return rig.drifted(self.correction.drift_rad)

    def fits(self, rig: StereoRig) -> bool:
        """Return whether a rig has the correction applied, as by :meth:`corrected_rig`."""
        drift = np.zeros(3) if self.correction is None else self.correction.drift_rad
        return bool(np.allclose(rig.drift_rad, drift, rtol=0, atol=_ROUNDING_RAD))


def load_site(path: Union[str, FilePath]) -> Site:
    """
    Read a site file.

    :raises SiteError: names the first fault.
    """
    text = read_text(path)
    return replace(site_of(path, load_yaml(path, 'stereo_speed_site', text)), text=text)


def site_of(path: Union[str, FilePath], data: Mapping[str, Any]) -> Site:
    """
    Return the site that the content of a site file describes.

    :param path: path of the file, for messages; its stem names a site without a name.
    :param data: top level of the file.
    :raises SiteError: names the first fault.
    """
    top = StrictMapping(path, '', data, ('stereo_speed_site', 'name', 'lines', 'lanes',
                                         'rig_correction', 'known_lengths', 'tolerances',
                                         'calibrated'))
    name = top.text('name') if 'name' in top else FilePath(path).stem
    lines = lines_of(path, data.get('lines'))
    lanes = tuple(_lane(path, i, value, lines) for i, value in enumerate(top.listed('lanes')))
    for a, b in combinations(lanes, 2):
        if a.name == b.name:
            raise top.error('lanes', f'two lanes named {a.name}', 'a different name for each lane')
    correction = read_correction(path, data['rig_correction']) \
        if 'rig_correction' in top else None
    lengths = tuple(read_length(path, i, value, lines) for i, value in enumerate(
        top.listed('known_lengths'))) if 'known_lengths' in top else ()
    given = StrictMapping(path, 'tolerances', data.get('tolerances', {}), TOLERANCES).data
    tolerances = {key: check_tolerance(key, value, path) for key, value in given.items()}
    return Site(str(path), name, lines, lanes, correction, lengths, tolerances,
                _day(top, 'calibrated') if 'calibrated' in top else None)


def _day(fields: StrictMapping, key: str) -> date:
    """Return a day; YAML has already read it as a date unless it is quoted."""
    value = fields.data[key]
    try:
        if type(value) is date:  # excludes datetime, which is a subclass
            return value
        return date.fromisoformat(value)
    except (TypeError, ValueError):
        raise fields.error(key, repr(value), 'a day such as 2026-05-31') from None


def lines_of(where: object, data: object) -> dict[str, SiteLine]:
    """
    Return the lines of a site file, by name.

    :param where: path of the file, for messages.
    :param data: value of ``lines`` in the file.
    :raises SiteError: names the first fault.
    """
    if not isinstance(data, Mapping) or not data:
        raise SiteError(where, 'lines', 'none' if not data else repr(data),
                        'a mapping of named lines')
    for key in data:
        if not isinstance(key, str):
            raise SiteError(where, 'lines', f'name {key!r}', 'names that are texts')
    lines = {key: _line(where, key, value) for key, value in data.items()}
    _refuse_crossings(where, lines)
    return lines


def _line(where: object, name: str, data: object) -> SiteLine:
    """Return one line; points out of order are refused."""
    stds = tuple(f'{view[:-6]}_std_px' for view in VIEWS)
    fields = StrictMapping(where, f'lines.{name}', data, (*VIEWS, 'points_m', 'std_m', *stds))
    if 'points_m' in fields:
        if any(view in fields for view in VIEWS + stds):
            raise fields.error('points_m', 'image picks too', 'only one of the two')
        points = _ordered(fields, 'points_m', 3)
        length = np.linalg.norm(np.diff(points, axis=0), axis=-1).sum()
        if length < LEAST_ROAD_M:
            raise fields.error('points_m', f'{length:.1f} m', f'at least {LEAST_ROAD_M} m of road')
        std = fields.number('std_m', LEAST_STD_M, MOST_STD_M, 'm') if 'std_m' in fields else None
        return SurveyedLine(name, points, std)
    if 'std_m' in fields:
        raise fields.error('std_m', 'image picks', 'std_m only with points_m')
    left, right = (_ordered(fields, view, 2) for view in VIEWS)
    return PickedLine(name, left, right, _stds(fields, stds[0], len(left)),
                      _stds(fields, stds[1], len(right)))


def _ordered(fields: StrictMapping, key: str, width: int) -> Array:
    """Return points (n, width), which must be in order along travel."""
    points = fields.points(key, width, 2)
    bad = out_of_order(points)
    if bad is not None:
        raise fields.error(f'{key}[{bad}]', 'a point behind the previous one',
                           'points in order along travel')
    return points


def _stds(fields: StrictMapping, key: str, count: int) -> Optional[Array]:
    """Return the 1-sigmas of a line's points, one for each; None if they are not given."""
    if key not in fields:
        return None
    values = fields.numbers(key, LEAST_STD_PX, MOST_STD_PX, 'px')
    if len(values) != count:
        raise fields.error(key, f'{len(values)} numbers', f'{count}, one for each point')
    return values


def _refuse_crossings(where: object, lines: Mapping[str, SiteLine]) -> None:
    """
    Refuse lines that cross themselves or each other in a view, which are slips of the mouse.

    Two lines are not compared if one of them has 1-sigmas. Its points were found in the images and
    may be far apart, so that in a bend the straight segments of two lines may cross although the
    lines do not. One such line suffices, because a refined site may contain clicked lines too.
    """
    picked = [line for line in lines.values() if isinstance(line, PickedLine)]
    for right, view in enumerate(VIEWS):
        for line in picked:
            points = line.views_px[right]
            at = crossing(points, points)
            if at:
                raise SiteError(where, f'lines.{line.name}.{view}',
                                f'picks {at[0]} and {at[1]} where the line crosses itself',
                                'points in order along travel')
        for a, b in combinations(picked, 2):
            if np.array_equal(a.views_px[right], b.views_px[right][::-1]):
                continue  # one line, once for each direction of travel
            if a.views_std_px is not None or b.views_std_px is not None:
                continue
            at = crossing(a.views_px[right], b.views_px[right])
            if at:
                raise SiteError(where, f'lines.{a.name}.{view}',
                                f'a crossing with {b.name} after picks {at[0]} and {at[1]}',
                                'lines that do not cross')


def _lane(where: object, index: int, data: object, lines: Mapping[str, SiteLine]) -> LaneSpec:
    """Return one lane."""
    fields = StrictMapping(where, f'lanes[{index}]', data,
                           ('name', 'right', 'left', 'path', 'speed_limit', 'class_limits',
                            'path_std'))
    keys = ('path',) if 'path' in fields else ('right', 'left')
    if 'path' in fields and ('right' in fields or 'left' in fields):
        raise fields.error('path', 'right or left too', 'either path, or right and left')
    names = {key: fields.choice(key, lines) for key in keys}
    if len(set(names.values())) < len(names):
        raise fields.error('left', f'the same line {names["left"]} as right', 'another line')
    classes = StrictMapping(where, f'lanes[{index}].class_limits',
                            fields.data.get('class_limits', {}), CLASSES)
    return LaneSpec(fields.text('name'), names.get('right'), names.get('left'), names.get('path'),
                    fields.speed('speed_limit'),
                    {VehicleClass(key): classes.speed(key) for key in classes.data},
                    fields.number('path_std', 0.0, MOST_PATH_STD, 'share')
                    if 'path_std' in fields else 0.0)
