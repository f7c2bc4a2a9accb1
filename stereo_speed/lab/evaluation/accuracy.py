# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Measure many random passes, and summarise their errors and the consistency of the sigmas."""
from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, Mapping, Optional, Sequence

import numpy as np

from .labeled_sequence import LineKnowledge, run_tracker, simulated_sequence
from .metrics import pass_error, pass_figures, readings, sigma_share
from .outdoors import CLASS_OF
from .random_passes import draw_pass, RandomPass
from .scorer import SequenceRun, VehicleRun
from .tables import Cell, mph, shown, signed, Table, table_by_kind
from ...batch.job import Job, Result
from ...core.passes import VehicleClass
from ...core.tracker_config import TrackerConfig
from ...core.units import MPH_MPS

COLUMNS = ('', 'passes', 'measured', 'mean error, mph', 'sd, mph', 'max, mph',
           'r.m.s. of error/σ', 'beyond 4 σ', 'worst reading of the second half, mph')
# Greatest error that a moved rig may cause without a warning.
_WRONG_MPS = 0.1 * MPH_MPS


@dataclass(frozen=True, kw_only=True)
class PassRun:
    """
    A pass and its measurement.

    :param number: number of the pass.
    :param kinds: groups that it belongs to: heading to kind.
    :param run: readings and result; empty when the job failed.
    :param error: reason of the failure.
    :param cpu_ms: processor time per pair, ms.
    """

    number: int
    kinds: Mapping[str, str]
    run: VehicleRun = VehicleRun(vehicle=0)
    error: str = ''
    cpu_ms: float = np.nan


def accuracy_jobs(passes: int, *, seed: int, lines: LineKnowledge, pan_deg: float,
                  tolerances: bool, changes: Mapping[str, Any], sway_deg: float = 0.0,
                  outdoors: Optional[Mapping[str, str]] = None,
                  detect: bool = False, braking: bool = False,
                  ride: Optional[str] = None) -> list[Job]:
    """
    Return a job for each pass.

    :param passes: number of passes.
    :param seed: seed of the set.
    :param lines: source of the site's lines.
    :param pan_deg: rotation of the right camera since its calibration.
    :param tolerances: whether to draw errors of calibration and stamps within the tolerances.
    :param changes: parameters of the tracker that differ from the defaults.
    :param sway_deg: 1-sigma of each angle of the rig in each pair.
    :param outdoors: as for ``draw_pass``.
    :param detect: whether vehicles are detected instead of annotated.
    :param braking: whether each driver brakes or accelerates while in view.
    :param ride: as for ``draw_pass``.
    """
    return [Job(key=f'pass{number:04d}', parameters={
        'number': number, 'seed': seed, 'lines': lines.value, 'pan_deg': pan_deg,
        'sway_deg': sway_deg, 'tolerances': tolerances, 'tracker': 'constrained',
        'changes': dict(changes),
        'outdoors': None if outdoors is None else dict(outdoors), 'detect': detect,
        'braking': braking, 'ride': ride})
        for number in range(passes)]


def measure_job(parameters: Mapping[str, Any]) -> Mapping[str, Any]:
    """Simulate one pass and measure it; runs in a worker process."""
    number, seed = parameters['number'], parameters['seed']
    drawn = drawn_of(parameters)
    config = TrackerConfig(**parameters['changes'])
    sequence = simulated_sequence(drawn.config, (seed, number), LineKnowledge(parameters['lines']),
                                  tolerances=config if parameters['tolerances'] else None)
    if parameters['detect']:
        sequence = replace(sequence, annotations=None)
    return run_tracker(sequence, parameters['tracker'], config, number,
                       steadying=parameters['sway_deg'] > 0).to_json()


def drawn_of(parameters: Mapping[str, Any]) -> RandomPass:
    """Return the pass of a job."""
    return draw_pass(parameters['seed'], parameters['number'], pan_deg=parameters['pan_deg'],
                     sway_deg=parameters['sway_deg'], outdoors=parameters['outdoors'],
                     braking=parameters['braking'], ride=parameters['ride'])


def gather(jobs: Sequence[Job], results: Sequence[Result]) -> list[PassRun]:
    """Return each pass with its result."""
    out = []
    for job, result in zip(jobs, results):
        p = job.parameters
        found = PassRun(number=p['number'], kinds=drawn_of(p).kinds, error=result.error)
        if result.value is not None:
            done = SequenceRun.from_json(result.value)
            found = replace(found, run=done.vehicles[0], cpu_ms=done.cpu_ms)
        out.append(found)
    return out


def accuracy_table(passes: Sequence[PassRun]) -> Table:
    """Return a row for all passes, then one for each kind of them."""
    return table_by_kind(passes, COLUMNS, _row)


def _row(name: str, passes: Sequence[PassRun]) -> list[Cell]:
    f = pass_figures(p.run for p in passes)
    late = [e for p in passes for e in late_errors(p.run)]
    return [name, f.passes, f'{100 * f.measured / f.passes:.1f} %', signed(f.mean_mps),
            *(shown(mph(value), 3) for value in (f.std_mps, f.max_mps)), f.sigma_ratio, f.beyond_4,
            shown(mph(max(map(abs, late), default=np.nan)), 3)]


def late_errors(run: VehicleRun) -> list[float]:
    """Return the errors of the readings in the second half of the pass, m/s."""
    speed, truth = readings(run)
    errors: list[float] = (speed - truth).tolist()
    return errors[max(len(run.stamps_ns) // 2 - (len(run.stamps_ns) - len(errors)), 0):]


def rejections(passes: Sequence[PassRun]) -> dict[str, int]:
    """Return the number of unmeasured passes by reason; ``lost`` passes had no track."""
    reasons = Counter('failed' if p.error else p.run.reason if p.run.verdict else 'lost'
                      for p in passes if not p.run.measured)
    return dict(sorted(reasons.items()))


def classes_told(passes: Sequence[PassRun]) -> dict[str, int]:
    """Return how many vehicles with a pass have a right, an unknown and a wrong class."""
    found = Counter(
        'unknown' if p.run.told_class == VehicleClass.UNKNOWN else
        'right' if p.run.told_class == CLASS_OF[p.kinds['vehicle']] else 'wrong'
        for p in passes if p.run.told_class and 'vehicle' in p.kinds)
    return {word: found[word] for word in ('right', 'unknown', 'wrong')}


def silently_wrong(passes: Sequence[PassRun]) -> int:
    """Return how many measured passes have errors above 0.1 mph and 2 sigmas."""
    return sum(abs(pass_error(p.run)) > _WRONG_MPS and abs(sigma_share(p.run)) > 2
               for p in passes if p.run.measured)


def passes_table(passes: Sequence[PassRun]) -> Table:
    """Return a row for every pass, as data."""
    kinds = list(passes[0].kinds) if passes else []
    rows: list[list[Cell]] = []
    for p in passes:
        rows.append([p.number, *(p.kinds[k] for k in kinds), p.run.verdict or 'none',
                     p.error or p.run.reason, p.run.pairs, mph(p.run.pass_truth_mps),
                     mph(p.run.pass_mps), mph(p.run.pass_std_mps), mph(pass_error(p.run)),
                     sigma_share(p.run), p.cpu_ms, p.run.told_class])
    return Table(title='', rows=rows, columns=(
        'pass', *kinds, 'verdict', 'reason', 'pairs', 'truth_mph', 'speed_mph', 'std_mph',
        'error_mph', 'error_over_sigma', 'cpu_ms_per_pair', 'class'))
