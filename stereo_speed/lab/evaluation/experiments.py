# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Trackers over sequences and seeds: what to run, the job that runs it, and its runs.

A run is one tracker with one set of parameters over one sequence with one seed. The seed controls
all randomness: textures, noise, picks and annotations of a simulation, and the tracker. Runs on
one sequence and seed share its images.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
import json
from pathlib import Path
from typing import Any, Iterable, Mapping, Optional, Sequence, Union

from .labeled_sequence import (
    bag_sequence, LabeledSequence, LineKnowledge, run_tracker, simulated_sequence)
from .paper_sequences import find_sequence, rate_std
from .scorer import SequenceRun, VehicleRun
from ...batch.job import Job, Result
from ...core.tracker_config import TrackerConfig, VisibilityConfig
from ...pipeline.registry import TRACKERS

# As in the papers, trackers are compared by all readings, however uncertain.
EVERY_READING = VisibilityConfig(reading_std_mps=100.0)


@dataclass(frozen=True, kw_only=True)
class Source:
    """
    The source of the pairs: a simulated sequence, or a bag with its files.

    :param sequence: name of a simulated sequence; empty for a bag.
    :param lines: source of the lines of a simulated site.
    :param files: ``bag``, ``site``, ``truth`` and optionally ``init``, ``left`` and ``right``.
    """

    sequence: str = ''
    lines: LineKnowledge = LineKnowledge.REFINED
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Return the name for tables."""
        bag = Path(self.files.get('bag', ''))
        return self.sequence or (bag.parent.name if bag.name == 'bag' else bag.name)

    def to_json(self, seed: int) -> dict[str, Any]:
        """Return everything that the pairs depend on."""
        if self.sequence:
            return {'sequence': self.sequence, 'lines': self.lines.value, 'seed': seed}
        return {'files': dict(self.files), 'state': [_state(Path(self.files[k])) for k in sorted(
            set(self.files) & {'bag', 'site', 'truth', 'init'})]}


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """
    A tracker with its parameters on a source.

    :param source: the pairs.
    :param tracker: name of the tracker.
    :param changes: parameters that differ from the defaults.
    """

    source: Source
    tracker: str
    changes: Mapping[str, Any] = field(default_factory=dict)

    def key(self, seed: int) -> str:
        """Return the name of one of its runs."""
        changes = ','.join(f'{k}={self.changes[k]:g}' for k in sorted(self.changes))
        lines = f' {self.source.lines.value}' if self.source.sequence else ''
        name = self.source.name if self.source.sequence else self.source.files['bag']
        return f'{name}{lines} {self.tracker} {changes or "defaults"} seed {seed}'

    def job(self, seed: int) -> Job:
        """Return the job of one of its runs."""
        source = self.source.to_json(seed)
        return Job(key=self.key(seed), group=json.dumps(source, sort_keys=True), parameters={
            'source': source, 'tracker': self.tracker, 'changes': dict(self.changes),
            'seed': seed})


def _state(path: Path) -> list[list[Union[str, int]]]:
    """Return names, sizes and modification times of a file or of a folder's files."""
    files = sorted(path.rglob('*')) if path.is_dir() else [path]
    return [[f.name, f.stat().st_size, f.stat().st_mtime_ns] for f in files if f.is_file()]


def sequence_experiment(sequence: str, tracker: str, *,
                        lines: LineKnowledge = LineKnowledge.REFINED,
                        particles: Optional[int] = None, parts: Optional[int] = None,
                        step_mps: Optional[float] = None) -> Experiment:
    """
    Return a tracker on a simulated sequence, with the paper's parameters unless given.

    :param step_mps: 1-sigma of the change of speed from pair to pair, m/s.
    :raises InputError: an unknown sequence or tracker, parameters out of bounds.
    """
    paper = find_sequence(sequence)
    TRACKERS.check(tracker, 'evaluation')
    step = paper.speed_step_mps if step_mps is None else step_mps
    changes: dict[str, Any] = {'particles': particles or paper.particles,
                               'speed_rate_std': round(rate_std(step), 6)}
    if parts is not None and parts != TrackerConfig().parts:
        changes['parts'] = parts
    TrackerConfig(**changes)
    return Experiment(source=Source(sequence=sequence, lines=lines), tracker=tracker,
                      changes=changes)


def plan(runs: Iterable[tuple[Experiment, int]]) -> list[Job]:
    """
    Return the jobs of runs, each once, grouped by shared images.

    :param runs: experiments with a seed.
    """
    jobs = {experiment.key(seed): experiment.job(seed) for experiment, seed in runs}
    return sorted(jobs.values(), key=lambda job: job.group)


def track_job(parameters: Mapping[str, Any]) -> Mapping[str, Any]:
    """Run one tracker over one sequence; runs in a worker process."""
    sequence = _sequence(json.dumps(parameters['source'], sort_keys=True))
    config = TrackerConfig(**{'visibility': EVERY_READING, **parameters['changes']})
    return run_tracker(sequence, parameters['tracker'], config, parameters['seed']).to_json()


@lru_cache(maxsize=1)
def _sequence(source: str) -> LabeledSequence:
    """Simulate or read a sequence, once for consecutive jobs on it."""
    given = json.loads(source)
    if 'sequence' in given:
        return simulated_sequence(find_sequence(given['sequence']).config(), (given['seed'],),
                                  LineKnowledge(given['lines']))
    f = given['files']
    return bag_sequence(Path(f['bag']), Path(f['site']), Path(f['init']) if 'init' in f else None,
                        Path(f['truth']), left=f.get('left'), right=f.get('right'))


class Runs:
    """
    The runs of experiments, by experiment and vehicle.

    :param results: results of all jobs.
    """

    def __init__(self, results: Sequence[Result]) -> None:
        self._runs = {r.key: SequenceRun.from_json(r.value) for r in results
                      if r.value is not None}

    def of(self, experiment: Experiment, seeds: Sequence[int]) -> list[SequenceRun]:
        """Return the runs of an experiment, without failed ones."""
        keys = [experiment.key(seed) for seed in seeds]
        return [self._runs[key] for key in keys if key in self._runs]

    def vehicle(self, experiment: Experiment, seeds: Sequence[int],
                vehicle: int) -> list[VehicleRun]:
        """Return the reports of an experiment's runs on one vehicle."""
        return [run for done in self.of(experiment, seeds) for run in done.vehicles
                if run.vehicle == vehicle]

    def vehicles(self, experiment: Experiment, seeds: Sequence[int]) -> list[int]:
        """Return the numbers of the vehicles in an experiment's runs."""
        return sorted({run.vehicle for done in self.of(experiment, seeds)
                       for run in done.vehicles})

    def cpu_ms(self, experiment: Experiment, seeds: Sequence[int]) -> float:
        """Return the mean processor time per pair, ms; NaN without runs."""
        times = [done.cpu_ms for done in self.of(experiment, seeds)]
        return sum(times) / len(times) if times else float('nan')
