# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Score tracks of many vehicles against exact truth.

Tracks and vehicles are matched one to one by their places over time, so that a vehicle with two
tracks, a track on nothing and a track that jumps from one vehicle to another all show.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Iterable, Mapping, Optional, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from ...core.records import Array, PassResult, TrackState, TrackUpdate, Verdict
from ...core.units import MPH_MPS

# A track is on a vehicle when it is this near: to the side of the line of sight, along it (the
# greater of both), and up or down, where a part of a tall face may be tracked.
GATE_SIDE_M, GATE_UP_M = 1.2, 2.5
GATE_DEPTH_M, GATE_DEPTH_SHARE = 2.0, 0.06
SEEN_PX, SEEN_SHARE = 40.0, 0.7  # a vehicle is well seen when its face is so wide and so clear
SEEN_S, SEEN_PAIRS = 0.8, 4  # and counts when it was for so long, in so many pairs
WRONG_MPS = 1.0 * MPH_MPS
SURE_OF_LANE_M = 1.3  # this near to a lane's path there is no doubt which lane it is
SHARE_OF_TRACK = 0.5  # a track is a second one of a vehicle when it spent this share on it


@dataclass
class Vehicle:
    """
    What is true of a vehicle.

    :param number: of the vehicle.
    :param speeds: stamp, ns, to ground speed, m/s, wherever its face's centre is in view.
    :param clear_ns: stamps at which it was well seen.
    """

    number: int
    speeds: dict[int, float] = field(default_factory=dict)
    clear_ns: list[int] = field(default_factory=list)

    @property
    def counts(self) -> bool:
        """Whether it was well seen for long enough to be measured."""
        seen = self.clear_ns
        return len(seen) >= SEEN_PAIRS and (seen[-1] - seen[0]) * 1e-9 >= SEEN_S


@dataclass
class Track:
    """
    What was said of a track.

    :param number: of the track.
    :param stamps_ns: stamps of its updates.
    :param confirmed: whether it ever was.
    :param result: its pass, when there is one.
    :param votes: vehicle to how well and how often the track was on it.
    """

    number: int
    stamps_ns: list[int] = field(default_factory=list)
    confirmed: bool = False
    result: Optional[PassResult] = None
    votes: dict[int, float] = field(default_factory=dict)

    @property
    def measured(self) -> bool:
        """Whether it ended in a speed."""
        return self.result is not None and self.result.verdict is Verdict.MEASURED

    @property
    def counts(self) -> bool:
        """Whether anybody heard of it: a tentative track that ends is nothing."""
        return self.confirmed or self.measured


@dataclass(frozen=True, kw_only=True)
class TrafficScore:
    """
    How well traffic was measured.

    :param vehicles: that were well seen for long enough.
    :param brief: that were not, and are in none of the next four.
    :param once: measured once.
    :param split: measured more than once.
    :param rejected: followed, but no speed given.
    :param missed: nobody heard of.
    :param false_tracks: confirmed tracks or measured passes on no vehicle.
    :param wrong: measured passes more than 1 mph off.
    :param errors_mps: error of each measured pass on a vehicle, m/s.
    :param sigmas: the same in 1-sigmas of their own.
    :param live_mps: error of each confirmed reading, m/s.
    :param lanes_wrong: confirmed readings with the wrong lane, away from the lines.
    :param lanes_sure: confirmed readings away from the lines.
    """

    vehicles: int
    brief: int
    once: int
    split: int
    rejected: int
    missed: int
    false_tracks: int
    wrong: int
    errors_mps: Array
    sigmas: Array
    live_mps: Array
    lanes_wrong: int
    lanes_sure: int


