# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The self-test: the pipeline in use measures a stored pass of known speed."""
from __future__ import annotations

from dataclasses import dataclass
import re
from typing import Callable, Iterable, Optional

from .assembly import MeasuringSite
from .config import PipelineConfig
from .run import run
from ..core.errors import InputError
from ..core.passes import Verdict
from ..core.records import StereoPair
from ..geometry.rig import StereoRig
from ..site.file import Site

LIMIT_SHARE = 0.01  # OIML R 91, 7.5: within 1 % of the simulated speed
_PASSED = re.compile(r'self-test passed: ([+-]\d+\.\d+) % off')


@dataclass(frozen=True)
class SelfTest:
    """
    The result of a self-test.

    :param known_mps: speed of the stored pass, m/s.
    :param first_mps: measured speed, m/s; None where the pass was rejected.
    :param second_mps: second estimate of the speed, m/s; None where there was none.
    :param found: what is wrong, in a few words; empty if nothing is.
    """

    known_mps: float
    first_mps: Optional[float]
    second_mps: Optional[float]
    found: str

    @property
    def passed(self) -> bool:
        """Return whether the instrument may measure."""
        return not self.found

    @property
    def line(self) -> str:
        """Return the result as one line, which :func:`off_percent` reads."""
        if not self.passed or self.first_mps is None:
            return f'self-test failed: {self.found}'
        second = 'no second estimate' if self.second_mps is None else (
            f'second estimate {100 * (self.second_mps / self.known_mps - 1):+.2f} %')
        return (f'self-test passed: {100 * (self.first_mps / self.known_mps - 1):+.2f} % off, '
                f'{second}')


def off_percent(line: str) -> Optional[float]:
    """Return the speed error, %, from the line of a passed self-test; None for other lines."""
    found = _PASSED.match(line)
    return None if found is None else float(found[1])


def self_test(site: Site, rig: StereoRig, pairs: Callable[[], Iterable[StereoPair]],
              known_mps: float, config: PipelineConfig) -> SelfTest:
    """
    Measure a stored pass with its vehicle detected, and compare with its known speed.

    :param site: the site where it was recorded.
    :param rig: the rig that recorded it.
    :param pairs: returns its pairs, which show one vehicle.
    :param known_mps: its mean speed, m/s.
    :param config: tracker, detector and parameters of the instrument.
    :raises InputError: a stored pass that cannot be used.
    """
    if not known_mps > 0:
        raise InputError('self-test', 'known speed', f'{known_mps} m/s', 'more than 0')
    place = MeasuringSite.of(site, rig, None, config.site, rest_by=pairs)
    passes = run(place.pipeline(config), pairs()).passes
    if len(passes) != 1:
        return SelfTest(known_mps, None, None, f'{len(passes)} passes measured instead of one')
    one = passes[0]
    second = None if one.second is None else one.second.speed_mps
    if one.verdict is not Verdict.MEASURED or one.speed_mps is None:
        return SelfTest(known_mps, None, second, f'the stored pass is rejected: {one.reason}')
    off = one.speed_mps / known_mps - 1
    found = '' if abs(off) <= LIMIT_SHARE else (
        f'the stored pass of {known_mps:.3f} m/s is measured as {one.speed_mps:.3f} m/s, '
        f'{100 * off:+.2f} %')
    return SelfTest(known_mps, one.speed_mps, second, found)
