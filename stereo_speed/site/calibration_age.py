# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The age of a rig's calibration, from the date in its site file and the stamps of the pairs."""
from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime, timezone
from typing import Optional

MONTH_DAYS = 365.2425 / 12
_WARN_MONTHS = 1.0  # time before the expiry from which to warn


@dataclass(frozen=True)
class CalibrationAge:
    """
    The consequences of a calibration's age.

    :param text: short warning or error; empty if there is none.
    :param expired: whether measuring with the calibration is no longer allowed.
    """

    text: str = ''
    expired: bool = False


def calibration_age(calibrated: Optional[date], stamp_ns: int, months: float) -> CalibrationAge:
    """
    Return whether a calibration is too old for a pair, or about to be.

    :param calibrated: day of the calibration; None if the site file gives none.
    :param stamp_ns: stamp of the pair, ns since 1970 in UTC.
    :param months: time for which a calibration is valid; there is a warning in the last month.
    """
    if calibrated is None:
        return CalibrationAge()
    day = datetime.fromtimestamp(stamp_ns // 10 ** 9, timezone.utc).date()
    old_days = (day - calibrated).days
    old = old_days / MONTH_DAYS
    if old_days < -1:  # the day of a calibration is local, that of a stamp in UTC
        return CalibrationAge(f'calibrated on {calibrated}, after the pairs of {day}', True)
    if old > months:
        return CalibrationAge(f'calibrated on {calibrated}, more than {months:g} months before '
                              f'{day}: expired', True)
    if old > months - _WARN_MONTHS:
        return CalibrationAge(f'calibrated on {calibrated}: expires after {months:g} months')
    return CalibrationAge()
