# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Score a stream of traffic against exact truth.

The score shows vehicles with two tracks, tracks on nothing, and tracks that jump between vehicles.
"""
from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any, Iterable, Mapping, Sequence

from .associate import vehicles_of
from .metrics import mean_and_std, pass_error, pass_figures, PassFigures, reading_figures
from .scorer import by_track, vehicle_run
from .tables import mph, Table
from ...core.passes import PassResult, Verdict
from ...core.records import TrackState, TrackUpdate
from ...core.units import MPH_MPS
from ...io.truth import truth_of_rows

Row = Mapping[str, Any]  # of truth.csv, and its stamp_ns


@dataclass(frozen=True, kw_only=True)
class TrafficRules:
    """
    The rules for counting traffic.

    :param seen_px: least width of the front of a well-seen vehicle.
    :param seen_share: least unoccluded share of that front.
    :param seen_s: time for which a vehicle must be well seen to count.
    :param seen_pairs: number of pairs in which it must be well seen.
    :param wrong_mps: error above which a pass is wrong.
    :param sure_of_lane_m: distance from a lane's path up to which the lane is beyond doubt.
    """

    seen_px: float = 40.0
    seen_share: float = 0.7
    seen_s: float = 0.8
    seen_pairs: int = 4
    wrong_mps: float = 1.0 * MPH_MPS
    sure_of_lane_m: float = 1.3

    def counted(self, rows: Iterable[Row]) -> set[int]:
        """Return the vehicles that were well seen for long enough to be measured."""
        seen: dict[int, list[int]] = {}
        for row in rows:
            if row['in_view'] and row['width_px'] >= self.seen_px \
                    and row['visible'] >= self.seen_share:
                seen.setdefault(row['vehicle'], []).append(row['stamp_ns'])
        return {vehicle for vehicle, stamps in seen.items() if len(stamps) >= self.seen_pairs
                and (stamps[-1] - stamps[0]) * 1e-9 >= self.seen_s}


@dataclass(frozen=True, kw_only=True)
class TrafficScore:
    """
    The score of a stream of traffic.

    :param vehicles: vehicles that were well seen for long enough.
    :param brief: vehicles that were not, and are in none of the next four groups.
    :param once: vehicles measured once.
    :param split: vehicles measured more than once.
    :param rejected: vehicles tracked, but without a speed.
    :param missed: vehicles never reported.
    :param false_tracks: confirmed tracks or measured passes on no vehicle.
    :param wrong: measured passes with a greater error than the rules allow.
    :param lanes_wrong: confirmed readings with the wrong lane, away from the lines.
    :param lanes_sure: confirmed readings away from the lines.
    :param passes: errors of the passes on vehicles.
    :param live_rms_mps: r.m.s. error of the confirmed readings; NaN without readings.
    """

    vehicles: int
    brief: int
    once: int
    split: int
    rejected: int
    missed: int
    false_tracks: int
    wrong: int
    lanes_wrong: int
    lanes_sure: int
    passes: PassFigures
    live_rms_mps: float


def score_traffic(rows: Sequence[Row], updates: Iterable[TrackUpdate],
                  passes: Iterable[PassResult], lanes: Sequence[str],
                  rules: TrafficRules = TrafficRules()) -> TrafficScore:
    """
    Match tracks and vehicles, and count.

    :param rows: the truth, in the form of ``sim.TrafficPair``.
    :param updates: updates of the pipeline.
    :param passes: passes of the pipeline.
    :param lanes: name of each lane, by its index in the truth.
    :param rules: rules for counting.
    """
    truths = {truth.vehicle: truth for truth in truth_of_rows(rows)}
    results = {result.track: result for result in passes}
    # Tracks that were never more than tentative are not reported.
    tracks = {number: track for number, track in by_track(updates).items()
              if any(u.state is TrackState.CONFIRMED for u in track)
              or number in results and results[number].verdict is Verdict.MEASURED}
    on = vehicles_of(tracks, list(truths.values()))
    runs = [vehicle_run(truths[on[n]], track, results.get(n))
            for n, track in tracks.items() if n in on]
    counted = rules.counted(rows)
    followed = counted & {run.vehicle for run in runs}
    measured = Counter(run.vehicle for run in runs if run.measured)
    sure = {(row['vehicle'], row['stamp_ns']): lanes[row['lane']] for row in rows
            if abs(row['lateral']) <= rules.sure_of_lane_m}
    right = [u.lane == sure[on[n], u.stamp_ns] for n, track in tracks.items() if n in on
             for u in track if u.state is TrackState.CONFIRMED and (on[n], u.stamp_ns) in sure]
    return TrafficScore(
        vehicles=len(counted), brief=len(truths) - len(counted),
        once=sum(measured[n] == 1 for n in counted), split=sum(measured[n] > 1 for n in counted),
        rejected=sum(measured[n] == 0 for n in followed), missed=len(counted - followed),
        false_tracks=len(tracks) - len(runs),
        wrong=sum(abs(pass_error(run)) > rules.wrong_mps for run in runs),
        lanes_wrong=right.count(False), lanes_sure=len(right),
        passes=pass_figures(runs), live_rms_mps=reading_figures(runs).rms_mps)


def traffic_table(name: str, score: TrafficScore, pair_ms: float) -> Table:
    """
    Return the table of one stream.

    :param name: name of the stream.
    :param pair_ms: processor time of the pipeline per pair, ms.
    """
    return Table(title='', columns=(
        'traffic', 'vehicles', 'measured once', 'more than once', 'rejected', 'missed',
        'false tracks', 'wrong by > 1 mph', 'error: mean ± sd, mph', 'worst, mph',
        'r.m.s. of error/σ', 'readings r.m.s., mph', 'wrong lane', 'seen too briefly',
        'ms per pair'), rows=[[
            name, score.vehicles, score.once, score.split, score.rejected, score.missed,
            score.false_tracks, score.wrong,
            mean_and_std(score.passes.mean_mps, score.passes.std_mps),
            mph(score.passes.max_mps), score.passes.sigma_ratio, mph(score.live_rms_mps),
            f'{score.lanes_wrong} of {score.lanes_sure}', score.brief, pair_ms]],
        digits=(0,) * 9 + (3, 2, 2, 0, 0, 1))
