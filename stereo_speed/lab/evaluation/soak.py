# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Long live runs: each vehicle of each round is measured once, without growth of resources."""
from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
import math
import os
from pathlib import Path
from typing import Any, Mapping, Optional, Sequence

import numpy as np

from .associate import distance
from .tables import Table
from .traffic import TrafficRules
from ...core.errors import InputError
from ...core.records import Array
from ...core.units import MPH_MPS
from ...io.csv_rows import read_rows
from ...io.truth import VehicleTruth

Place = tuple[int, tuple[float, float, float]]  # stamp ns; x, y, z in the left optical frame, m
Reading = tuple[int, float, float]  # stamp ns; speed and its 1-sigma, m/s


@dataclass(frozen=True, kw_only=True)
class SoakRules:
    """
    The criteria for a long run.

    :param warm_share: share of the run, from its start, in which memory may still grow.
    :param growth_mb: greatest growth of a node's memory over the rest, by its trend, MB.
    :param late_s: greatest delay of tracks up to which memory is judged, because waiting pairs
        occupy memory.
    :param handles: greatest growth of a node's open files, sockets and threads over the rest.
    :param wrong_mps: error above which a pass is wrong.
    :param reading_mps: error above which a live reading may be wrong.
    :param reading_sigmas: the same in sigmas; a wrong reading exceeds both.
    :param p95_ms: greatest 95th percentile of the delays of live readings, ms; None if they are
        not judged.
    """

    warm_share: float = 0.25
    growth_mb: float = 10.0
    late_s: float = 5.0
    handles: int = 3
    wrong_mps: float = TrafficRules().wrong_mps
    reading_mps: float = MPH_MPS
    reading_sigmas: float = 4.0
    p95_ms: Optional[float] = None

    def is_wrong(self, error_mps: float, std_mps: float) -> bool:
        """Return whether a live reading with such an error and 1-sigma is wrong, m/s."""
        return abs(error_mps) > max(self.reading_mps, self.reading_sigmas * std_mps)


@dataclass(frozen=True, kw_only=True)
class Sample:
    """
    The resources of a process at a time.

    :param at_s: monotonic time.
    :param memory_mb: anonymous memory, MB.  It excludes mapped files and the segments of DDS,
        whose size is fixed.  Unlike private memory, it does not grow when a fork becomes the
        only owner of pages that it shared.
    :param handles: open files and sockets.
    :param threads: number of threads.
    """

    at_s: float
    memory_mb: float
    handles: int
    threads: int


def sample_of(pid: int, at_s: float) -> Sample:
    """
    Return the resources of a process.

    :param pid: id of the process.
    :param at_s: monotonic time.
    :raises OSError: there is no such process.
    """
    folder = Path('/proc') / str(pid)
    status = dict(line.split(':', 1) for line in (folder / 'smaps_rollup').read_text(
        ).splitlines()[1:])
    return Sample(at_s=at_s, memory_mb=int(status['Anonymous'].split()[0]) / 1024,
                  handles=len(os.listdir(folder / 'fd')),
                  threads=len(os.listdir(folder / 'task')))


@dataclass(frozen=True, kw_only=True)
class Held:
    """
    The resources of a node over a run, after its warm-up.

    :param node: name of the node.
    :param first_mb: memory at the beginning by its trend, MB.
    :param growth_mb: growth to the end by its trend, MB.
    :param most_mb: greatest memory of the whole run, MB.
    :param handles: number of handles at the beginning and at the end.
    :param threads: number of threads at the beginning and at the end.
    """

    node: str
    first_mb: float
    growth_mb: float
    most_mb: float
    handles: tuple[int, int]
    threads: tuple[int, int]

    @classmethod
    def of(cls, node: str, samples: Sequence[Sample], rules: SoakRules) -> Held:
        """Return the resources from the samples of a run, at least four."""
        if len(samples) < 4:
            raise InputError('soak', node, f'{len(samples)} samples', 'a run of some seconds')
        start_s, end_s = samples[0].at_s, samples[-1].at_s
        since_s = start_s + rules.warm_share * (end_s - start_s)
        late = [s for s in samples if s.at_s >= since_s]
        slope, at_start = np.polyfit([s.at_s - since_s for s in late],
                                     [s.memory_mb for s in late], 1)
        return cls(node=node, first_mb=float(at_start),
                   growth_mb=float(slope * (end_s - since_s)),
                   most_mb=max(s.memory_mb for s in samples),
                   handles=(late[0].handles, late[-1].handles),
                   threads=(late[0].threads, late[-1].threads))

    def faults(self, rules: SoakRules, in_time: bool = True) -> list[str]:
        """Return a line for each resource that grew; memory counts only if nodes kept up."""
        found = []
        if in_time and self.growth_mb > rules.growth_mb:
            found.append(f'{self.node}: memory grew by {self.growth_mb:.1f} MB, at most '
                         f'{rules.growth_mb:g} are allowed')
        for name, (before, after) in (('handles', self.handles), ('threads', self.threads)):
            if after - before > rules.handles:
                found.append(f'{self.node}: {name} grew from {before} to {after}')
        return found


