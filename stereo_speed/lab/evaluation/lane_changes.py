# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The lane changes of Zhu et al. (2012, Section V-C), simulated: 35 mph over 5 s, 30 mph over 3 s.

Each is measured by the tracker as it is and by one that holds to the straight path, with the
paper's drift across it and no model of a lane change, both on the same lanes.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Optional, Sequence

import numpy as np

from .drives import Drive, simulated_drive
from ..sim.config import SimConfig, straight_config, VehicleConfig
from ...core.config import TrackerConfig
from ...core.records import Array, TrackEnd, TrackState, Verdict
from ...core.units import MPH_MPS
from ...pipeline.assembly import make_pipeline
from ...pipeline.config import PipelineConfig
from ...pipeline.run import run

CASES = {'35 mph, lane change over 5 s': (35.0, 5.0), '30 mph, lane change over 3 s': (30.0, 3.0)}
TRACKERS = ('lane changes', 'straight only')
LANE_M = 3.7
PAIRS, FPS = 30, 5.0  # as in the paper
NEAR_M = 17.5


@dataclass(frozen=True)
class ChangeError:
    """
    What a tracker made of a lane change.

    :param kept: the vehicle was followed for as long as it was in view.
    :param pass_mps: error of the pass, m/s; None when it was rejected.
    :param live_mps: root mean square error of the readings of the second half, m/s.
    :param smoothed_mps: of the smoothed speeds, m/s.
    :param lane: the pass says the lane that the vehicle went to.
    """

    kept: bool
    pass_mps: Optional[float]
    live_mps: float
    smoothed_mps: float
    lane: bool


def change_config(case: str, seed: int) -> SimConfig:
    """
    Build a pass with a lane change to the outer lane or back, 30 pairs at 5 a second.

    :param case: one of ``CASES``.
    :param seed: of speed, start and direction.
    """
    mph, last_s = CASES[case]
    rng = np.random.default_rng([seed, round(mph)])
    speed = (mph + rng.normal(0.0, 0.5)) * MPH_MPS
    start_s = rng.uniform(0.3, max(0.35, (PAIRS - 1) / FPS - last_s - 0.4))
    lane = int(rng.integers(2))
    step = LANE_M if lane == 0 else -LANE_M
    vehicle = VehicleConfig(speed_mps=speed, lane=lane,
                            lateral_knots=((start_s, 0.0), (start_s + last_s, step)))
    return straight_config(
        vehicles=(vehicle,), start_m=NEAR_M + speed * (PAIRS - 1) / FPS, near_m=NEAR_M, fps=FPS,
        pairs=PAIRS, speed_limit=f'{mph:g} mph')


def tracker_config(tracker: str, particles: int) -> TrackerConfig:
    """Return the parameters of one of ``TRACKERS``."""
    config = TrackerConfig(particles=particles)
    return config if tracker == TRACKERS[0] else replace(config, manoeuvre_probability=0.0)


def measure_changes(case: str, seed: int, particles: int, lines: str = 'refined'
                    ) -> list[ChangeError]:
    """
    Simulate one lane change and measure it with each of ``TRACKERS``.

    :param case: one of ``CASES``.
    :param seed: of the simulation and of the trackers.
    :param lines: how well the lines of the lanes are known: ``picked``, ``refined`` by the
        images of the pass, or ``exact``.
    """
    config = change_config(case, seed)
    drive = simulated_drive(config, (seed,), lines)
    to = f'lane_{1 - config.vehicles[0].lane}'
    return [_measure(drive, to, tracker_config(t, particles), seed) for t in TRACKERS]


def _measure(drive: Drive, to: str, config: TrackerConfig, seed: int) -> ChangeError:
    pipeline = make_pipeline(drive.rig, drive.lanes, PipelineConfig(config), drive.marks, seed=seed)
    done = run(pipeline, drive.pairs)
    result, = done.passes
    truth, = drive.truths
    true = dict(zip(truth.stamps_ns.tolist(), truth.speed_mps.tolist()))
    seen = [u for u in done.updates if u.stamp_ns in true and u.state is not TrackState.COASTING]
    live = np.array([u.speed_mps - true[u.stamp_ns] for u in seen])
    smooth = np.array([v - true[s] for s, v in result.smoothed.items() if s in true])
    off = None
    if result.verdict is Verdict.MEASURED and result.speed_mps is not None:
        off = result.speed_mps - float(np.mean([true[u.stamp_ns] for u in seen]))
    return ChangeError(
        kept=len(seen) >= len(true) - 1 and result.end is not TrackEnd.LOST, pass_mps=off,
        live_mps=_rms(live[len(live) // 2:]), smoothed_mps=_rms(smooth),
        lane=result.lane_to == to)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float('nan')


HEADER = ('| lane change | tracker | followed to the end | measured | pass: mean ± sd, mph '
          '| worst, mph | mean r.m.s. of readings of second half, mph | of smoothed, mph '
          '| lane it went to right |\n' + '|---' * 9 + '|')


def row(case: str, tracker: str, errors: Sequence[ChangeError]) -> str:
    """
    Give a line of the Markdown table below ``HEADER``.

    :param case: name of the lane change.
    :param tracker: name of the tracker.
    :param errors: of every seed.
    """
    off = np.array([e.pass_mps for e in errors if e.pass_mps is not None]) / MPH_MPS
    shown = ([f'{off.mean():+.3f} ± {off.std():.3f}', f'{np.abs(off).max():.3f}']
             if len(off) else ['-'] * 2)
    shown += [f'{np.nanmean([getattr(e, name) for e in errors]) / MPH_MPS:.2f}'
              for name in ('live_mps', 'smoothed_mps')]
    count = len(errors)
    return '| ' + ' | '.join([
        case, tracker, f'{sum(e.kept for e in errors)} of {count}', f'{len(off)} of {count}',
        *shown, f'{sum(e.lane for e in errors)} of {count}']) + ' |'
