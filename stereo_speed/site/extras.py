# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What a site file may say beyond lines and lanes: a turned camera, and known lengths."""
from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any, Collection, Optional

import numpy as np

from ..core.errors import SiteError
from ..core.records import Array
from ..core.strict_yaml import StrictMapping, kind

MOST_TURN_DEG = 1.0
CALIBRATED_STD_DEG = 0.0003  # of an angle between the cameras that nobody has touched
ANGLES = ('pan_deg', 'tilt_deg', 'roll_deg')


@dataclass(frozen=True, eq=False)
class RigCorrection:
    """
    How the right camera has turned since the calibration, by what the lines of the site say.

    :param turn_rad: (3,) pan to the right, tilt upwards, roll clockwise.
    :param covariance_rad2: (3, 3) of what is left uncertain.
    """

    turn_rad: Array
    covariance_rad2: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownLength:
    """
    A length that somebody knows: between two lines, of a dash and its gap, or of two points.

    :param name: for messages.
    :param length_m: what is known.
    :param std_m: its 1-sigma.
    :param between: names of two lines, or None.
    :param dashes: name of a dashed line, whose dash and gap together are meant, or None.
    :param left_px: (2, 2) two points in the left raw view, or None.
    :param right_px: (2, 2) the same two points in the right raw view.
    :param pick_std_px: 1-sigma of those points.
    """

    name: str
    length_m: float
    std_m: float
    between: Optional[tuple[str, str]] = None
    dashes: Optional[str] = None
    left_px: Optional[Array] = None
    right_px: Optional[Array] = None
    pick_std_px: float = 0.3


def as_calibrated() -> RigCorrection:
    """Give what is known of a rig that nobody has looked at since its calibration."""
    return RigCorrection(np.zeros(3), np.radians(CALIBRATED_STD_DEG) ** 2 * np.eye(3))


def _number(fields: StrictMapping, key: str, low: float, high: float, unit: str) -> float:
    """Read a number within bounds."""
    value = fields.data.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) \
            or not math.isfinite(value) or not low <= value <= high:
        raise fields.error(key, kind(value), f'{unit} in [{low:g}, {high:g}]')
    return float(value)


def read_correction(where: object, data: Any) -> RigCorrection:
    """
    Read ``rig_correction``.

    :raises SiteError: names the first fault.
    """
    fields = StrictMapping(where, 'rig_correction', data, (*ANGLES, 'covariance_deg2'))
    turn = np.radians([_number(fields, key, -MOST_TURN_DEG, MOST_TURN_DEG, 'degrees')
                       for key in ANGLES])
    covariance = fields.points('covariance_deg2', 3, 3)
    if covariance.shape != (3, 3) or not np.allclose(covariance, covariance.T, rtol=1e-3) \
            or np.linalg.eigvalsh(covariance).min() < -1e-12:
        raise fields.error('covariance_deg2', covariance.tolist(), 'a 3x3 covariance')
    return RigCorrection(turn, covariance * np.radians(1.0)**2)


def read_length(where: object, index: int, data: Any, lines: Collection[str]) -> KnownLength:
    """
    Read one of ``known_lengths``.

    :param index: its place in the list.
    :param lines: names of the lines there are.
    :raises SiteError: names the first fault.
    """
    kinds = ('between', 'dashes', 'left_image')
    fields = StrictMapping(where, f'known_lengths[{index}]', data, (
        'name', 'length_m', 'std_m', *kinds, 'right_image', 'pick_std_px'))
    given = [key for key in kinds if key in fields]
    if len(given) != 1:
        raise SiteError(where, f'known_lengths[{index}]', ' and '.join(given) or 'none of them',
                        'one of ' + ', '.join(kinds))
    common = {'length_m': _number(fields, 'length_m', 0.01, 1e4, 'm'),
              'std_m': _number(fields, 'std_m', 1e-6, 1e3, 'm'),
              'name': fields.text('name') if 'name' in fields else f'known_lengths[{index}]'}
    if given == ['left_image']:
        points = [fields.points(key, 2, 2) for key in ('left_image', 'right_image')]
        for key, value in zip(('left_image', 'right_image'), points):
            if len(value) != 2:
                raise fields.error(key, f'{len(value)} points', '2')
        std = _number(fields, 'pick_std_px', 1e-3, 10.0, 'px') if 'pick_std_px' in fields else 0.3
        return KnownLength(**common, left_px=points[0], right_px=points[1], pick_std_px=std)
    names = [fields.text('dashes')] if given == ['dashes'] else fields.listed('between')
    for name in names:
        if name not in lines:
            raise fields.error(given[0], kind(name), 'one of ' + ', '.join(lines))
    if given == ['dashes']:
        return KnownLength(**common, dashes=names[0])
    if len(names) != 2 or names[0] == names[1]:
        raise fields.error('between', names, 'two lines')
    return KnownLength(**common, between=(names[0], names[1]))
