# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Decide whether a pass is a violation, from three separate figures: measured, considered, limit.

When in doubt there is no record, and the reason is counted.
"""
from __future__ import annotations

from dataclasses import dataclass
from datetime import date
import math
from typing import Container, Optional, Sequence

import numpy as np

from .config import DecisionConfig
from ..core.passes import PassResult, SecondEstimate, VehicleClass, VehicleKind, Verdict
from ..core.records import Array, Word
from ..core.trace import PassTrace
from ..core.units import KMH_MPS, SpeedUnit
from ..site.calibration_age import calibration_age
from ..site.file import LaneSpec

_ROUNDING = 1e-9  # guards whole numbers of a unit against the rounding of m/s


class NoRecord(Word):
    """Reason why there is no record of a pass."""

    BELOW_LIMIT = 'below_limit'
    WITHIN_MARGIN = 'within_margin'
    NOT_MEASURED = 'not_measured'
    NO_LIMIT = 'no_limit'
    OUTSIDE_INTERVAL = 'outside_interval'
    NO_SECOND_ESTIMATE = 'no_second_estimate'
    SECOND_DISAGREES = 'second_disagrees'
    CALIBRATION_EXPIRED = 'calibration_expired'
    NOT_TRACED = 'not_traced'
    TOO_SHORT = 'too_short'
    AMBIGUOUS = 'ambiguous'
    NOT_APPROVED = 'not_approved'
    IMAGES_MISSING = 'images_missing'
    IMAGES_REPEATED = 'images_repeated'
    NOT_REPRODUCIBLE = 'not_reproducible'
    NOT_STORED = 'not_stored'


@dataclass(frozen=True)
class Decision:
    """
    The figures of a decision; those shown to people are whole numbers.

    :param unit: ``km/h`` or ``mph``.
    :param speed_mps: the lower of the two estimates.
    :param tolerance_mps: tolerance subtracted for measurement errors.
    :param margin_mps: margin, from its sigmas, by which the rest must exceed the limit.
    :param limit_mps: the greatest limit of the vehicle's lanes.
    :param measured: the speed, rounded down.
    :param considered: the speed minus tolerance, rounded down.
    """

    unit: str
    speed_mps: float
    tolerance_mps: float
    margin_mps: float
    limit_mps: float
    measured: int
    considered: int

    @property
    def limit(self) -> float:
        """Return the limit in the unit."""
        return round(self.limit_mps / SpeedUnit(self.unit).mps, 6)


def limit_mps(lanes: Sequence[LaneSpec], names: Sequence[str], vehicle: Optional[VehicleKind],
              config: DecisionConfig) -> Optional[float]:
    """
    Return the greatest limit that may apply to a vehicle; None where a lane has none.

    :param lanes: lanes of the site.
    :param names: names of the lanes that the vehicle was in.
    :param vehicle: its class; None where it is unknown.
    :param config: parameters, for the least class probability.
    """
    known = {lane.name: lane for lane in lanes}
    if not all(name in known for name in names):
        return None
    sure = vehicle is not None and vehicle.probability >= config.least_class_probability
    kind = vehicle.name if vehicle is not None and sure else VehicleClass.UNKNOWN
    return max(known[name].limit_mps(kind) for name in names)


def decide(result: PassResult, limit_mps: Optional[float], config: DecisionConfig
           ) -> tuple[Optional[Decision], Optional[NoRecord]]:
    """
    Decide by the figures of a pass; :func:`ambiguity` checks for other vehicles.

    :param result: the pass.
    :param limit_mps: the greatest limit of its lanes; None where there is none.
    :param config: tolerance, margin and interval.
    :return: the figures, if any, and the reason for no record; the reason is None for a violation.
    """
    first, std = result.speed_mps, result.speed_std_mps
    if result.verdict is not Verdict.MEASURED or first is None or std is None:
        return None, NoRecord.NOT_MEASURED
    if limit_mps is None:
        return None, NoRecord.NO_LIMIT
    speed = min([first, *([] if result.second is None or result.second.speed_mps is None
                          else [result.second.speed_mps])])
    tolerance = tolerance_mps(speed, config)
    unit = SpeedUnit(config.unit).mps
    figures = Decision(
        config.unit, speed, tolerance, config.margin_sigmas * std, limit_mps,
        _down(speed / unit), max(_down((speed - tolerance) / unit), 0))
    return figures, _refusal(figures, first, std, result.second, config)


def tolerance_mps(speed_mps: float, config: DecisionConfig) -> float:
    """Return the tolerance subtracted from a speed for measurement errors, m/s."""
    return max(config.tolerance_kmh * KMH_MPS, 0.01 * config.tolerance_percent * speed_mps)


def _refusal(figures: Decision, first_mps: float, std_mps: float,
             second: Optional[SecondEstimate], config: DecisionConfig) -> Optional[NoRecord]:
    """Return the reason why a measured pass gets no record; None for a violation."""
    unit = SpeedUnit(figures.unit).mps
    threshold = (figures.limit_mps + config.threshold_kmh * KMH_MPS) / unit
    if not figures.considered > threshold + _ROUNDING:
        return NoRecord.BELOW_LIMIT
    if not config.least_kmh <= first_mps / KMH_MPS <= config.most_kmh:
        return NoRecord.OUTSIDE_INTERVAL
    if figures.speed_mps - figures.tolerance_mps - figures.margin_mps <= figures.limit_mps:
        return NoRecord.WITHIN_MARGIN
    if second is None or second.speed_mps is None:
        return NoRecord.NO_SECOND_ESTIMATE if config.demand_second_estimate else None
    apart = abs(first_mps - second.speed_mps)
    sigma = math.hypot(std_mps, second.speed_std_mps or 0.0)
    if apart > config.second_apart_kmh * KMH_MPS or apart > config.second_sigmas * sigma:
        return NoRecord.SECOND_DISAGREES
    return None


def _down(value: float) -> int:
    """Return a number rounded down, tolerating the rounding errors of unit conversion."""
    return math.floor(value + _ROUNDING)


def calibration_refusal(calibrated: Optional[date], last_ns: int, config: DecisionConfig
                        ) -> Optional[NoRecord]:
    """
    Return the reason why a calibration does not allow enforcement; None where it does.

    :param calibrated: date of the calibration; None where the site file has none.
    :param last_ns: stamp of the last pair of the pass.
    :param config: parameters, for the greatest age.
    """
    if calibrated is None:
        return NoRecord.CALIBRATION_EXPIRED if config.demand_calibration_date else None
    expired = calibration_age(calibrated, last_ns, config.calibration_months).expired
    return NoRecord.CALIBRATION_EXPIRED if expired else None


def ambiguity(trace: PassTrace, measured_ns: Container[int], config: DecisionConfig
              ) -> Optional[NoRecord]:
    """
    Return the reason why the evidence of a pass is ambiguous or too short; None where it is not.

    In no pair may the front of another track, however young, come near the measured front in
    either image, because then the marked image region would show both vehicles.

    :param trace: trace of the pass.
    :param measured_ns: stamps of the pairs from which the speed is measured.
    :param config: parameters, for the clearance and the least duration.
    """
    shown = trace.shown(measured_ns)
    if len(shown) < 2 or (shown[-1].stamp_ns - shown[0].stamp_ns) * 1e-9 < config.evidence_span_s:
        return NoRecord.TOO_SHORT
    for pair in trace.pairs:
        if pair.update is None:
            continue
        for own, theirs in ((pair.update.quad_left_px, [o.left_px for o in pair.others]),
                            (pair.update.quad_right_px, [o.right_px for o in pair.others])):
            if any(_touch(own, other, config.clear_share) for other in theirs):
                return NoRecord.AMBIGUOUS
    return None


def _touch(own_px: Array, other_px: Array, share: float) -> bool:
    """Return whether the box of another front (4, 2) comes near the box of this one (4, 2)."""
    size = np.ptp(own_px, axis=0)
    low, high = own_px.min(axis=0) - share * size, own_px.max(axis=0) + share * size
    return bool(np.all(other_px.max(axis=0) > low) and np.all(other_px.min(axis=0) < high))
