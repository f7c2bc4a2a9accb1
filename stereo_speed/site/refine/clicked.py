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
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear

from ...core.records import Array
from ...road.fitted import RoadFit

_KERB_M = 0.15  # distance between the two edges of a kerb stone, of which either may be clicked
_STEP_M = 0.05  # step along and across a line for its directions in the image
_STEP_RAD = 1e-5  # step of the rig's rotation, about 0.02 px
_MOST_RAD = np.radians(0.15)  # largest rotation of the rig, about each axis, that is allowed for


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


class Clicks(NamedTuple):
    """
    The clicks of a line, and how wide what was found there is.

    :param width_m: width of its band, m; 0 for an edge.
    :param views_px: (n, 2) clicked raw pixels of each view.
    """

    width_m: float
    views_px: Sequence[Array]


def scatter_px(road: RoadFit, lines: Mapping[str, Clicks]) -> Array:
    """
    Return the distances (n,) of all clicks from their lines, px, without what they have in common.

    A person clicks on the middle of a marking or on an edge, so all clicks of a line may lie
    beside its middle by up to half its width, or by that of a kerb where it has none.  And the
    rig as a whole may have rotated since, or may just have swayed when the clicked image was
    taken, which displaces all lines and leaves the shape of the road as it is.

    :param road: road fitted to the markings that were found.
    :param lines: clicks of the road's lines by name.
    """
    off_px, columns, most = [np.zeros(0)], [np.zeros((0, 3))], []
    for name, clicks in lines.items():
        off, px_per_m = _of_both_views(road, name, clicks.views_px)
        off_px.append(off)
        columns.append(np.concatenate([_by_rotation(road, name, bool(right), uv)
                                       for right, uv in enumerate(clicks.views_px)]))
        most.append((_half_m(clicks.width_m), px_per_m))
    off = np.concatenate(off_px)
    beside = block_diag(*(px_per_m[:, None] for _, px_per_m in most))
    matrix = np.hstack([beside.reshape(len(off), len(most)), np.concatenate(columns)])
    seen = np.isfinite(off) & np.isfinite(matrix).all(axis=1)
    if not seen.any():
        return off
    limit = np.append([half_m for half_m, _ in most], [_MOST_RAD] * 3)
    common = lsq_linear(matrix[seen], off[seen], (-limit, limit)).x
    return np.asarray(off - matrix @ common)


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
    foot = _Foot.of(road, name, right, uv_px)
    return np.stack([foot.beside_px(uv_px - foot.on_px),
                     np.abs(foot.beside_px(foot.left_px - foot.on_px)) / _STEP_M])


def _by_rotation(road: RoadFit, name: str, right: bool, uv_px: Array) -> Array:
    """Return how far a line moves beside pixels (n, 2) with the rig's rotation, (n, 3) px/rad."""
    foot = _Foot.of(road, name, right, uv_px)
    return np.stack([
        foot.beside_px(road.seen(foot.place_m + np.cross(turn, foot.place_m), right) - foot.on_px)
        for turn in _STEP_RAD * np.eye(3)], axis=-1) / _STEP_RAD


class _Foot(NamedTuple):
    """
    The feet of pixels on a line.

    :param place_m: (n, 3) feet, left optical frame, m.
    :param on_px: (n, 2) their raw pixels.
    :param left_px: (n, 2) raw pixels of places beside them on the road.
    :param along: (n, 2) directions of the line there.
    """

    place_m: Array
    on_px: Array
    left_px: Array
    along: Array

    @classmethod
    def of(cls, road: RoadFit, name: str, right: bool, uv_px: Array) -> _Foot:
        """Return the feet of raw pixels (n, 2) of a view."""
        number, zeros = road.number(name), np.zeros(len(uv_px))
        feet = road.foot(number, right, uv_px)
        places = [road.points(number, feet + along_m, zeros + across_m)
                  for along_m, across_m in ((0.0, 0.0), (_STEP_M, 0.0), (0.0, _STEP_M))]
        on, ahead, left = (road.seen(place, right) for place in places)
        along_px = ahead - on
        return cls(places[0], on, left,
                   along_px / np.linalg.norm(along_px, axis=1, keepdims=True))

    def beside_px(self, change_px: Array) -> Array:
        """Return how far (n,) displacements (n, 2) lead beside the line, px."""
        return np.asarray(
            self.along[:, 0] * change_px[:, 1] - self.along[:, 1] * change_px[:, 0])


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
