# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A plot of the targets that trackers keep to the end, at each stride."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Sequence

from .plots import COLOURS, new_figure, png_of, show_legend

_MARKS = 'osD^vPX*'


@dataclass(frozen=True, kw_only=True)
class SurvivalCurve:
    """
    The targets that one tracker keeps.

    :param name: with its number of particles.
    :param strides: what is varied.
    :param shares: share of the targets kept to the end, at each.
    :param errors: their standard errors.
    """

    name: str
    strides: Sequence[int]
    shares: Sequence[float]
    errors: Sequence[float]


def draw_survival(path: Path, title: str, curves: Sequence[SurvivalCurve]) -> None:
    """Write the plot."""
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
