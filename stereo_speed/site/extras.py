# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Optional parts of a site file beside lines and lanes: extrinsic drift and known lengths."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Collection, Optional, Union

import numpy as np

from ..core.errors import SiteError
from ..core.records import Array
from ..core.strict_yaml import StrictMapping
from ..road.problem import RoadPrior

MOST_CORRECTION_DEG = 1.0  # larger corrections are mistakes in the file
ANGLES = ('pan_deg', 'tilt_deg', 'roll_deg')
_ROUNDING_DEG2 = 1e-12  # largest negative eigenvalue that rounding to four digits may cause


@dataclass(frozen=True, eq=False)
class RigCorrection:
    """
    The extrinsic drift: the rotation of the right camera since the calibration.

    :param drift_rad: (3,) pan to the right, tilt upwards, roll clockwise, rad.
    :param covariance_rad2: (3, 3) its covariance, rad^2.
    """

    drift_rad: Array
    covariance_rad2: Array


@dataclass(frozen=True)
class LinesApart:
    """
    The distance between two lines.

    :param lines: names of the lines.
    """

    lines: tuple[str, str]


@dataclass(frozen=True)
class DashPeriod:
    """
    The length of a dash together with its gap.

    :param line: name of the dashed line.
    """

    line: str


@dataclass(frozen=True, eq=False)
class PointsApart:
    """
    The distance between two points.

    :param left_px: (2, 2) the two points in the raw left view, px.
    :param right_px: (2, 2) the same two points in the raw right view, px.
    :param pick_std_px: 1-sigma of each point, px; None for that of careful clicks.
    """

    left_px: Array
    right_px: Array
    pick_std_px: Optional[float]


@dataclass(frozen=True)
class KnownLength:
    """
    A known length, by which the site can be checked.

    :param name: name of the length, for messages.
    :param length_m: known length, m.
    :param std_m: its 1-sigma, m.
    :param of: what has this length.
    """

    name: str
    length_m: float
    std_m: float
    of: Union[LinesApart, DashPeriod, PointsApart]


def as_calibrated(prior: RoadPrior = RoadPrior()) -> RigCorrection:
    """
    Return the correction of a rig that has not been checked since its calibration: none.

    :param prior: gives the 1-sigma of the angles since the calibration.
    """
    return RigCorrection(np.zeros(3), prior.calibrated_covariance_rad2)


def read_correction(where: object, data: Any) -> RigCorrection:
    """
    Return the ``rig_correction`` of a site file.

    :raises SiteError: names the first fault.
    """
    fields = StrictMapping(where, 'rig_correction', data, (*ANGLES, 'covariance_deg2'))
    most = MOST_CORRECTION_DEG
    drift = np.radians([fields.number(key, -most, most, 'degrees') for key in ANGLES])
    covariance = fields.points('covariance_deg2', 3, 3)
    if covariance.shape != (3, 3) or not np.allclose(covariance, covariance.T, rtol=1e-3) \
            or np.linalg.eigvalsh(covariance).min() < -_ROUNDING_DEG2:
        raise fields.error('covariance_deg2', covariance.tolist(), 'a 3x3 covariance')
    return RigCorrection(drift, covariance * np.radians(1.0)**2)


def read_length(where: object, index: int, data: Any, lines: Collection[str]) -> KnownLength:
    """
    Return one of the ``known_lengths`` of a site file.

    :param index: index in the list.
    :param lines: names of all lines of the site.
    :raises SiteError: names the first fault.
    """
    kinds = ('between', 'dashes', 'left_image')
    fields = StrictMapping(where, f'known_lengths[{index}]', data, (
        'name', 'length_m', 'std_m', *kinds, 'right_image', 'pick_std_px'))
    given = [key for key in kinds if key in fields]
    if len(given) != 1:
        raise SiteError(where, f'known_lengths[{index}]', ' and '.join(given) or 'none of them',
                        'one of ' + ', '.join(kinds))
    of: Union[LinesApart, DashPeriod, PointsApart]
    if given == ['left_image']:
        of = PointsApart(
            fields.points('left_image', 2, 2, 2), fields.points('right_image', 2, 2, 2),
            fields.number('pick_std_px', 1e-3, 10.0, 'px') if 'pick_std_px' in fields
            else None)
    elif given == ['dashes']:
        of = DashPeriod(fields.choice('dashes', lines))
    else:
        first, second = _two_lines(fields, lines)
        of = LinesApart((first, second))
    return KnownLength(fields.text('name') if 'name' in fields else f'known_lengths[{index}]',
                       fields.number('length_m', 0.01, 1e4, 'm'),
                       fields.number('std_m', 1e-6, 1e3, 'm'), of)


def _two_lines(fields: StrictMapping, lines: Collection[str]) -> list[str]:
    """Return the names of two different lines."""
    names = fields.choices('between', lines)
    if len(names) != 2 or names[0] == names[1]:
        raise fields.error('between', names, 'two lines')
    return names
