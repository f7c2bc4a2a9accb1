# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Figures of merit, as in the papers and as a measurement engineer needs them.

A *reading* is a live, confirmed speed: what is published while the vehicle drives. The last one is
what the 2012 paper tabulates ("final estimated speed"). The *pass* has the one final speed.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, Sequence

import numpy as np

from .scorer import VehicleRun
from ...core.records import Array
from ...core.units import MPH_MPS


@dataclass(frozen=True, kw_only=True)
class ReadingFigures:
    """
    Figures of the live readings of one vehicle over several runs, m/s.

    :param runs: number of runs.
    :param lost: runs without a confirmed reading in the last quarter of the vehicle's pairs.
    :param mean_mps: mean of all confirmed readings.
    :param max_error_mps: greatest error of a confirmed reading.
    :param std_mps: standard deviation of their errors about the mean error.
    :param rms_mps: root mean square of their errors.
    :param final_mean_mps: mean of the last reading of each run.
    :param final_max_error_mps: greatest error of a last reading.
    :param truth_mps: mean of the truth at the readings.
    """

    runs: int
    lost: int
    mean_mps: float
    max_error_mps: float
    std_mps: float
    rms_mps: float
    final_mean_mps: float
    final_max_error_mps: float
    truth_mps: float


@dataclass(frozen=True, kw_only=True)
class PassFigures:
    """
    Figures of the final speeds of passes, m/s.

    :param passes: number of passes.
    :param measured: number of measured ones, neither rejected nor lost.
    :param mean_mps: mean error of the measured ones.
    :param std_mps: standard deviation of their errors.
    :param max_mps: greatest error.
    :param sigma_ratio: root mean square of error over 1-sigma; 1 is consistent.
    :param beyond_4: number of errors beyond 4 sigmas.
    """

    passes: int
    measured: int
    mean_mps: float
    std_mps: float
    max_mps: float
    sigma_ratio: float
    beyond_4: int


def readings(run: VehicleRun) -> tuple[Array, Array]:
    """Return the confirmed speeds, (n,) in m/s, in time order, and the true speeds."""
    rows = [(speed, truth) for speed, truth, sure in zip(
        run.speeds_mps, run.truth_mps, run.confirmed) if sure and truth is not None]
    values = np.array(rows, dtype=float).reshape(-1, 2)
    return values[:, 0], values[:, 1]


def lost(run: VehicleRun) -> bool:
    """Return whether a vehicle had no confirmed reading in the last quarter of its pairs."""
    return not any(sure and ns >= run.last_quarter_ns
                   for ns, sure in zip(run.stamps_ns, run.confirmed))


def reading_figures(runs: Sequence[VehicleRun]) -> ReadingFigures:
    """
    Summarise the live readings of one vehicle over several runs.

    :return: the figures, NaN where there are no data.
    """
    speeds, truths = zip(*(readings(run) for run in runs)) if runs else ((), ())
    errors = [v - t for v, t in zip(speeds, truths)]
    every, final = _joined(errors), _joined([e[-1:] for e in errors])
    return ReadingFigures(
        runs=len(runs), lost=sum(lost(run) for run in runs),
        mean_mps=mean(_joined(speeds)), max_error_mps=greatest(every), std_mps=std(every),
        rms_mps=rms(every),
        final_mean_mps=mean(_joined([v[-1:] for v in speeds])),
        final_max_error_mps=greatest(final), truth_mps=mean(_joined(truths)))


def pass_error(run: VehicleRun) -> float:
    """Return the error of a pass's final speed, m/s; NaN when it was not measured."""
    if not run.measured or run.pass_mps is None or run.pass_truth_mps is None:
        return np.nan
    return run.pass_mps - run.pass_truth_mps


def sigma_share(run: VehicleRun) -> float:
    """Return the error of a pass in sigmas; NaN when it was not measured."""
    if run.pass_std_mps is None or not run.pass_std_mps > 0:
        return np.nan
    return pass_error(run) / run.pass_std_mps


def pass_figures(runs: Iterable[VehicleRun]) -> PassFigures:
    """
    Summarise final speeds.

    :return: the figures, NaN where there are no data.
    """
    runs = list(runs)
    errors = finite(np.array([pass_error(run) for run in runs], dtype=float))
    shares = finite(np.array([sigma_share(run) for run in runs], dtype=float))
    return PassFigures(
        passes=len(runs), measured=sum(run.measured for run in runs), mean_mps=mean(errors),
        std_mps=std(errors), max_mps=greatest(errors),
        sigma_ratio=rms(shares),
        beyond_4=int((np.abs(shares) > 4).sum()))


def mean_and_std(mean_mps: float, std_mps: float) -> str:
    """Return mean and standard deviation of errors in mph, for a table; a dash for NaN."""
    if not np.isfinite(mean_mps):
        return '-'
    return f'{mean_mps / MPH_MPS:+.3f} ± {std_mps / MPH_MPS:.3f}'


def finite(values: Array) -> Array:
    """Return the finite ones of values (n,)."""
    found: Array = values[np.isfinite(values)]
    return found


def mean(values: Array) -> float:
    """Return the mean; NaN without values."""
    return float(values.mean()) if len(values) else np.nan


def std(values: Array) -> float:
    """Return the standard deviation; NaN without values."""
    return float(values.std()) if len(values) else np.nan


def rms(values: Array) -> float:
    """Return the root mean square; NaN without values."""
    return float(np.sqrt(mean(np.square(values))))


def greatest(values: Array) -> float:
    """Return the greatest magnitude; NaN without values."""
    return float(np.abs(values).max()) if len(values) else np.nan


def _joined(parts: Sequence[Array]) -> Array:
    return np.concatenate([np.zeros(0), *parts])