@dataclass(frozen=True, eq=False)
class Seen:
    """
    A track in a pair.

    :param stamp_ns: stamp of the pair.
    :param position_m: (3,), centre of the front, left optical frame.
    """

    stamp_ns: int
    position_m: Array


class Rounds:
    """
    Scores the passes of a repeated stream against its truth.

    :param truth: the vehicles of a round.
    :param counted: numbers of the vehicles that are well seen for long enough to be measured.
    :param round_ns: time from a stamp to the same one of the next round, ns.
    :param start_ns: stamp of the first pair of the first round.
    """

    def __init__(self, truth: Sequence[VehicleTruth], counted: set[int], round_ns: int,
                 start_ns: int) -> None:
        self._truth, self._counted = truth, counted
        self._round_ns, self._start_ns = round_ns, start_ns
        self.measured: Counter[tuple[int, int]] = Counter()
        self.rejected: set[tuple[int, int]] = set()
        self.reasons: Counter[str] = Counter()
        self.errors_mps: list[float] = []
        self.reading_errors: list[tuple[float, float]] = []  # error and 1-sigma, m/s
        self.astray = 0
        self.readings_astray = 0

    def add(self, told: Mapping[str, Any], places: Sequence[Place],
            readings: Sequence[Reading] = ()) -> None:
        """
        Add a pass.

        :param told: JSON object of the pass.
        :param places: positions of its track.
        :param readings: live readings of its track.
        """
        measured = told['verdict'] == 'measured'
        if not places and not measured:
            return  # its track was never published
        number = (int(told['first_stamp_ns']) - self._start_ns) // self._round_ns
        seen = [Seen(ns - number * self._round_ns, np.array(at)) for ns, at in places]
        vehicle = self._vehicle(seen)
        if vehicle is None:
            self.astray += measured
            self.readings_astray += len(readings)
            return
        true_mps = vehicle.speed_at([ns - number * self._round_ns for ns, *_ in readings])
        self.reading_errors += [
            (mps - true, std_mps)
            for (_, mps, std_mps), true in zip(readings, true_mps.tolist())
            if math.isfinite(true)]
        key = (number, vehicle.vehicle)
        if not measured:
            self.rejected.add(key)
            self.reasons[str(told['reason'])] += 1
            return
        self.measured[key] += 1
        first, last = (int(told[f'{end}_stamp_ns']) - number * self._round_ns
                       for end in ('first', 'last'))
        during = (vehicle.stamps_ns >= first) & (vehicle.stamps_ns <= last)
        self.errors_mps.append(
            float(told['speed_mps']) - float(vehicle.speed_mps[during].mean()))

    def _vehicle(self, places: Sequence[Seen]) -> Optional[VehicleTruth]:
        """Return the vehicle nearest to positions of a track, within the gate."""
        distances = [distance(places, truth) for truth in self._truth]
        best = int(np.argmin(distances))
        return self._truth[best] if distances[best] <= 1.0 else None

    def counts(self, rounds: int) -> dict[str, int]:
        """
        Return the counts of the vehicles over all rounds.

        :param rounds: number of complete rounds.
        """
        wanted = {(number, v) for number in range(rounds) for v in self._counted}
        seen = {key: n for key, n in self.measured.items() if key in wanted}
        return {'vehicles': len(wanted), 'once': sum(n == 1 for n in seen.values()),
                'more': sum(n > 1 for n in seen.values()),
                'rejected': len((self.rejected & wanted) - set(seen)),
                'missed': len(wanted - set(seen) - self.rejected), 'astray': self.astray}

    def wrong(self, rules: SoakRules) -> int:
        """Return how many passes have a greater error than the rules allow."""
        return sum(abs(error) > rules.wrong_mps for error in self.errors_mps)

    def wrong_readings(self, rules: SoakRules) -> int:
        """Return how many live readings are off by more than the rules allow, both ways."""
        return sum(rules.is_wrong(error, std) for error, std in self.reading_errors)

    @property
    def worst_reading(self) -> tuple[float, float]:
        """Return the greatest error of a live reading, mph, and the greatest one in sigmas."""
        if not self.reading_errors:
            return float('nan'), float('nan')
        error, std = np.abs(self.reading_errors).T
        return float(error.max() / MPH_MPS), float((error / std).max())

    @property
    def worst_mph(self) -> float:
        """Return the greatest error of a pass, mph; NaN without passes."""
        return max((abs(e) / MPH_MPS for e in self.errors_mps), default=float('nan'))


