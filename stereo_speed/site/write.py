# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Writing of site files."""
from __future__ import annotations

from typing import Any

import numpy as np
import yaml

from .extras import ANGLES, DashPeriod, KnownLength, LinesApart, RigCorrection
from .file import LaneSpec, Site, SiteLine, SurveyedLine
from ..core.records import Array
from ..core.units import KMH_MPS, MPH_MPS, parse_speed

_LEAST_STD_PX = 1e-4  # smallest 1-sigma that four digits can represent


def site_text(site: Site) -> str:
    """
    Return the text of a site file, as YAML.

    :param site: the site; :func:`.file.load_site` would read it back from the file.
    """
    data: dict[str, Any] = {'stereo_speed_site': 1, 'name': site.name}
    data['lines'] = {name: _line(line) for name, line in site.lines.items()}
    data['lanes'] = [_lane(lane) for lane in site.lanes]
    if site.correction is not None:
        data['rig_correction'] = _correction(site.correction)
    if site.known_lengths:
        data['known_lengths'] = [_length(known) for known in site.known_lengths]
    if site.tolerances:
        data['tolerances'] = dict(site.tolerances)
    if site.calibrated is not None:
        data['calibrated'] = site.calibrated
    return str(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=99))


def _rounded(values: Array, digits: int) -> list[Any]:
    """Return rounded numbers as plain lists."""
    return list(np.round(values, digits).tolist())


def _line(line: SiteLine) -> dict[str, Any]:
    """Return one line as a mapping."""
    if isinstance(line, SurveyedLine):
        points = {'points_m': _rounded(line.points_m, 6)}
        return points if line.std_m is None else {**points, 'std_m': line.std_m}
    out = {'left_image': _rounded(line.left_px, 4), 'right_image': _rounded(line.right_px, 4)}
    for key, std in (('left_std_px', line.left_std_px), ('right_std_px', line.right_std_px)):
        if std is not None:
            out[key] = _rounded(np.maximum(std, _LEAST_STD_PX), 4)
    return out


def _lane(lane: LaneSpec) -> dict[str, Any]:
    """Return one lane as a mapping."""
    out: dict[str, Any] = {'name': lane.name}
    out.update({key: getattr(lane, key) for key in ('right', 'left', 'path')
                if getattr(lane, key) is not None})
    out['speed_limit'] = speed_text(lane.speed_limit_mps)
    if lane.class_limits_mps:
        out['class_limits'] = {str(name): speed_text(limit)
                               for name, limit in lane.class_limits_mps.items()}
    if lane.path_std:
        out['path_std'] = float(f'{lane.path_std:.4g}')
    return out


def speed_text(speed_mps: float) -> str:
    """Return a speed as text for a site file, in the unit that gives the roundest number."""
    for unit, name in ((MPH_MPS, 'mph'), (KMH_MPS, 'km/h'), (1.0, 'm/s')):
        text = f'{speed_mps / unit:.9g} {name}'
        if len(text) < 10 and abs(parse_speed(text) / speed_mps - 1) < 1e-9:
            return text
    return f'{speed_mps!r} m/s'


def _correction(correction: RigCorrection) -> dict[str, Any]:
    """Return the correction of the rig as a mapping."""
    out: dict[str, Any] = {key: round(float(value), 6) for key, value in zip(
        ANGLES, np.degrees(correction.drift_rad))}
    covariance = correction.covariance_rad2 * np.degrees(1.0)**2
    out['covariance_deg2'] = [[float(f'{value:.4g}') for value in row] for row in covariance]
    return out


def _length(known: KnownLength) -> dict[str, Any]:
    """Return one known length as a mapping."""
    out: dict[str, Any] = {'name': known.name, 'length_m': known.length_m, 'std_m': known.std_m}
    if isinstance(known.of, LinesApart):
        out['between'] = list(known.of.lines)
    elif isinstance(known.of, DashPeriod):
        out['dashes'] = known.of.line
    else:
        out['left_image'] = _rounded(known.of.left_px, 4)
        out['right_image'] = _rounded(known.of.right_px, 4)
        if known.of.pick_std_px is not None:
            out['pick_std_px'] = known.of.pick_std_px
    return out
