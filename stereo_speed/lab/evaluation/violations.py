# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Find which passes of faulty traffic become records, and whether any record is wrong.

A record is wrong if the error of its speed exceeds the limit (3 km/h up to 100 km/h, 3 % above),
or if it marks a front that does not belong to its vehicle.
"""
from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
import tempfile
from typing import Any, Iterable, Mapping, Optional, Sequence

import numpy as np

from .associate import nearness
from .labeled_sequence import LineKnowledge
from .tables import Cell, Table
from .traffic import Row, TrafficRules
from .traffic_run import stream_of, traffic_site
from ..sim.config import RigConfig
from ..sim.stream_faults import FAULTS, FaultyStream, SentImage
from ..sim.traffic_config import traffic_config, TrafficConfig
from ...batch.job import Job, Result
from ...core.passes import PassResult, time_shares, Verdict
from ...core.records import Array
from ...core.units import KMH_MPS
from ...enforcement.config import DecisionConfig, EnforcementConfig
from ...enforcement.decision import NoRecord, tolerance_mps
from ...enforcement.fingerprint import Approved
from ...enforcement.instrument import Instrument
from ...enforcement.record import Setting, Violation
from ...enforcement.recorder import EvidenceRecorder
from ...enforcement.ring import ImageRing
from ...enforcement.store import EvidenceStore
from ...io.source_image import SourceImage
from ...pipeline.config import PipelineConfig
from ...pipeline.pipeline import SpeedPipeline
from ...site.write import site_text
from ...survey.reference import error_limit_mps

LIMIT_MPH = 40.0  # speed limit of every lane, at a pace of 1
PACES = (1.0, 0.7, 1.3, 0.5)  # factors of the traffic's speeds, whose means are 45, 53 and 60 mph
SEEN_PX = 20.0  # least width of a well-seen front in these images
BEFORE_S = 14.0  # time from entry to the camera, at a pace of 1
WEATHERS = (('day', False), ('day', True), ('dusk', False), ('overcast', True),
            ('wet_night', True))  # light, and whether bodies have depth
COLUMNS = ('fault', 'passes', 'measured', 'violations', 'recorded', 'share', 'records',
           'unjustified', 'wrong speed', 'wrong vehicle', 'worst error, km/h', 'no record',
           'compared', 'rejected')
_BELOW = (str(NoRecord.BELOW_LIMIT), str(NoRecord.NOT_MEASURED))


@dataclass(frozen=True, kw_only=True)
class ViolationRun:
    """
    The result of one stream.

    :param fault: its fault.
    :param passes: number of reported passes, measured or rejected.
    :param measured: number of measured passes.
    :param violations: number of well-seen vehicles whose true speed is a violation.
    :param recorded: number of these with a record.
    :param records: number of records.
    :param wrong_speed: records with a speed error above the limit of error.
    :param wrong_vehicle: records that mark a front of another vehicle, or of none.
    :param not_violating: records of vehicles that were not above the speed limit.
    :param errors_kmh: error of each record's speed.
    :param no_record: number of passes without a record, by reason.
    :param compared: number of passes with a second estimate, whether it agrees or not.
    :param rejected: number of rejected passes, by reason.
    :param details: a line for each wrong record.
    """

    fault: str
    passes: int = 0
    measured: int = 0
    violations: int = 0
    recorded: int = 0
    records: int = 0
    wrong_speed: int = 0
    wrong_vehicle: int = 0
    not_violating: int = 0
    errors_kmh: Sequence[float] = ()
    no_record: Mapping[str, int] = field(default_factory=dict)
    compared: int = 0
    rejected: Mapping[str, int] = field(default_factory=dict)
    details: Sequence[str] = ()


def violation_jobs(streams: int, seed: int, faults: Sequence[str], vehicles: int = 32,
                   fps: float = 8.0) -> list[Job]:
    """
    Return jobs for streams of half a minute, in which the faults take turns.

    :param streams: number of streams.
    :param seed: seed of all of them.
    :param faults: names from ``FAULTS``.
    :param vehicles: number of vehicles in each stream; not all of them come into view.
    :param fps: pairs per second.
    """
    jobs = []
    for number in range(streams):
        light, outdoors = WEATHERS[(number // len(faults) + number) % len(WEATHERS)]
        jobs.append(Job(key=f'stream{number:04d}', parameters={
            'number': number, 'seed': seed, 'fault': faults[number % len(faults)],
            'light': light, 'outdoors': outdoors,
            'pace': PACES[(number // len(faults)) % len(PACES)],
            'vehicles': vehicles, 'fps': fps}))
    return jobs


def violation_job(parameters: Mapping[str, Any]) -> Mapping[str, Any]:
    """Simulate one stream and decide on its passes; runs in a worker process."""
    config, seed = stream_config(parameters), (parameters['seed'], parameters['number'])
    number = int(np.random.SeedSequence(seed).generate_state(1)[0])
    site = traffic_site(config, number, LineKnowledge.PICKED)
    stream = FaultyStream(stream_of(config, number), parameters['fault'],
                          np.random.default_rng((*seed, 1)))
    measuring = PipelineConfig()
    enforcement = EnforcementConfig()
    with tempfile.TemporaryDirectory() as folder, EvidenceStore(Path(folder, 'records')) as store:
        path = Path(folder, 'site.yaml')
        path.write_text(site_text(site.site), encoding='utf-8')
        site = replace(site, site=replace(site.site, where=str(path)))
        setting = Setting(Instrument.of('simulated', site, measuring), site, enforcement,
                          Approved(), 'header stamps')
        recorder = EvidenceRecorder(store, setting, ImageRing.of(enforcement.evidence))
        decided = decide_stream(stream, site.pipeline(measuring, None, seed=number), recorder)
    return decided.scored(parameters['fault'], stream.truth, site.site.lanes[0].speed_limit_mps)


def stream_config(parameters: Mapping[str, Any]) -> TrafficConfig:
    """Return the traffic of a job: small images, many vehicles, speeds around the limit."""
    pace = parameters['pace']
    rig = RigConfig(width_px=512, height_px=384, f_px=900.0, baseline_m=1.0)
    config = traffic_config(
        parameters['light'], 3, 0, parameters['fps'], 0.5, parameters['vehicles'],
        outdoors=parameters['outdoors'], rig=rig, speed_limit=f'{LIMIT_MPH * pace:g} mph')
    return replace(config, before_s=BEFORE_S / pace, clear_s=2.0, speed_std_mps=3.0,
                   lane_speeds_mps=tuple(pace * speed for speed in config.lane_speeds_mps))


@dataclass
class DecidedStream:
    """
    The passes of a stream, and the decisions on them.

    :param passes: all passes.
    :param found: the violations.
    :param exposures: number of the exposure shown by the pair of each stamp.
    :param no_record: number of passes without a record, by reason.
    """

    passes: list[PassResult] = field(default_factory=list)
    found: list[Violation] = field(default_factory=list)
    exposures: dict[int, int] = field(default_factory=dict)
    no_record: Mapping[str, int] = field(default_factory=dict)

    def scored(self, fault: str, truth: Sequence[Sequence[Row]], limit_mps: Optional[float]
               ) -> Mapping[str, Any]:
        """
        Return the score of the stream as JSON values.

        :param fault: fault of the stream.
        :param truth: truth rows of each exposure.
        :param limit_mps: speed limit of the lanes.
        """
        rows = [row for exposure in truth for row in exposure]
        speeds: dict[int, list[float]] = {}
        for row in rows:  # out of view it is not measured, and may brake
            if row['in_view']:
                speeds.setdefault(row['vehicle'], []).append(row['speed'])
        config, limit = EnforcementConfig().decision, limit_mps or 0.0
        above = {vehicle for vehicle, values in speeds.items() if _above(
            float(np.mean(values)), limit, config)}
        wanted = TrafficRules(seen_px=SEEN_PX).counted(rows) & above
        scores = [_score(violation, self.exposures, truth) for violation in self.found]
        of = {score.vehicle for score in scores}
        wrong = [s for s in scores if s.wrong_speed or s.wrong_vehicle]
        return {
            'fault': fault, 'passes': len(self.passes),
            'measured': sum(p.verdict is Verdict.MEASURED for p in self.passes),
            'violations': len(wanted), 'recorded': len(wanted & of), 'records': len(scores),
            'wrong_speed': sum(s.wrong_speed for s in scores),
            'wrong_vehicle': sum(s.wrong_vehicle for s in scores),
            'not_violating': sum(s.true_mps <= limit for s in scores),
            'errors_kmh': [s.error_mps / KMH_MPS for s in scores],
            'no_record': dict(self.no_record), 'details': [s.line for s in wrong],
            'compared': sum(p.second is not None and p.second.speed_mps is not None
                            for p in self.passes),
            'rejected': dict(Counter(
                str(p.reason) for p in self.passes if p.verdict is Verdict.REJECTED))}


def decide_stream(stream: FaultyStream, pipeline: SpeedPipeline, recorder: EvidenceRecorder
                  ) -> DecidedStream:
    """Run a stream through a pipeline, and decide on each pass when it ends."""
    out = DecidedStream()

    def take(passes: Iterable[PassResult]) -> None:
        for result in passes:
            out.passes.append(result)
            found = recorder.decide(f'pass{result.track:05d}', result)
            if isinstance(found, Violation):
                out.found.append(found)
    for one in stream:
        for image in stream.images:
            recorder.ring.add(image.side, image.stamp_ns, _source(image))
        stream.images.clear()
        if one.anew:  # as the live nodes do when time jumps back
            take(pipeline.finish())
            pipeline.reset()
        out.exposures[one.pair.stamp_ns] = one.exposure
        take(pipeline.process(one.pair).passes)
    take(pipeline.finish())
    out.no_record = recorder.summary()['no_record']
    return out


@dataclass(frozen=True)
class _Score:
    """The score of a record."""

    vehicle: int
    true_mps: float
    error_mps: float
    wrong_speed: bool
    wrong_vehicle: bool
    line: str


def _score(violation: Violation, exposures: Mapping[int, int], truth: Sequence[Sequence[Row]]
           ) -> _Score:
    """Compare a record with the truth of the pairs from which it was measured."""
    result, on = violation.result, []
    for pair in violation.trace.shown(result.smoothed):
        assert pair.update is not None  # noqa: S101 (for the types)
        on.append(_nearest(pair.update.position_m, truth[exposures[pair.stamp_ns]]))
    vehicle = Counter(on).most_common(1)[0][0]
    true = {ns: float(row['speed']) for ns in sorted(result.smoothed)
            for row in truth[exposures[ns]] if row['vehicle'] == vehicle}
    assert result.speed_mps is not None  # noqa: S101
    true_mps = float(time_shares(list(true)) @ list(true.values())) if true else math.nan
    error = result.speed_mps - true_mps
    wrong_vehicle = vehicle < 0 or any(one != vehicle for one in on)
    wrong_speed = not abs(error) <= error_limit_mps(true_mps)
    return _Score(vehicle, true_mps, error, wrong_speed, wrong_vehicle, (
        f'track {result.track}, {result.first_ns} to {result.last_ns} ns: '
        f'{result.speed_mps / KMH_MPS:.2f} ± {(result.speed_std_mps or 0) / KMH_MPS:.2f} km/h, '
        f'true {true_mps / KMH_MPS:.2f}, vehicles {on}'))


def _nearest(position_m: Array, rows: Sequence[Row]) -> int:
    """Return the vehicle that a front is on; -1 where it is on none."""
    near = [(float(nearness(position_m, np.array([row['x'], row['y'], row['z']]))),
             row['vehicle']) for row in rows]
    best = max(near, default=(0.0, -1))
    return best[1] if best[0] > 0 else -1


def _above(speed_mps: float, limit_mps: float, config: DecisionConfig) -> bool:
    """Return whether a true speed exceeds the limit by tolerance and rounding."""
    return speed_mps - tolerance_mps(speed_mps, config) >= limit_mps + KMH_MPS


def _source(image: SentImage) -> SourceImage:
    height, width = image.pixels.shape
    return SourceImage('mono8', image.pixels.tobytes(), width, height, width)


def gather_violations(results: Sequence[Result]) -> list[ViolationRun]:
    """Return the result of each stream, without failed jobs."""
    return [ViolationRun(**result.value) for result in results if result.value is not None]


def violations_table(runs: Sequence[ViolationRun]) -> Table:
    """Return a row for each fault, then one for all."""
    names = [name for name in FAULTS if any(run.fault == name for run in runs)]
    rows = [_row(f'`{name}`', [run for run in runs if run.fault == name]) for name in names]
    return Table(title='', columns=COLUMNS, rows=[*rows, _row('all', runs)], digits=2)


def _row(name: str, runs: Sequence[ViolationRun]) -> list[Cell]:
    def total(of: str) -> int:
        return sum(getattr(run, of) for run in runs)
    errors = [abs(error) for run in runs for error in run.errors_kmh]
    wanted = total('violations')
    return [name, total('passes'), total('measured'), wanted, total('recorded'),
            f'{100 * total("recorded") / wanted:.0f} %' if wanted else None,
            total('records'), total('not_violating'), total('wrong_speed'), total('wrong_vehicle'),
            max(errors, default=math.nan), _told((run.no_record for run in runs), _BELOW),
            total('compared'), _told((run.rejected for run in runs), ())]


def _told(counts: Iterable[Mapping[str, int]], but: Sequence[str]) -> str:
    """Return a text of reasons with their numbers, without some of them."""
    total = sum((Counter(dict(one)) for one in counts), Counter[str]())
    return ', '.join(f'{reason} {count}' for reason, count in sorted(total.items())
                     if reason not in but) or '-'
