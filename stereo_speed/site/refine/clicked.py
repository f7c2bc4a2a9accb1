# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Detection of found markings that are not the ones that were clicked.

A person clicks on the middle or on an edge of a marking, with some scatter, and a camera that was
knocked since displaces all lines alike. A band that lies beside its clicks while the other lines
lie on theirs is something else, such as the light between a rail's shadow and the grass.
"""
from __future__ import annotations

from typing import Mapping, NamedTuple, Sequence

import numpy as np

from ...core.records import Array
from ...road.fitted import RoadFit

_KERB_M = 0.15  # distance between the two edges of a kerb stone, of which either may be clicked
_STEP_M = 0.05  # step along and across a line for its directions in the image


class ClickDistance(NamedTuple):
    """
    Distance of the clicks of a line from the marking that was found.

    :param off_px: distance from the middle of the marking, px.
    :param outside_px: distance from its nearer edge, px; negative inside the marking.
    """

    off_px: float
    outside_px: float

    @classmethod
    def of(cls, road: RoadFit, name: str, width_m: float, clicks_px: Sequence[Array]
           ) -> ClickDistance:
        """
        Return the medians over the clicks of both views.

        :param road: road fitted to the markings that were found.
        :param name: name of the line.
        :param width_m: width of its band, m; 0 for an edge.
        :param clicks_px: (n, 2) clicked raw pixels of each view.
        """
        off_px, px_per_m = _of_both_views(road, name, clicks_px)
        off_px, half_m = np.abs(off_px), _half_m(width_m)
        return cls(float(np.median(off_px)), float(np.median(off_px - half_m * px_per_m)))


def scatter_px(road: RoadFit, name: str, width_m: float, clicks_px: Sequence[Array]) -> Array:
    """
    Return the distances (n,) of a line's clicks from it, px, without what they have in common.

    A person clicks on the middle of a marking or on an edge, so all clicks may lie beside its
    middle by up to half its width, or by that of a kerb where it has none.  The arguments are
    those of :meth:`ClickDistance.of`.
    """
    off_px, px_per_m = _of_both_views(road, name, clicks_px)
    half_m = _half_m(width_m)
    beside_m = np.clip(off_px @ px_per_m / (px_per_m @ px_per_m), -half_m, half_m)
    return np.asarray(off_px - beside_m * px_per_m)


def _half_m(width_m: float) -> float:
    return width_m / 2 if width_m else _KERB_M


def _of_both_views(road: RoadFit, name: str, clicks_px: Sequence[Array]) -> Array:
    """Return :func:`signed_distances` of the clicks of both views together."""
    return np.concatenate([signed_distances(road, name, bool(right), uv)
                           for right, uv in enumerate(clicks_px)], axis=-1)


def signed_distances(road: RoadFit, name: str, right: bool, uv_px: Array) -> Array:
    """
    Return signed distances of pixels from a line, px, and the image scale across it, px/m: (2, n).

    :param name: name of the line.
    :param right: whether the pixels are of the right view.
    :param uv_px: (n, 2) raw pixels.
    """
    number, zeros = road.number(name), np.zeros(len(uv_px))
    feet = road.foot(number, right, uv_px)
    on, ahead, left = (road.seen(road.points(number, feet + along_m, zeros + across_m), right)
                       for along_m, across_m in ((0.0, 0.0), (_STEP_M, 0.0), (0.0, _STEP_M)))
    along_px, off, across = ahead - on, uv_px - on, left - on
    along_px /= np.linalg.norm(along_px, axis=1, keepdims=True)
    return np.stack([along_px[:, 0] * off[:, 1] - along_px[:, 1] * off[:, 0], np.abs(
        along_px[:, 0] * across[:, 1] - along_px[:, 1] * across[:, 0]) / _STEP_M])


def not_clicked(lines: Mapping[str, ClickDistance], scatter_px: float, most_sigmas: float
                ) -> set[str]:
    """
    Return the lines whose markings cannot be what was clicked, found one by one.

    :param lines: distances of the clicks of each line from its marking; lines with NaN are
        ignored.
    :param scatter_px: 1-sigma of clicks, px; also that of the error that a person makes alike
        along a whole line.
    :param most_sigmas: largest distance outside the marking, in sigmas of the scatter combined
        with the median distance of the other lines' clicks.
    """
    plausible = {name: line for name, line in lines.items() if np.isfinite(line).all()}
    wrong: set[str] = set()
    while plausible:
        sigmas = {name: line.outside_px / np.hypot(scatter_px, np.median(
            [other.off_px for key, other in plausible.items() if key != name] or [0.0]))
            for name, line in plausible.items()}
        worst = max(sigmas, key=sigmas.__getitem__)
        if not sigmas[worst] > most_sigmas:
            break
        wrong.add(worst)
        del plausible[worst]
    return wrong
