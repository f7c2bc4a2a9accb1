# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reading of site files: lines, lanes and what is known of the rig."""
from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path as FilePath
from typing import Mapping, Optional, Union

import numpy as np

from .checks import crossing, turned_back
from .extras import KnownLength, read_correction, read_length, RigCorrection
from ..core.config import check_tolerance, TOLERANCES
from ..core.errors import SiteError
from ..core.records import Array
from ..core.strict_yaml import StrictMapping, kind, load_yaml
from ..core.units import parse_speed
from ..geometry.rig import StereoRig

LEAST_ROAD_M = 5.0
MOST_STD_PX = 100.0
VIEWS = ('left_image', 'right_image')


@dataclass(frozen=True, eq=False)
class SiteLine:
    """
    A line of the road: picked in both views, or surveyed.

    :param name: of the line.
    :param left_px: (n, 2) raw pixels in order along travel, or None.
    :param right_px: (m, 2) raw pixels in order along travel, picked independently, or None.
    :param points_m: (k, 3) surveyed points, left optical frame, or None.
    :param left_std_px: (n,) 1-sigmas of the left points across the line; None for clicks.
    :param right_std_px: (m,) the same of the right ones.
    """

    name: str
    left_px: Optional[Array] = None
    right_px: Optional[Array] = None
    points_m: Optional[Array] = None
    left_std_px: Optional[Array] = None
    right_std_px: Optional[Array] = None


@dataclass(frozen=True)
class LaneSpec:
    """
    A lane as the file gives it: its two lines, or the line that is its path.

    :param name: of the lane.
    :param right: line on the driver's right, or None.
    :param left: line on the driver's left, or None.
    :param path: line that is the path itself, or None.
    :param speed_limit_mps: m/s.
    """

    name: str
    right: Optional[str]
    left: Optional[str]
    path: Optional[str]
    speed_limit_mps: float

    @property
    def lines(self) -> tuple[str, ...]:
        """Names of its lines: the path, or right and left."""
        return tuple(n for n in (self.path, self.right, self.left) if n is not None)


@dataclass(frozen=True, eq=False)
class Site:
    """
    A site file.

    :param where: the file, for messages.
    :param name: of the site; the file's stem where it gives none.
    :param lines: by name.
    :param lanes: in the file's order.
    :param correction: turn of the right camera since its calibration; None where nobody looked.
    :param known_lengths: to be checked.
    :param tolerances: parameters of the tracker that are the rig's: 1-sigmas of focal length,
        baseline and stamps, where the file gives them.
    """

    where: str
    name: str
    lines: Mapping[str, SiteLine]
    lanes: tuple[LaneSpec, ...]
    correction: Optional[RigCorrection] = None
    known_lengths: tuple[KnownLength, ...] = ()
    tolerances: Mapping[str, float] = field(default_factory=dict)

    def corrected_rig(self, rig: StereoRig) -> StereoRig:
        """
        Give the rig as it stands now; what measures at this site takes this one.

        :param rig: as calibrated, or one that this function has corrected already.
        """
        if self.correction is None or not np.any(self.correction.turn_rad) \
                or self.fits(rig):
            return rig
        return rig.turned(self.correction.turn_rad)

    def fits(self, rig: StereoRig) -> bool:
        """Say whether a rig is one that :meth:`corrected_rig` gives."""
        turn = np.zeros(3) if self.correction is None else self.correction.turn_rad
        return bool(np.allclose(rig.turn_rad, turn, rtol=0, atol=1e-12))


def load_site(path: Union[str, FilePath]) -> Site:
    """
    Read a site file.

    :raises SiteError: names the first fault.
    """
    data = load_yaml(path, 'stereo_speed_site')
    top = StrictMapping(path, '', data, ('stereo_speed_site', 'name', 'lines', 'lanes',
                                  'rig_correction', 'known_lengths', 'tolerances'))
    name = top.text('name') if 'name' in top else FilePath(path).stem
    raw = data.get('lines')
    if not isinstance(raw, Mapping) or not raw:
        raise top.error('lines', 'none' if not raw else repr(raw), 'a mapping of named lines')
    for key in raw:
        if not isinstance(key, str):
            raise top.error('lines', f'name {key!r}', 'names that are texts')
    lines = {key: _line(path, key, value) for key, value in raw.items()}
    _refuse_crossings(path, lines)
    lanes = tuple(_lane(path, i, value, lines) for i, value in enumerate(top.listed('lanes')))
    for a, b in combinations(lanes, 2):
        if a.name == b.name:
            raise top.error('lanes', f'two lanes named {a.name}', 'a name for each')
    correction = read_correction(path, data['rig_correction']) \
        if 'rig_correction' in top else None
    lengths = tuple(read_length(path, i, value, lines) for i, value in enumerate(
        top.listed('known_lengths'))) if 'known_lengths' in top else ()
    given = StrictMapping(path, 'tolerances', data.get('tolerances', {}), TOLERANCES).data
    tolerances = {key: check_tolerance(key, value, path) for key, value in given.items()}
    return Site(str(path), name, lines, lanes, correction, lengths, tolerances)