class TrafficScorer:
    """
    Gathers truth and tracks pair by pair, and scores them at the end.

    :param lane_names: name of each lane, by its index in the truth.
    """

    def __init__(self, lane_names: Sequence[str]) -> None:
        self._names = tuple(lane_names)
        self._vehicles: dict[int, Vehicle] = {}
        self._tracks: dict[int, Track] = {}
        self._live: list[tuple[int, int, float, str]] = []
        self._lanes: dict[tuple[int, int], Optional[str]] = {}

    def add(self, truth: Iterable[Mapping[str, Any]], updates: Iterable[TrackUpdate]) -> None:
        """
        Take in a pair.

        :param truth: rows as of ``sim.TrafficPair``.
        :param updates: of the pipeline.
        """
        rows = list(truth)
        for row in rows:
            number, stamp_ns = row['vehicle'], row['stamp_ns']
            vehicle = self._vehicles.setdefault(number, Vehicle(number))
            vehicle.speeds[stamp_ns] = row['speed']
            if row['in_view'] and row['width_px'] >= SEEN_PX and row['visible'] >= SEEN_SHARE:
                vehicle.clear_ns.append(stamp_ns)
            sure = abs(row['lateral']) <= SURE_OF_LANE_M
            self._lanes[number, stamp_ns] = self._names[row['lane']] if sure else None
        for update in updates:
            track = self._tracks.setdefault(update.track, Track(update.track))
            track.stamps_ns.append(update.stamp_ns)
            if update.state is TrackState.CONFIRMED:
                track.confirmed = True
                self._live.append(
                    (update.track, update.stamp_ns, update.speed_mps, update.lane))
            for row in rows:
                vote = nearness(update.position_m, np.array([row[k] for k in 'xyz']))
                if vote > 0:
                    track.votes[row['vehicle']] = track.votes.get(row['vehicle'], 0.0) + vote

    def close(self, passes: Iterable[PassResult]) -> None:
        """Take in results of passes."""
        for result in passes:
            self._tracks.setdefault(result.track, Track(result.track)).result = result

    def score(self) -> TrafficScore:
        """Match and count."""
        tracks = [t for t in self._tracks.values() if t.counts]
        on = _match(tracks, list(self._vehicles))
        main = set(on.values())
        # What the one-to-one matching left over is a second track of a vehicle, or on nothing.
        for track in tracks:
            if track.number not in on and track.votes:
                number = max(track.votes, key=lambda n: track.votes[n])
                if number in main and track.votes[number] > SHARE_OF_TRACK * sum(
                        0.5 for _ in track.stamps_ns):
                    on[track.number] = number
        return self._count(tracks, on)

    def _count(self, tracks: list[Track], on: Mapping[int, int]) -> TrafficScore:
        """Count, given which vehicle each track is on."""
        heard: dict[int, list[Track]] = {n: [] for n in self._vehicles}
        for track in tracks:
            if track.number in on:
                heard[on[track.number]].append(track)
        counted = [n for n, v in self._vehicles.items() if v.counts]
        measured = {n: sum(t.measured for t in heard[n]) for n in counted}
        off = [_error(t, self._vehicles[on[t.number]]) for t in tracks
               if t.measured and t.number in on]
        errors = np.array([e for e in off if e is not None]).reshape(-1, 2)
        live, sure, wrong_lanes = [], 0, 0
        for number, stamp_ns, speed_mps, lane in self._live:
            vehicle = self._vehicles.get(on.get(number, -1))
            if vehicle is None or stamp_ns not in vehicle.speeds:
                continue
            live.append(speed_mps - vehicle.speeds[stamp_ns])
            true = self._lanes[vehicle.number, stamp_ns]
            sure += true is not None
            wrong_lanes += true is not None and true != lane
        return TrafficScore(
            vehicles=len(counted), brief=len(self._vehicles) - len(counted),
            once=sum(measured[n] == 1 for n in counted),
            split=sum(measured[n] > 1 for n in counted),
            rejected=sum(measured[n] == 0 and bool(heard[n]) for n in counted),
            missed=sum(not heard[n] for n in counted),
            false_tracks=sum(t.number not in on for t in tracks),
            wrong=int((np.abs(errors[:, 0]) > WRONG_MPS).sum()),
            errors_mps=errors[:, 0], sigmas=errors[:, 1], live_mps=np.array(live),
            lanes_wrong=wrong_lanes, lanes_sure=sure)


def nearness(track_m: Array, true_m: Array) -> float:
    """
    Say how well a track is on a vehicle: 1 on its centre, 0 from the gate on.

    :param track_m: (3,) centre of the tracked face, left optical frame.
    :param true_m: (3,) the true one.
    """
    reach = float(np.linalg.norm(true_m))
    ray = true_m / reach
    gap = np.asarray(track_m) - true_m
    along = float(gap @ ray)
    side, up, _ = gap - along * ray  # the camera's x and y: rigs stand about upright
    shares = (along / max(GATE_DEPTH_M, GATE_DEPTH_SHARE * reach), side / GATE_SIDE_M,
              up / GATE_UP_M)
    return max(0.0, 1.0 - float(np.linalg.norm(shares)))


def _match(tracks: list[Track], vehicles: list[int]) -> dict[int, int]:
    """Match tracks and vehicles one to one; those that never met stay out."""
    column = {number: j for j, number in enumerate(vehicles)}
    votes = np.zeros((len(tracks), len(vehicles)))
    for i, track in enumerate(tracks):
        for number, vote in track.votes.items():
            votes[i, column[number]] = vote
    rows, columns = linear_sum_assignment(-votes)
    return {tracks[i].number: vehicles[j] for i, j in zip(rows, columns)
            if votes[i, j] > SHARE_OF_TRACK * 0.5 * len(tracks[i].stamps_ns)}


def _error(track: Track, vehicle: Vehicle) -> Optional[tuple[float, float]]:
    """Return the error of a pass, m/s, and in its own 1-sigmas; None where truth is silent."""
    result = track.result
    if result is None or result.speed_mps is None:
        return None
    # A speed is the mean over its own pairs: those before it was found count, gaps do not.
    true = [vehicle.speeds[s] for s in result.smoothed or track.stamps_ns if s in vehicle.speeds]
    if not true:
        return None
    off = result.speed_mps - float(np.mean(true))
    return off, off / result.speed_std_mps if result.speed_std_mps else np.nan


HEADER = ('| traffic | vehicles | measured once | more than once | rejected | missed '
          '| false tracks | wrong by > 1 mph | error: mean ± sd, mph | worst, mph '
          '| r.m.s. of error/σ | readings r.m.s., mph | wrong lane | seen too briefly '
          '| ms per pair |\n' + '|---' * 15 + '|')


def row(name: str, score: TrafficScore, pair_ms: float) -> str:
    """
    Give a line of the Markdown table below ``HEADER``.

    :param name: of the stream.
    :param pair_ms: processor time of the pipeline for a pair, ms.
    """
    def rms(values: Array) -> float:
        return float(np.sqrt(np.nanmean(np.square(values))))
    errors, live = score.errors_mps / MPH_MPS, score.live_mps / MPH_MPS
    shown = ([f'{errors.mean():+.3f} ± {errors.std():.3f}', f'{np.abs(errors).max():.3f}',
              f'{rms(score.sigmas):.2f}'] if len(errors) else ['-'] * 3)
    shown.append(f'{rms(live):.2f}' if len(live) else '-')
    lanes = f'{score.lanes_wrong} of {score.lanes_sure}'
    counts = (score.vehicles, score.once, score.split, score.rejected, score.missed,
              score.false_tracks, score.wrong)
    return '| ' + ' | '.join([name, *map(str, counts), *shown, lanes, str(score.brief),
                              f'{pair_ms:.1f}']) + ' |'