def counted_vehicles(path: Path, truth: Sequence[VehicleTruth]) -> set[int]:
    """
    Return the vehicles that are well seen for long enough, by the columns of ``truth.csv``.

    :param path: path of the file.
    :param truth: its content; without those columns all vehicles count.
    """
    columns, rows = read_rows(path, 'truth.csv')
    if not {'visible', 'in_view', 'width_px', 'stamp', 'vehicle'} <= set(columns):
        return {t.vehicle for t in truth}

    def number(row: Any, name: str) -> float:
        return float(row.number(name, 'a number', -1e12, 1e12))
    return TrafficRules().counted([{
        'vehicle': int(number(row, 'vehicle')), 'stamp_ns': round(number(row, 'stamp') * 1e9),
        **{name: number(row, name) for name in ('in_view', 'width_px', 'visible')}}
        for row in rows])


def lost_pairs(found_ns: Sequence[int], round_ns: Sequence[int], period_ns: int, rounds: int
               ) -> tuple[int, int]:
    """
    Return the number of pairs, and how many of them were lost.

    :param found_ns: stamps of the pairs that were measured.
    :param round_ns: stamps of the pairs of the first round.
    :param period_ns: time from a stamp to the same one of the next round, ns.
    :param rounds: number of complete rounds.
    """
    wanted = {ns + number * period_ns for number in range(rounds) for ns in round_ns}
    return len(wanted), len(wanted - set(found_ns))


def held_table(held: Sequence[Held], minutes: float) -> Table:
    """Tabulate the resources of the nodes over a run."""
    return Table(
        title=f'Memory and handles of {minutes:.0f} minutes',
        columns=['node', 'memory, MB', 'trend of growth, MB', 'peak, MB', 'handles, threads',
                 'at the end'],
        rows=[[h.node, h.first_mb, h.growth_mb, h.most_mb,
               f'{h.handles[0]}, {h.threads[0]}', f'{h.handles[1]}, {h.threads[1]}']
              for h in held], digits=[0, 1, 1, 1, 0, 0])