def _line(where: object, name: str, data: object) -> SiteLine:
    """Read one line and refuse points out of order."""
    stds = tuple(f'{view[:-6]}_std_px' for view in VIEWS)
    fields = StrictMapping(where, f'lines.{name}', data, (*VIEWS, 'points_m', *stds))
    if 'points_m' in fields:
        if any(view in fields for view in VIEWS + stds):
            raise fields.error('points_m', 'image picks as well', 'either one')
        points = {'points_m': fields.points('points_m', 3, 2)}
    else:
        points = {view: fields.points(view, 2, 2) for view in VIEWS}
    for key, value in points.items():
        bad = turned_back(value)
        if bad is not None:
            raise fields.error(f'{key}[{bad}]', 'a point behind the one before it',
                               'points in order along travel')
    if 'points_m' in points:
        length = np.linalg.norm(np.diff(points['points_m'], axis=0), axis=-1).sum()
        if length < LEAST_ROAD_M:
            raise fields.error('points_m', f'{length:.1f} m', f'at least {LEAST_ROAD_M} m of road')
        return SiteLine(name, points_m=points['points_m'])
    left, right = (_stds(fields, std, len(points[view])) for view, std in zip(VIEWS, stds))
    return SiteLine(name, points['left_image'], points['right_image'],
                    left_std_px=left, right_std_px=right)


def _stds(fields: StrictMapping, key: str, count: int) -> Optional[Array]:
    """Read the 1-sigmas of a line's points, one for each."""
    if key not in fields:
        return None
    values = fields.listed(key)
    for i, value in enumerate(values):
        if isinstance(value, bool) or not isinstance(value, (int, float)) \
                or not 0 < value <= MOST_STD_PX:
            raise fields.error(f'{key}[{i}]', kind(value), f'px in (0, {MOST_STD_PX}]')
    if len(values) != count:
        raise fields.error(key, f'{len(values)} numbers', f'{count}, one for each point')
    return np.array(values, dtype=np.float64)


def _refuse_crossings(where: object, lines: Mapping[str, SiteLine]) -> None:
    """Refuse lines that cross themselves or each other in a view."""
    picked = [line for line in lines.values() if line.points_m is None]
    for view, key in zip(VIEWS, ('left_px', 'right_px')):
        for line in picked:
            points = getattr(line, key)
            at = crossing(points, points)
            if at:
                raise SiteError(where, f'lines.{line.name}.{view}',
                                f'picks {at[0]} and {at[1]} where the line crosses itself',
                                'points in order along travel')
        for a, b in combinations(picked, 2):
            if np.array_equal(getattr(a, key), getattr(b, key)[::-1]):
                continue  # one line, once for each direction of travel
            at = crossing(getattr(a, key), getattr(b, key))
            if at:
                raise SiteError(where, f'lines.{a.name}.{view}',
                                f'a crossing with {b.name} after picks {at[0]} and {at[1]}',
                                'lines that do not cross')


def _lane(where: object, index: int, data: object, lines: Mapping[str, SiteLine]) -> LaneSpec:
    """Read one lane."""
    fields = StrictMapping(where, f'lanes[{index}]', data,
                    ('name', 'right', 'left', 'path', 'speed_limit'))
    keys = ('path',) if 'path' in fields else ('right', 'left')
    if 'path' in fields and ('right' in fields or 'left' in fields):
        raise fields.error('path', 'right or left as well', 'path, or right and left')
    names = {key: fields.text(key) for key in keys}
    for key, name in names.items():
        if name not in lines:
            raise fields.error(key, name, 'one of ' + ', '.join(lines))
    if len(set(names.values())) < len(names):
        raise fields.error('left', f'the same line {names["left"]} as right', 'another line')
    try:
        limit = parse_speed(fields.text('speed_limit'))
    except ValueError:
        raise fields.error('speed_limit', repr(fields.data['speed_limit']),
                           "a speed like '55 mph', '80 km/h' or '22.2 m/s'") from None
    return LaneSpec(fields.text('name'), names.get('right'), names.get('left'),
                    names.get('path'), limit)
