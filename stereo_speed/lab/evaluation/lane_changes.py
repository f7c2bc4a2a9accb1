# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The lane changes of Zhu et al. (2012, Section V-C), simulated: 35 mph over 5 s, 30 mph over 3 s.

Each is measured with the tracker's lane-change model, and with one that is restricted to the
straight path with the paper's drift across it, both on the same lanes.
"""
from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Mapping, Sequence

import numpy as np

from .labeled_sequence import LabeledSequence, LineKnowledge, simulated_sequence
from .metrics import finite, greatest, mean, mean_and_std, pass_error, rms, std
from .scorer import vehicle_run
from .tables import Cell, mph, Table
from ..sim.config import SimConfig, straight_config, VehicleConfig
from ...batch.job import Job, Result
from ...core.passes import TrackEnd
from ...core.records import TrackState
from ...core.tracker_config import TrackerConfig
from ...core.units import MPH_MPS
from ...pipeline.config import PipelineConfig
from ...pipeline.run import run

CASES = {'35 mph, lane change over 5 s': (35.0, 5.0), '30 mph, lane change over 3 s': (30.0, 3.0)}
MANOEUVRE_MODELS = ('lane changes', 'straight only')
LANE_M = 3.7
PAIRS, FPS = 30, 5.0  # as in the paper
NEAR_M = 17.5


@dataclass(frozen=True)
class ChangeError:
    """
    Errors of the measurement of a lane change; NaN where there is none.

    :param followed: whether the vehicle was tracked as long as it was in view.
    :param pass_mps: error of the pass, m/s; NaN when it was rejected.
    :param live_mps: root mean square error of the readings of the second half, m/s.
    :param smoothed_mps: root mean square error of the smoothed speeds, m/s.
    :param lane: whether the pass ends in the lane that the vehicle changed to.
    """

    followed: bool
    pass_mps: float
    live_mps: float
    smoothed_mps: float
    lane: bool


def change_config(case: str, seed: int) -> SimConfig:
    """
    Build a pass with a lane change to the outer lane or back, 30 pairs at 5 pairs/s.

    :param case: one of ``CASES``.
    :param seed: seed of speed, start and direction.
    """
    speed_mph, last_s = CASES[case]
    rng = np.random.default_rng([seed, round(speed_mph)])
    speed = (speed_mph + rng.normal(0.0, 0.5)) * MPH_MPS
    start_s = rng.uniform(0.3, max(0.35, (PAIRS - 1) / FPS - last_s - 0.4))
    lane = int(rng.integers(2))
    step = LANE_M if lane == 0 else -LANE_M
    vehicle = VehicleConfig(speed_mps=speed, lane=lane,
                            lateral_knots=((start_s, 0.0), (start_s + last_s, step)))
    return straight_config(
        vehicles=(vehicle,), start_m=NEAR_M + speed * (PAIRS - 1) / FPS, near_m=NEAR_M, fps=FPS,
        pairs=PAIRS, speed_limit=f'{speed_mph:g} mph')


def tracker_config(model: str, particles: int) -> TrackerConfig:
    """Return the tracker's parameters for one of ``MANOEUVRE_MODELS``."""
    config = TrackerConfig(particles=particles)
    return config if model == MANOEUVRE_MODELS[0] else replace(config, manoeuvre_probability=0.0)


def change_jobs(seeds: Sequence[int], particles: int, lines: LineKnowledge) -> list[Job]:
    """Return a job for every case and seed, case by case."""
    return [Job(key=f'{case}, seed {seed}', parameters={
        'case': case, 'seed': seed, 'particles': particles, 'lines': lines.value})
        for case in CASES for seed in seeds]


def change_job(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Simulate one lane change and measure it with each model; runs in a worker process."""
    errors = measure_changes(parameters['case'], parameters['seed'], parameters['particles'],
                             LineKnowledge(parameters['lines']))
    return {model: asdict(error) for model, error in errors.items()}


def measure_changes(case: str, seed: int, particles: int, lines: LineKnowledge
                    ) -> dict[str, ChangeError]:
    """
    Simulate one lane change and measure it with each of ``MANOEUVRE_MODELS``.

    :param case: one of ``CASES``.
    :param seed: seed of the simulation and of the trackers.
    :param lines: source of the lines of the lanes.
    """
    config = change_config(case, seed)
    sequence = simulated_sequence(config, (seed,), lines)
    lane_to = f'lane_{1 - config.vehicles[0].lane}'
    return {model: _measure(sequence, lane_to, tracker_config(model, particles), seed)
            for model in MANOEUVRE_MODELS}


def _measure(sequence: LabeledSequence, lane_to: str, config: TrackerConfig,
             seed: int) -> ChangeError:
    pipeline = sequence.site.pipeline(PipelineConfig(config), sequence.annotations, seed=seed)
    done = run(pipeline, sequence.pairs)
    result, = done.passes
    truth, = sequence.truths
    seen = [u for u in done.updates if u.state is not TrackState.COASTING]
    live = finite(np.array([u.speed_mps for u in seen])
                  - truth.speed_at([u.stamp_ns for u in seen]))
    smoothed = finite(np.array(list(result.smoothed.values()))
                      - truth.speed_at(list(result.smoothed)))
    return ChangeError(
        followed=len(live) >= len(truth.stamps_ns) - 1 and result.end is not TrackEnd.LOST,
        pass_mps=pass_error(vehicle_run(truth, done.updates, result)),
        live_mps=rms(live[len(live) // 2:]), smoothed_mps=rms(smoothed),
        lane=result.lane_to == lane_to)


def changes_table(jobs: Sequence[Job], results: Sequence[Result]) -> Table:
    """Return a row for each case and model; jobs that failed do not count."""
    done = [(job.parameters['case'], result.value) for job, result in zip(jobs, results)
            if result.value is not None]
    return Table(title='', columns=(
        'lane change', 'tracker', 'followed to the end', 'measured', 'pass: mean ± sd, mph',
        'worst, mph', 'mean r.m.s. of readings of second half, mph', 'of smoothed, mph',
        'target lane correct'), digits=(0, 0, 0, 0, 0, 3, 2, 2, 0), rows=[
            _row(case, model, [ChangeError(**value[model]) for of, value in done if of == case])
            for case in CASES for model in MANOEUVRE_MODELS])


def _row(case: str, model: str, errors: Sequence[ChangeError]) -> list[Cell]:
    passes, live, smoothed = (
        finite(np.array([getattr(e, name) for e in errors], dtype=float))
        for name in ('pass_mps', 'live_mps', 'smoothed_mps'))
    count = len(errors)
    return [case, model, f'{sum(e.followed for e in errors)} of {count}',
            f'{len(passes)} of {count}', mean_and_std(mean(passes), std(passes)),
            mph(greatest(passes)), mph(mean(live)), mph(mean(smoothed)),
            f'{sum(e.lane for e in errors)} of {count}']
