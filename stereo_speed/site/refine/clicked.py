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
    def of(cls, road: RoadFit, name: str, width_m: float, clicks_px: Sequence[Array],
           found_px: Sequence[Array]) -> ClickDistance:
        """
        Return the medians over the clicks of both views.

        :param road: road fitted to the markings that were found.
        :param name: name of the line.
        :param width_m: width of its band, m; 0 for an edge.
        :param clicks_px: (n, 2) clicked raw pixels of each view.
        :param found_px: (n, 2) raw pixels of each view where its marking was found.
        """
        off_px, px_per_m = np.concatenate([
            _from_marking(road, name, bool(right), uv, found)
            for right, (uv, found) in enumerate(zip(clicks_px, found_px))], axis=-1)
        off_px = np.abs(off_px)
        return cls(float(np.median(off_px)),
                   float(np.median(off_px - half_m(width_m) * px_per_m)))


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
    feet = {name: [Feet.of(road, name, bool(right), uv)
                   for right, uv in enumerate(clicks.views_px)] for name, clicks in lines.items()}
    off_px = np.concatenate([view.off_px for views in feet.values() for view in views])
    matrix = by_causes([np.concatenate([view.changes(road) for view in views])
                        for views in feet.values()])
    limit = np.append([half_m(clicks.width_m) for clicks in lines.values()], [_MOST_RAD] * 3)
    return _without_common(off_px, matrix, limit)


def unlike_rotation_px(road: RoadFit, lines: Mapping[str, Sequence[Array]]) -> Array:
    """
    Return the distances (n,) of points from their lines, px, that no rotation of the rig explains.

    :param road: road fitted to the lines as they are seen now.
    :param lines: (n, 2) raw pixels of each view where the lines were before, by name.
    """
    feet = [Feet.of(road, name, bool(right), uv)
            for name, views in lines.items() for right, uv in enumerate(views)]
    off_px = np.concatenate([view.off_px for view in feet])
    return _without_common(
        off_px, np.concatenate([view.by_rotation(road) for view in feet]), np.full(3, np.inf))


def by_causes(changes: Sequence[Array]) -> Array:
    """
    Return the changes (n, lines + 3) of all distances from lines with each of their causes.

    :param changes: (m, 4) for each line, as of :meth:`Feet.changes`.
    :return: a column for the displacement of each line, px/m, and three for the rotation of the
        rig, px/rad.
    """
    return np.hstack([block_diag(*(change[:, :1] for change in changes)),
                      np.concatenate([change[:, 1:] for change in changes])])


def _without_common(off_px: Array, matrix: Array, limit: Array) -> Array:
    """
    Return distances (n,) without what they have in common, in a least-squares sense.

    :param matrix: (n, k) change of each distance with each common cause.
    :param limit: (k,) largest size of each cause, to either side.
    """
    seen = np.isfinite(off_px) & np.isfinite(matrix).all(axis=1)
    if not seen.any():
        return off_px
    common = lsq_linear(matrix[seen], off_px[seen], (-limit, limit)).x
    return np.asarray(off_px - matrix @ common)


def half_m(width_m: float) -> float:
    """Return how far from the middle of a marking, or of a kerb, an edge of it lies, m."""
    return width_m / 2 if width_m else _KERB_M


def _from_marking(road: RoadFit, name: str, right: bool, uv_px: Array, found_px: Array) -> Array:
    """
    Return signed distances of pixels from the marking that was found for a line, and the scale.

    If what was found is no marking, it pulls the fitted road off the markings of other lines too.

    :param name: name of the line.
    :param right: whether the pixels are of the right view.
    :param uv_px: (n, 2) raw pixels.
    :param found_px: (m, 2) raw pixels of the marking; beyond its ends it is taken to go on.
    :return: (2, n) distances, px, and the image scale across the line, px/m.
    """
    feet, found = (Feet.of(road, name, right, uv) for uv in (uv_px, found_px))
    return np.stack([feet.beside_px(found), feet.px_per_m])


class Feet(NamedTuple):
    """
    The feet of pixels on a line.

    :param right: whether the pixels are of the right view.
    :param at_m: (n,) feet along the road, m.
    :param place_m: (n, 3) feet, left optical frame, m.
    :param on_px: (n, 2) their raw pixels.
    :param along: (n, 2) directions of the line there.
    :param off_px: (n,) signed distances of the pixels from the line, px.
    :param px_per_m: (n,) image scale across the line.
    """

    right: bool
    at_m: Array
    place_m: Array
    on_px: Array
    along: Array
    off_px: Array
    px_per_m: Array

    @classmethod
    def of(cls, road: RoadFit, name: str, right: bool, uv_px: Array) -> Feet:
        """Return the feet of raw pixels (n, 2); arguments as for :func:`_from_marking`."""
        number, zeros = road.number(name), np.zeros(len(uv_px))
        feet = road.foot(number, right, uv_px)
        places = [road.points(number, feet + along_m, zeros + across_m)
                  for along_m, across_m in ((0.0, 0.0), (_STEP_M, 0.0), (0.0, _STEP_M))]
        on, ahead, left = (road.seen(place, right) for place in places)
        along = (ahead - on) / np.linalg.norm(ahead - on, axis=1, keepdims=True)
        return cls(right, feet, places[0], on, along, _beside(along, uv_px - on),
                   np.abs(_beside(along, left - on)) / _STEP_M)

    def beside_px(self, found: Feet) -> Array:
        """
        Return signed distances (n,) from the curve through other pixels of the line, px.

        :param found: feet of these pixels; beyond its ends the curve is taken to go on.
        """
        order = np.argsort(found.at_m, kind='stable')
        beside_m = np.interp(self.at_m, found.at_m[order], (found.off_px / found.px_per_m)[order])
        return np.asarray(self.off_px - beside_m * self.px_per_m)

    def changes(self, road: RoadFit) -> Array:
        """
        Return how the distances change with their causes, (n, 4).

        :return: with the displacement of the line, px/m, and the rotation of the rig, px/rad.
        """
        return np.column_stack([self.px_per_m, self.by_rotation(road)])

    def by_rotation(self, road: RoadFit) -> Array:
        """Return how far the line moves sideways with the rotation of the rig, (n, 3) px/rad."""
        turned = (self.place_m + np.cross(turn, self.place_m) for turn in _STEP_RAD * np.eye(3))
        return np.stack([_beside(self.along, road.seen(place_m, self.right) - self.on_px)
                         for place_m in turned], axis=-1) / _STEP_RAD


def _beside(along: Array, change_px: Array) -> Array:
    """Return how far (n,) displacements (n, 2) lead beside directions (n, 2) of a line, px."""
    return np.asarray(along[:, 0] * change_px[:, 1] - along[:, 1] * change_px[:, 0])


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
