# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Plot of how the cost of measuring grows."""
from __future__ import annotations

from pathlib import Path
from typing import Mapping, Sequence

from .plots import COLOURS, new_figure, show_legend

Curve = Sequence[tuple[float, float]]  # what grows, and ms


def growth_plot(path: Path, curves: Mapping[str, Curve], across: str) -> None:
    """
    Write a plot of times.

    :param path: of the image.
    :param curves: by their names.
    :param across: what grows, for the axis.
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