@dataclass(frozen=True, kw_only=True)
class Soaked:
    """
    The result of a long run.

    :param minutes: duration.
    :param pairs: number of pairs sent, and of those lost.
    :param delays_s: delays from sending a pair to its tracks.
    :param reading_delays_s: delays from sending a pair to each live speed.
    :param readings: number of live speeds.
    :param rounds: the scored passes.
    :param played: number of complete rounds.
    :param held: resources of each node.
    :param skipped: number of pairs that the measuring node skipped, by its ``/diagnostics``.
    :param hurried: number of pairs that it hurried.
    :param overloaded: whether the nodes were overloaded on purpose.
    """

    minutes: float
    pairs: tuple[int, int]
    delays_s: Sequence[float] = field(default_factory=list)
    reading_delays_s: Sequence[float] = field(default_factory=list)
    readings: int = 0
    rounds: Rounds
    played: int
    held: Sequence[Held]
    skipped: int = 0
    hurried: int = 0
    overloaded: bool = False

    @property
    def longest_s(self) -> float:
        """Return the longest time from sending a pair to its tracks, s."""
        return max(self.delays_s, default=0.0)

    def notes(self, rules: SoakRules) -> list[str]:
        """Return notes on criteria that could not be judged."""
        notes = [] if self.longest_s <= rules.late_s else [
            f'memory was NOT JUDGED: the machine did not keep up, tracks came up to '
            f'{self.longest_s:.0f} s late, and waiting pairs take memory']
        if self.overloaded:
            notes.append('skipped pairs, and vehicles that were not measured, were NOT JUDGED: '
                         'the nodes were overloaded on purpose')
        return notes

    def table(self) -> Table:
        """Tabulate the counts of pairs and passes."""
        counts = self.rounds.counts(self.played)
        return Table(
            title='', columns=[
                'minutes', 'pairs', 'lost', 'vehicles', 'measured once', 'more than once',
                'rejected', 'missed', 'on no vehicle', 'worst error, mph', 'live readings'],
            rows=[[self.minutes, *self.pairs, *counts.values(), self.rounds.worst_mph,
                   self.readings]],
            digits=[1, *(0,) * 8, 2, 0])

    def delays_table(self) -> Table:
        """Tabulate the delays from sending a pair to its readings and tracks."""
        return Table(
            title='', columns=['s after the pair was sent', 'median', 'p95', 'p99', 'longest'],
            rows=[[what, *np.percentile(delays or [np.nan], [50, 95, 99, 100])]
                  for what, delays in (('live readings', self.reading_delays_s),
                                       ('all tracks of a pair', self.delays_s))],
            digits=[0, 3, 3, 3, 3])

    def readings_table(self, rules: SoakRules) -> Table:
        """Tabulate how far the node kept up, and the errors of its live readings and passes."""
        rounds = self.rounds
        return Table(
            title='', columns=[
                'pairs skipped', 'hurried', 'longest delay of a reading, s', 'readings compared',
                'wrong', 'on no vehicle', 'worst error, mph', 'worst error, sigma',
                'passes measured', 'wrong passes'],
            rows=[[self.skipped, self.hurried, max(self.reading_delays_s, default=float('nan')),
                   len(rounds.reading_errors), rounds.wrong_readings(rules),
                   rounds.readings_astray, *rounds.worst_reading,
                   len(rounds.errors_mps), rounds.wrong(rules)]],
            digits=[0, 0, 2, 0, 0, 0, 2, 1, 0, 0])

    def faults(self, rules: SoakRules) -> list[str]:
        """Return a line for each violated criterion."""
        counts, wrong = self.rounds.counts(self.played), self.rounds.wrong(rules)
        in_time = self.longest_s <= rules.late_s
        found = [line for held in self.held for line in held.faults(rules, in_time)]
        found += self._late(rules)
        if self.pairs[1] and not self.overloaded:
            found.append(f'{self.pairs[1]} of {self.pairs[0]} pairs were lost')
        if counts['once'] < counts['vehicles'] and not self.overloaded:
            found.append(f'{counts["once"]} of {counts["vehicles"]} vehicles were measured once'
                         + ''.join(f', {n} rejected as {reason}'
                                   for reason, n in sorted(self.rounds.reasons.items())))
        if counts['astray']:
            found.append(f'{counts["astray"]} passes on no vehicle')
        if wrong:
            found.append(f'{wrong} passes are off by more than {rules.wrong_mps:.2f} m/s')
        wrong_readings = self.rounds.wrong_readings(rules)
        if wrong_readings:
            found.append(f'{wrong_readings} live readings are off by more than '
                         f'{rules.reading_mps:.2f} m/s and {rules.reading_sigmas:g} sigma')
        if self.rounds.readings_astray:
            found.append(f'{self.rounds.readings_astray} live readings on no vehicle')
        return found

    def _late(self, rules: SoakRules) -> list[str]:
        """Return a line if live readings were too late, where that is judged."""
        if rules.p95_ms is None:
            return []
        if not self.reading_delays_s:
            return ['there is no live reading whose delay could be judged']
        p95_ms = 1e3 * float(np.percentile(self.reading_delays_s, 95))
        return [] if p95_ms <= rules.p95_ms else [
            f'95th percentile of the delay of live readings is {p95_ms:.1f} ms, at most '
            f'{rules.p95_ms:g} are allowed']
