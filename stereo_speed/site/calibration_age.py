# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""How old the calibration of a rig is, by the date that its site file gives and the stamps."""
from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime, timezone
from typing import Optional

MONTH_DAYS = 365.2425 / 12
_WARN_MONTHS = 1.0  # before it expires


@dataclass(frozen=True)
class CalibrationAge:
    """
    What a calibration's age means.

    :param text: of one that is old, in a few words; empty where nothing is to be said.
    :param expired: whether nothing may be measured with it any more.
    """

    text: str = ''
    expired: bool = False


def calibration_age(calibrated: Optional[date], stamp_ns: int, months: float) -> CalibrationAge:
    """
    Return what the age of a calibration means for a pair.

    :param calibrated: day of the calibration; None where the site file gives none.
    :param stamp_ns: of the pair, since 1970 in UTC.
    :param months: for which a calibration holds; in the last of them it warns.
    """
    if calibrated is None:
        return CalibrationAge()
    day = datetime.fromtimestamp(stamp_ns // 10 ** 9, timezone.utc).date()
    old = (day - calibrated).days / MONTH_DAYS
    if old < 0:
        return CalibrationAge(f'calibrated on {calibrated}, after the pairs of {day}', True)
    if old > months:
        return CalibrationAge(f'calibrated on {calibrated}, more than {months:g} months before '
                              f'{day}: expired', True)
    if old > months - _WARN_MONTHS:
        return CalibrationAge(f'calibrated on {calibrated}: expires after {months:g} months')
    return CalibrationAge()
