# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Which of the markings that were found cannot be those that were clicked.

A person clicks on a marking, be it on its middle or on one of its edges, with some scatter; and a
camera that was knocked since displaces all lines alike. A band that lies beside the clicks where
other lines lie on theirs is something else: the light between a rail's shadow and the grass.
"""
from __future__ import annotations

from typing import Mapping, NamedTuple, Sequence

import numpy as np

from ...core.records import Array
from ...road.fit import RoadFit

_KERB_M = 0.15  # a kerb's stone has two edges: either may be found, and either clicked
_STEP_M = 0.05  # along and across a line, for the way it goes in the image


class Beside(NamedTuple):
    """
    How far the clicks of a line lie from what was found of it.

    :param off_px: from its middle.
    :param outside_px: from the nearer edge of it; negative within.
    """

    off_px: float
    outside_px: float

    @classmethod
    def of(cls, road: RoadFit, name: str, width_m: float, clicks_px: Sequence[Array]) -> Beside:
        """
        Return the medians over the clicks of both views.

        :param road: that was fitted to what was found.
        :param name: of the line.
        :param width_m: of its band; 0 of an edge.
        :param clicks_px: (n, 2) raw pixels of each view.
        """
        half_m = width_m / 2 if width_m else _KERB_M
        off_px, px_per_m = np.concatenate([
            beside(road, name, bool(right), uv) for right, uv in enumerate(clicks_px)], axis=-1)
        off_px = np.abs(off_px)
        return cls(float(np.median(off_px)), float(np.median(off_px - half_m * px_per_m)))


def beside(road: RoadFit, name: str, right: bool, uv_px: Array) -> Array:
    """
    Return how far pixels lie beside a line of a road (2, n): px, and px for a metre across it.

    :param name: of the line.
    :param right: the right view.
    :param uv_px: (n, 2) raw pixels.
    """
    number, none = road.number(name), np.zeros(len(uv_px))
    feet = road.foot(number, right, uv_px)
    on, ahead, left = (road.seen(road.points(number, feet + along_m, none + across_m), right)
                       for along_m, across_m in ((0.0, 0.0), (_STEP_M, 0.0), (0.0, _STEP_M)))
    way, off, across = ahead - on, uv_px - on, left - on
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return np.stack([way[:, 0] * off[:, 1] - way[:, 1] * off[:, 0], np.abs(
        way[:, 0] * across[:, 1] - way[:, 1] * across[:, 0]) / _STEP_M])


def not_clicked(lines: Mapping[str, Beside], scatter_px: float, most_sigmas: float) -> set[str]:
    """
    Return the lines whose markings cannot be what was clicked, found one after the other.

    :param lines: how far the clicks of each lie from what was found of it; one of which that is
        not known is left alone.
    :param scatter_px: of clicks, and as great as what a person does alike along a whole line.
    :param most_sigmas: of that, and of what clicks do beside the other lines.
    """
    meant = {name: line for name, line in lines.items() if np.isfinite(line).all()}
    wrong: set[str] = set()
    while meant:
        sigmas = {name: line.outside_px / np.hypot(scatter_px, np.median(
            [other.off_px for one, other in meant.items() if one != name] or [0.0]))
            for name, line in meant.items()}
        worst = max(sigmas, key=sigmas.__getitem__)
        if not sigmas[worst] > most_sigmas:
            break
        wrong.add(worst)
        del meant[worst]
    return wrong
