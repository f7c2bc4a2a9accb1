# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Units for people to read; internally, everything is SI."""
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
    The unit in which speeds are shown to people; files and topics use m/s.

    :param name: ``mph``, ``km/h`` or ``m/s``.
    """

    name: str = 'mph'

    @property
    def mps(self) -> float:
        """Return the size of the unit in m/s."""
        return _UNITS[self.name]

    def of(self, speed_mps: Optional[float], digits: int = 2) -> str:
        """Return a speed as text in this unit; a dash for None."""
        return '-' if speed_mps is None else f'{speed_mps / self.mps:.{digits}f}'

    def signed(self, speed_mps: Optional[float], digits: int = 2) -> str:
        """Return a difference of speeds as text in this unit, with sign; a dash for None."""
        return '-' if speed_mps is None else f'{speed_mps / self.mps:+.{digits}f}'


def parse_speed(text: str) -> float:
    """
    Return a speed such as ``'55 mph'``, ``'80 km/h'`` or ``'22.2 m/s'`` in m/s.

    :raises ValueError: another form, or a number that is not positive and finite.
    """
    number, _, unit = str(text).strip().partition(' ')
    factor = _UNITS.get(unit.strip())
    value = float(number) * factor if factor else math.nan
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{text!r} is not a speed like '55 mph', '80 km/h' or '22.2 m/s'")
    return value


def is_finite(value: Union[int, float]) -> bool:
    """
    Return whether a number is finite and can be held by a float.

    ``math.isfinite`` fails on integers that are too large for a float, which a file may contain.
    """
    return abs(value) <= sys.float_info.max  # false for NaN


def seconds(stamp_ns: int, origin_ns: int) -> float:
    """Return the time since ``origin_ns``, s; subtracting integers keeps it exact to 1 ns."""
    return (stamp_ns - origin_ns) * NS_S
