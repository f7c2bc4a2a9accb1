# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Trackers over sequences and seeds: what to run, the worker that runs it, and its runs.

A run is one tracker with one set of parameters over one sequence with one seed. The seed stands
for all that is random: textures, noise, picks and marks of a simulation, and the tracker. Runs on
one sequence and seed share its images.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
import json
from pathlib import Path
from typing import Any, Mapping, Optional, Sequence

from .drives import bag_drive, Drive, DriveRun, simulated_drive, track_drive, VehicleRun
from .runner import Job, Result
from .sequences import find_sequence, rate_std
from ...core.config import TrackerConfig
from ...pipeline.registry import TRACKERS

# How well the lines of a simulated site are known unless one says otherwise.
LINES = 'refined'


@dataclass(frozen=True, kw_only=True)
class Source:
    """
    Where the pairs come from: a simulated sequence, or a bag with its files.

    :param sequence: name of a simulated sequence; empty for a bag.
    :param lines: how the lines of a simulated site are known.
    :param files: ``bag``, ``site``, ``truth`` and perhaps ``init``, ``left`` and ``right``.
    """

    sequence: str = ''
    lines: str = LINES
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name it, for tables."""
        bag = Path(self.files.get('bag', ''))
        return self.sequence or (bag.parent.name if bag.name == 'bag' else bag.name)

    def to_json(self, seed: int) -> dict[str, Any]:
        """Tell all that the pairs depend on."""
        if self.sequence:
            return {'sequence': self.sequence, 'lines': self.lines, 'seed': seed}
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
        """Name one of its runs."""
        changes = ','.join(f'{k}={self.changes[k]:g}' for k in sorted(self.changes))
        lines = f' {self.source.lines}' if self.source.sequence else ''
        name = self.source.name if self.source.sequence else self.source.files['bag']
        return f'{name}{lines} {self.tracker} {changes or "defaults"} seed {seed}'

    def job(self, seed: int) -> Job:
        """Make the job of one of its runs."""
        source = self.source.to_json(seed)
        return Job(key=self.key(seed), group=json.dumps(source, sort_keys=True), parameters={
            'source': source, 'tracker': self.tracker, 'changes': dict(self.changes),
            'seed': seed})


def _state(path: Path) -> list[Any]:
    """Tell whether a file, or a folder's files, changed."""
    files = sorted(path.rglob('*')) if path.is_dir() else [path]
    return [[f.name, f.stat().st_size, f.stat().st_mtime_ns] for f in files if f.is_file()]


def sequence_experiment(sequence: str, tracker: str, *, lines: str = LINES,
                        particles: Optional[int] = None, parts: Optional[int] = None,
                        step_mps: Optional[float] = None) -> Experiment:
    """
    Plan a tracker on a simulated sequence, with the paper's parameters unless told otherwise.

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


def plan(experiments: Sequence[Experiment], seeds: Sequence[int]) -> list[Job]:
    """List the jobs of experiments, each once, those that share images together."""
    jobs: dict[str, Job] = {}
    for seed in seeds:
        for experiment in experiments:
            jobs.setdefault(experiment.key(seed), experiment.job(seed))
    return sorted(jobs.values(), key=lambda job: job.group)


def track_job(parameters: Mapping[str, Any]) -> Mapping[str, Any]:
    """Run one tracker over one sequence; runs in a worker process."""
    drive = _drive(json.dumps(parameters['source'], sort_keys=True))
    config = TrackerConfig(**parameters['changes'])
    return track_drive(drive, parameters['tracker'], config, parameters['seed']).to_json()


@lru_cache(maxsize=1)
def _drive(source: str) -> Drive:
    """Simulate or read a drive, once for the jobs that follow one another on it."""
    told = json.loads(source)
    if 'sequence' in told:
        name = told['sequence']
        return simulated_drive(find_sequence(name).config(), (told['seed'],), told['lines'])
    f = told['files']
    return bag_drive(Path(f['bag']), Path(f['site']), Path(f['init']) if 'init' in f else None,
                     Path(f['truth']), left=f.get('left'), right=f.get('right'))


class Runs:
    """
    The runs of experiments, by experiment and vehicle.

    :param results: of all jobs.
    """

    def __init__(self, results: Sequence[Result]) -> None:
        self._drives = {r.key: DriveRun.from_json(r.value) for r in results
                        if r.value is not None}

    def of(self, experiment: Experiment, seeds: Sequence[int]) -> list[DriveRun]:
        """Give its runs; those that failed are not among them."""
        keys = [experiment.key(seed) for seed in seeds]
        return [self._drives[key] for key in keys if key in self._drives]

    def vehicle(self, experiment: Experiment, seeds: Sequence[int],
                vehicle: int) -> list[VehicleRun]:
        """Give what its runs made of one vehicle."""
        return [run for drive in self.of(experiment, seeds) for run in drive.vehicles
                if run.vehicle == vehicle]

    def vehicles(self, experiment: Experiment, seeds: Sequence[int]) -> list[int]:
        """Give the numbers of the vehicles its runs tell of."""
        return sorted({run.vehicle for drive in self.of(experiment, seeds)
                       for run in drive.vehicles})

    def cpu_ms(self, experiment: Experiment, seeds: Sequence[int]) -> float:
        """Give the mean processor time per pair, ms; NaN without runs."""
        times = [drive.cpu_ms for drive in self.of(experiment, seeds)]
        return sum(times) / len(times) if times else float('nan')
