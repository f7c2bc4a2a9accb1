# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Compare the reports of a tracker on each vehicle with the truth."""
from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Iterable, Mapping, Optional, Sequence

import numpy as np

from .associate import match
from ...core.passes import PassResult, time_shares, Verdict
from ...core.records import TrackState, TrackUpdate
from ...io.truth import VehicleTruth


@dataclass(frozen=True, kw_only=True)
class VehicleRun:
    """
    The reports of a tracker on one vehicle, with the truth.

    :param vehicle: number of the vehicle.
    :param stamps_ns: stamps of the readings; empty when no track was on the vehicle.
    :param speeds_mps: live readings.
    :param confirmed: whether each reading was confirmed; only those are published.
    :param truth_mps: true speeds at the readings; None where unknown.
    :param verdict: verdict on its pass; empty when there was no track.
    :param reason: reason of a rejection.
    :param pass_mps: speed of the pass, when it was measured.
    :param pass_std_mps: its 1-sigma.
    :param pass_truth_mps: mean of the truth over the same pairs.
    :param pairs: number of pairs of the pass.
    :param last_quarter_ns: first stamp of the last quarter of the vehicle's pairs.
    :param told_class: class of the vehicle according to its pass; empty where there is none.
    """

    vehicle: int
    stamps_ns: list[int] = field(default_factory=list)
    speeds_mps: list[float] = field(default_factory=list)
    confirmed: list[bool] = field(default_factory=list)
    truth_mps: list[Optional[float]] = field(default_factory=list)
    verdict: str = ''
    reason: str = ''
    pass_mps: Optional[float] = None
    pass_std_mps: Optional[float] = None
    pass_truth_mps: Optional[float] = None
    pairs: int = 0
    last_quarter_ns: int = 0
    told_class: str = ''

    @property
    def measured(self) -> bool:
        """Return whether its pass was measured."""
        return self.verdict == Verdict.MEASURED.value and self.pass_mps is not None


@dataclass(frozen=True, kw_only=True)
class SequenceRun:
    """
    The reports of a tracker on a sequence.

    :param vehicles: reports on each true vehicle.
    :param cpu_ms: processor time per pair for all tracks, ms, without the final results.
    """

    vehicles: list[VehicleRun]
    cpu_ms: float

    def to_json(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> SequenceRun:
        """Return it from JSON values."""
        return cls(**{**value, 'vehicles': [VehicleRun(**v) for v in value['vehicles']]})


def by_track(updates: Iterable[TrackUpdate]) -> dict[int, list[TrackUpdate]]:
    """Return the updates of each track, in their order."""
    tracks: dict[int, list[TrackUpdate]] = {}
    for update in updates:
        tracks.setdefault(update.track, []).append(update)
    return tracks


def beside_truth(updates: Iterable[TrackUpdate], passes: Iterable[PassResult],
                 truths: Sequence[VehicleTruth]) -> list[VehicleRun]:
    """Match tracks to vehicles, and return the reports on each vehicle."""
    tracks, results = by_track(updates), {result.track: result for result in passes}
    matched = match(tracks, truths)
    return [vehicle_run(truth, tracks.get(matched.get(truth.vehicle, -1), ()),
                        results.get(matched.get(truth.vehicle, -1))) for truth in truths]


def vehicle_run(truth: VehicleTruth, track: Sequence[TrackUpdate],
                result: Optional[PassResult]) -> VehicleRun:
    """
    Compare one track with its vehicle.

    :param track: its updates; empty when no track was on the vehicle.
    :param result: result of its pass, if there is one.
    """
    stamps = [u.stamp_ns for u in track]
    run = VehicleRun(
        vehicle=truth.vehicle, stamps_ns=stamps, speeds_mps=[float(u.speed_mps) for u in track],
        confirmed=[u.state is TrackState.CONFIRMED for u in track],
        truth_mps=[None if np.isnan(v) else float(v) for v in truth.speed_at(stamps)],
        last_quarter_ns=int(truth.stamps_ns[-max(len(truth.stamps_ns) // 4, 1)]))
    if result is None:
        return run
    # The speed is the mean over time from the first pair to the last, including gaps.
    during = sorted(result.smoothed) or [ns for ns in stamps
                                         if result.first_ns <= ns <= result.last_ns]
    true, shares = truth.speed_at(during), time_shares(during)
    known = np.isfinite(true)
    return replace(
        run, verdict=result.verdict.value, reason=result.reason, pass_mps=result.speed_mps,
        pass_std_mps=result.speed_std_mps, pairs=result.pairs,
        told_class='' if result.vehicle is None else result.vehicle.name.value,
        pass_truth_mps=float(np.average(true[known], weights=shares[known]))
        if known.any() else None)
