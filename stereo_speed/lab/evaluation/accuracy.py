# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Measure many passes drawn at random and sum up how far off they are, and how honestly."""
from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any, Iterable, Mapping, Optional, Sequence

import numpy as np

from .drives import DriveRun, simulated_drive, track_drive, VehicleRun
from .metrics import pass_error, pass_figures, readings, sigma_share
from .runner import Job, Result
from .scenes import draw_scene
from .tables import mph, signed, Table
from ...core.config import TrackerConfig
from ...core.units import MPH_MPS

COLUMNS = ('', 'passes', 'measured', 'mean error, mph', 'sd, mph', 'max, mph',
           'r.m.s. of error/σ', 'beyond 4 σ', 'worst reading of the second half, mph')
_WRONG_MPS = 0.1 * MPH_MPS  # what a rig that has moved may cost, at most


@dataclass(frozen=True, kw_only=True)
class PassRun:
    """
    A pass and what was made of it.

    :param number: of the pass.
    :param kinds: what it counts for: heading to kind.
    :param run: readings and result; None when the job failed.
    :param error: why it failed.
    :param cpu_ms: processor time per pair, ms.
    """

    number: int
    kinds: Mapping[str, str]
    run: Optional[VehicleRun]
    error: str = ''
    cpu_ms: float = 0.0


def accuracy_jobs(passes: int, *, seed: int, site: str, pan_deg: float, tolerances: bool,
                  changes: Mapping[str, Any], tracker: str = 'constrained') -> list[Job]:
    """
    Plan the passes.

    :param passes: how many.
    :param seed: of the set.
    :param site: ``picked``, ``refined`` or ``exact``.
    :param pan_deg: by which the right camera has turned since its calibration.
    :param tolerances: whether calibration and stamps are off within the tracker's tolerances.
    :param changes: parameters of the tracker that differ from the defaults.
    """
    return [Job(key=f'pass{number:04d}', parameters={
        'number': number, 'seed': seed, 'site': site, 'pan_deg': pan_deg,
        'tolerances': tolerances, 'tracker': tracker, 'changes': dict(changes)})
        for number in range(passes)]


def measure_job(parameters: Mapping[str, Any]) -> Mapping[str, Any]:
    """Simulate one pass and measure it; runs in a worker process."""
    number, seed = parameters['number'], parameters['seed']
    scene = draw_scene(seed, number, pan_deg=parameters['pan_deg'])
    config = TrackerConfig(**parameters['changes'])
    drive = simulated_drive(scene.config, (seed, number), parameters['site'],
                            tolerances=config if parameters['tolerances'] else None)
    return track_drive(drive, parameters['tracker'], config, number).to_json()


def gather(jobs: Sequence[Job], results: Iterable[Result]) -> list[PassRun]:
    """Put passes and results together."""
    out = []
    for job, result in zip(jobs, results):
        p = job.parameters
        scene = draw_scene(p['seed'], p['number'], pan_deg=p['pan_deg'])
        drive = None if result.value is None else DriveRun.from_json(result.value)
        out.append(PassRun(
            number=p['number'], kinds=scene.kinds, error=result.error,
            run=None if drive is None else drive.vehicles[0],
            cpu_ms=np.nan if drive is None else drive.cpu_ms))
    return out


def accuracy_table(passes: Sequence[PassRun]) -> Table:
    """Sum up all passes, then each kind of them."""
    rows = [_row('all', passes)]
    for heading in passes[0].kinds if passes else ():
        for kind in sorted({p.kinds[heading] for p in passes}):
            rows.append(_row(f'{heading}: {kind}',
                             [p for p in passes if p.kinds[heading] == kind]))
    return Table(title='', columns=COLUMNS, rows=rows)


def _row(name: str, passes: Sequence[PassRun]) -> list[Any]:
    runs = [p.run or VehicleRun(vehicle=0) for p in passes]
    f = pass_figures(runs)
    late = [e for run in runs for e in late_errors(run)]
    return [name, f.passes, f'{100 * f.measured / f.passes:.1f} %', signed(f.mean_mps),
            _mph(f.std_mps), _mph(f.max_mps), f.sigma_ratio, f.beyond_4,
            _mph(max(map(abs, late), default=np.nan))]


def _mph(speed_mps: float) -> str:
    return f'{speed_mps / MPH_MPS:.3f}' if np.isfinite(speed_mps) else '-'


def late_errors(run: VehicleRun) -> list[float]:
    """Return the errors of the readings of the pass's second half, m/s."""
    speed, truth = readings(run)
    errors: list[float] = (speed - truth).tolist()
    return errors[max(len(run.stamps_ns) // 2 - (len(run.stamps_ns) - len(errors)), 0):]


def rejections(passes: Sequence[PassRun]) -> dict[str, int]:
    """Count why passes were not measured; ``lost`` had no track at its end."""
    reasons = Counter(
        p.error and 'failed' or (p.run.reason if p.run and p.run.verdict else 'lost')
        for p in passes if p.run is None or not p.run.measured)
    return dict(sorted(reasons.items()))


def silently_wrong(passes: Sequence[PassRun]) -> int:
    """Count measured passes that are more than 0.1 mph off and more than 2 of their 1-sigmas."""
    return sum(abs(pass_error(p.run)) > _WRONG_MPS and abs(sigma_share(p.run)) > 2
               for p in passes if p.run is not None and p.run.measured)


def passes_table(passes: Sequence[PassRun]) -> Table:
    """List every pass, for programs."""
    kinds = list(passes[0].kinds) if passes else []
    rows = []
    for p in passes:
        run = p.run or VehicleRun(vehicle=0)
        rows.append([p.number, *(p.kinds[k] for k in kinds), run.verdict or 'none',
                     p.error or run.reason, run.pairs, mph(run.pass_truth_mps),
                     mph(run.pass_mps), mph(run.pass_std_mps), mph(pass_error(run)),
                     sigma_share(run), p.cpu_ms])
    return Table(title='', rows=rows, columns=(
        'pass', *kinds, 'verdict', 'reason', 'pairs', 'truth_mph', 'speed_mph', 'std_mph',
        'error_mph', 'error_over_sigma', 'cpu_ms_per_pair'))
