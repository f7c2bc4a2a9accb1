# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What a site file may have beyond lines and lanes: extrinsic drift, and known lengths."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Collection, Optional, Union

import numpy as np

from ..core.errors import SiteError
from ..core.records import Array
from ..core.strict_yaml import StrictMapping
from ..road.problem import RoadPrior

MOST_CORRECTION_DEG = 1.0  # a correction of more is a slip of whoever wrote the file
ANGLES = ('pan_deg', 'tilt_deg', 'roll_deg')
_ROUNDING_DEG2 = 1e-12  # by which a covariance may miss being one in four printed digits


@dataclass(frozen=True, eq=False)
class RigCorrection:
    """
    The extrinsic drift: how the right camera has rotated since the calibration.

    :param drift_rad: (3,) pan to the right, tilt upwards, roll clockwise.
    :param covariance_rad2: (3, 3) of what is left uncertain.
    """

    drift_rad: Array
    covariance_rad2: Array


@dataclass(frozen=True)
class LinesApart:
    """
    The distance of two lines.

    :param lines: their names.
    """

    lines: tuple[str, str]


@dataclass(frozen=True)
class DashPeriod:
    """
    A dash and its gap together.

    :param line: name of the dashed line.
    """

    line: str


@dataclass(frozen=True, eq=False)
class PointsApart:
    """
    The distance of two points.

    :param left_px: (2, 2) the two points in the left raw view.
    :param right_px: (2, 2) the same two points in the right raw view.
    :param pick_std_px: 1-sigma of each; None for careful clicks.
    """

    left_px: Array
    right_px: Array
    pick_std_px: Optional[float]


@dataclass(frozen=True)
class KnownLength:
    """
    A length that somebody knows.

    :param name: for messages.
    :param length_m: what is known.
    :param std_m: its 1-sigma.
    :param of: what is as long.
    """

    name: str
    length_m: float
    std_m: float
    of: Union[LinesApart, DashPeriod, PointsApart]


def as_calibrated(prior: RoadPrior = RoadPrior()) -> RigCorrection:
    """
    Return what is known of a rig that nobody has looked at since its calibration.

    :param prior: how well angles stay as calibrated.
    """
    return RigCorrection(np.zeros(3), prior.calibrated_covariance_rad2)


def read_correction(where: object, data: Any) -> RigCorrection:
    """
    Read ``rig_correction``.

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
    """Read the names of two lines."""
    names = fields.choices('between', lines)
    if len(names) != 2 or names[0] == names[1]:
        raise fields.error('between', names, 'two lines')
    return names
