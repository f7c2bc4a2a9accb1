# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Plots of the laboratory: trackers and settings in comparison, and their run times."""
from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Mapping, Optional, Sequence

from matplotlib.figure import Figure
import numpy as np

from .plots import COLOURS, new_figure, png_of, show_legend
from ..core.records import Array
from ..core.units import MPH_MPS

Curve = Sequence[tuple[float, float]]  # size of the problem, and time in ms

_MARKS = 'osD^vPX*'


@dataclass(frozen=True, eq=False, kw_only=True)
class Readings:
    """
    Live readings of one vehicle by one tracker.

    :param times_s: (n,), times since the first pair.
    :param speeds_mps: (n,), speeds read.
    """

    times_s: Array
    speeds_mps: Array


@dataclass(frozen=True, kw_only=True)
class ErrorCurve:
    """
    Errors over a varied quantity.

    :param name: name of the curve.
    :param values: values of the varied quantity.
    :param errors_mph: the errors.
    :param dashed: whether the figures are published by others; drawn dashed.
    """

    name: str
    values: Sequence[float]
    errors_mph: Sequence[float]
    dashed: bool = field(default=False)


@dataclass(frozen=True, kw_only=True)
class SurvivalCurve:
    """
    Share of the targets that one tracker keeps.

    :param name: name of the tracker, with its number of particles.
    :param strides: the varied strides.
    :param shares: share of the targets kept to the end, at each stride.
    :param errors: standard errors of the shares.
    """

    name: str
    strides: Sequence[int]
    shares: Sequence[float]
    errors: Sequence[float]


def speeds_figure(title: str, trackers: Mapping[str, Sequence[Readings]],
                  truth: Optional[Sequence[Readings]] = None) -> Figure:
    """
    Draw the speed over time by each tracker, and the truth.

    :param trackers: name to the readings of each vehicle.
    :param truth: true speeds of each vehicle.
    """
    figure, axes = new_figure(10.0, 5.4)
    for i, (name, vehicles) in enumerate(trackers.items()):
        for k, one in enumerate(vehicles):
            axes.plot(one.times_s, one.speeds_mps / MPH_MPS, color=COLOURS[i % len(COLOURS)],
                      marker=_MARKS[i % len(_MARKS)], ms=5, lw=1.4, zorder=4 if not i else 3,
                      label=name if not k else None)
    for k, one in enumerate(truth or ()):
        axes.plot(one.times_s, one.speeds_mps / MPH_MPS, color='black', lw=1.3,
                  ls=(0, (1, 1.5)), zorder=5, label='truth' if not k else None)
    limits = _limits(truth or (), trackers)
    if limits is not None:
        axes.set_ylim(*limits)
    axes.set(title=title, xlabel='time since the first pair, s', ylabel='speed, mph')
    show_legend(figure, axes)
    return figure


def _limits(truth: Sequence[Readings],
            trackers: Mapping[str, Sequence[Readings]]) -> Optional[tuple[float, float]]:
    """Return axis limits that show the truth and most readings; outliers are cut off."""
    told = [one.speeds_mps for one in truth]
    read = [one.speeds_mps for vehicles in trackers.values() for one in vehicles]
    told, read = [v for v in told if len(v)], [v for v in read if len(v)]
    if not told or not read:
        return None
    every, true = np.concatenate(read) / MPH_MPS, np.concatenate(told) / MPH_MPS
    low, high = np.nanquantile(every, [0.04, 0.96])
    low, high = min(low, true.min()) - 1.0, max(high, true.max()) + 1.0
    return max(float(low), 0.0), float(high)


def errors_figure(title: str, what: str, curves: Sequence[ErrorCurve]) -> Figure:
    """
    Draw errors over the varied quantity, on a logarithmic axis.

    :param what: label of the varied quantity.
    """
    figure, axes = new_figure(9.0, 5.0)
    for i, curve in enumerate(curves):
        axes.plot(curve.values, curve.errors_mph, color=COLOURS[i // 2 % len(COLOURS)],
                  marker=_MARKS[i % len(_MARKS)], ms=6, lw=1.6,
                  ls='--' if curve.dashed else '-', label=curve.name)
    axes.set_yscale('log')
    axes.set(title=title, xlabel=what, ylabel='error, mph')
    show_legend(figure, axes, 2)
    return figure


def draw_survival(path: Path, title: str, curves: Sequence[SurvivalCurve]) -> None:
    """Write the plot of the shares over the strides."""
    figure, axes = new_figure(8.0, 4.6)
    for i, curve in enumerate(curves):
        axes.errorbar(curve.strides, [100 * s for s in curve.shares],
                      yerr=[100 * e if e == e else 0.0 for e in curve.errors],
                      color=COLOURS[i % len(COLOURS)], marker=_MARKS[i % len(_MARKS)], lw=1.6,
                      capsize=3, label=curve.name)
    strides = sorted({s for c in curves for s in c.strides})
    axes.set(title=title, xlabel='stride: every K-th frame', ylabel='kept to the end, %',
             xticks=strides, ylim=(-3, 103))
    show_legend(figure, axes)
    path.write_bytes(png_of(figure))


def growth_plot(path: Path, curves: Mapping[str, Curve], across: str) -> None:
    """
    Write a plot of times over the size of the problem.

    :param path: path of the image.
    :param curves: curves by name.
    :param across: label of the horizontal axis.
    """
    figure, axes = new_figure(6.5, 4.0)
    for colour, (name, points) in zip(COLOURS, curves.items()):
        x, y = zip(*points)
        axes.plot(x, y, 'o-', color=colour, label=name)
    axes.set_xscale('log', base=2)
    axes.set_yscale('log')
    axes.set_xlabel(across)
    axes.set_ylabel('CPU time, ms')
    axes.grid(True, which='both', alpha=0.3)
    show_legend(figure, axes)
    figure.savefig(path, metadata={'Software': None})
