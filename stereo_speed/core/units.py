# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Units that people read; inside, everything is SI."""
from __future__ import annotations

from dataclasses import dataclass
import math
import sys
from typing import Optional, Union

MPH_MPS = 0.44704  # one mile per hour in m/s, exact
KMH_MPS = 1 / 3.6  # one kilometre per hour in m/s
NS_S = 1e-9  # one nanosecond in s

_UNITS = {'mph': MPH_MPS, 'km/h': KMH_MPS, 'm/s': 1.0}

SPEED_UNITS = tuple(_UNITS)


@dataclass(frozen=True)
class SpeedUnit:
    """
    The unit that speeds are shown in to people; files and topics have m/s.

    :param name: ``mph``, ``km/h`` or ``m/s``.
    """

    name: str = 'mph'

    @property
    def mps(self) -> float:
        """Return one of it in m/s."""
        return _UNITS[self.name]

    def of(self, speed_mps: Optional[float], digits: int = 2) -> str:
        """Return a speed as a number of this unit; a dash where there is none."""
        return '-' if speed_mps is None else f'{speed_mps / self.mps:.{digits}f}'

    def signed(self, speed_mps: Optional[float], digits: int = 2) -> str:
        """Return a difference of speeds with its sign; a dash where there is none."""
        return '-' if speed_mps is None else f'{speed_mps / self.mps:+.{digits}f}'


def parse_speed(text: str) -> float:
    """
    Turn ``'55 mph'``, ``'80 km/h'`` or ``'22.2 m/s'`` into m/s.

    :raises ValueError: when the text is none of these, or not a positive finite number.
    """
    number, _, unit = str(text).strip().partition(' ')
    factor = _UNITS.get(unit.strip())
    value = float(number) * factor if factor else math.nan
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{text!r} is not a speed like '55 mph', '80 km/h' or '22.2 m/s'")
    return value


def is_finite(value: Union[int, float]) -> bool:
    """
    Return whether a number is one that a float can hold.

    ``math.isfinite`` alone fails on whole numbers that are too large, as a file may have them.
    """
    return abs(value) <= sys.float_info.max  # false for NaN


def seconds(stamp_ns: int, origin_ns: int) -> float:
    """Time since ``origin_ns`` in s; exact to the ns because the difference is taken first."""
    return (stamp_ns - origin_ns) * NS_S
