# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The far stretches of lines, where a marking is narrower than a pixel.

There it cannot be told from the border of the asphalt, or from a lamp's reflection beside it, a
pixel or two away: both views show either as a band that keeps its distance from the clicks.  A
person who has followed the marking from its near end knows which one it is.
"""
from __future__ import annotations

from dataclasses import replace
from typing import Mapping, NamedTuple, Sequence

import numpy as np
from numpy.typing import NDArray

from .clicked import by_causes, Feet, half_m
from .markings import Found, LocatedLine
from .strays import LEAST_POINTS
from ..file import PickedLine
from ...core.records import Array
from ...estimation.robust import robust_std
from ...road.fitted import RoadFit
from ...road.occlusion import hidden

_RESOLVED_PX = 1.0  # width of a marking from which it is seen as one
_LEAST_CLICKS = 2  # fewest clicks of a far stretch in a view that can contradict
_OTHER_SHARE = 0.5  # share of the limit by which the view that is less off must be off
_EDGE_SHARE = 1 / np.sqrt(3)  # 1-sigma of a click between the edges, as a share of half the width
_TURN_RAD = np.radians(0.1)  # 1-sigma of the rotation of the rig since the clicks, about each axis


def clicks_where_unresolved(road: RoadFit, clicked: Mapping[str, PickedLine], found: Found,
                            most_sigmas: float) -> Found:
    """
    Return the lines with their clicks on far stretches, where one of them contradicts these.

    If the far stretch of one line shows something else, those of the others can't be trusted.
    Clicks on the edge of a marking, and a rotation of the rig since, displace the nearer points
    alike.  What these have in common is no contradiction, and the clicks are displaced by it.
    Uncertain points contradict as certain ones do: clicks are no worse in their place.

    :param road: road near the lines, from which distances are counted.
    :param clicked: the lines as clicked, by name; points with 1-sigmas are no clicks.
    :param found: the lines as found; edges stay.  A line whose nearer points contradict its
        clicks too, beyond what a rotation of the rig explains, is no evidence, as it is another
        line as a whole.
    :param most_sigmas: largest median distance of a stretch from its clicks, in 1-sigmas of
        single clicks and of what displaces them, as a person may err alike over a stretch.
    :return: without lines of which too little is left.
    """
    bands = {name: [_View.of(road, clicked[name], bool(right), line)
                    for right, line in enumerate(found[name])]
             for name in road.names if name in found and found[name][0].shape.width_m
             and clicked[name].views_std_px is None}
    if not any(view.unresolved.any() for views in bands.values() for view in views):
        return found
    common = _Common.of(bands, road.problem.prior.pick_std_px)
    if not any(_is_off(views, common, line, most_sigmas)
               for line, views in enumerate(bands.values())):
        return found
    out = dict(found)
    for line, (name, views) in enumerate(bands.items()):
        both = [view.with_clicks(common, line) for view in views]
        if min(np.count_nonzero(~view.is_clicked) for view in both) >= LEAST_POINTS:
            out[name] = both[0], both[1]
        else:
            del out[name]
    return out


class _View(NamedTuple):
    """
    One line in one view, at its clicks.

    :param line: the line as found.
    :param found_m: (k,) its points along the road, m.
    :param kept: (k,) whether the marking is wide enough there to be resolved.
    :param clicks_px: (n, 2) raw pixels of the clicks.
    :param feet: the clicks on the road.
    :param off_px: (n,) distances of what was found from the clicks, px; NaN beyond its ends, and
        where the road hides the click.
    :param unresolved: (n,) whether the marking is too narrow at a click that is not hidden.
    :param changes: (n, 4) changes of these distances, as of :meth:`Feet.changes`.
    """

    line: LocatedLine
    found_m: Array
    kept: NDArray[np.bool_]
    clicks_px: Array
    feet: Feet
    off_px: Array
    unresolved: NDArray[np.bool_]
    changes: Array

    @classmethod
    def of(cls, road: RoadFit, clicked: PickedLine, right: bool, line: LocatedLine) -> _View:
        """Return a line in a view; for arguments see :func:`clicks_where_unresolved`."""
        width_m, clicks_px = line.shape.width_m, clicked.views_px[right]
        feet, found = (Feet.of(road, clicked.name, right, uv) for uv in (clicks_px, line.uv_px))
        shown = ~hidden(road, road.number(clicked.name), right, feet.at_m)
        reached = (feet.at_m >= found.at_m.min()) & (feet.at_m <= found.at_m.max())
        return cls(line, found.at_m, found.px_per_m * width_m >= _RESOLVED_PX, clicks_px, feet,
                   np.where(shown & reached, -feet.beside_px(found), np.nan),
                   shown & (feet.px_per_m * width_m < _RESOLVED_PX), feet.changes(road))

    @property
    def near(self) -> NDArray[np.bool_]:
        """Return at which clicks (n,) a marking that is wide enough was found."""
        return np.isfinite(self.off_px) & ~self.unresolved

    def with_clicks(self, common: _Common, line: int) -> LocatedLine:
        """Return the line with its clicks where the marking is too narrow."""
        moved_px, std_px = common.of_line(line, self.changes[self.unresolved])
        # They share this error, but count as independent.
        std_px = np.hypot(std_px * np.sqrt(len(std_px)), common.click_px)
        along = self.feet.along[self.unresolved]
        sideways = np.stack([-along[:, 1], along[:, 0]], axis=-1)
        s_m = np.append(self.found_m[self.kept], self.feet.at_m[self.unresolved])
        return replace(
            self.line, s_m=s_m,
            uv_px=np.concatenate([self.line.uv_px[self.kept],
                                  self.clicks_px[self.unresolved] + moved_px[:, None] * sideways]),
            std_px=np.append(self.line.std_px[self.kept], std_px),
            clicked=np.append(self.line.is_clicked[self.kept], np.ones(len(along), bool)),
        ).take(np.argsort(s_m, kind='stable'))


class _Common(NamedTuple):
    """
    What displaces the resolved points alike from the clicks.

    :param causes: (lines + 3,) displacements of the lines, m, and rotation of the rig, rad.
    :param covariance: (lines + 3, lines + 3) their covariance.
    :param click_px: 1-sigma of a click, px.
    """

    causes: Array
    covariance: Array
    click_px: float

    @classmethod
    def of(cls, bands: Mapping[str, Sequence[_View]], click_px: float) -> _Common:
        """
        Return what the resolved points of lines in both views have in common.

        :param click_px: least 1-sigma of a click, px; more if they scatter by more.
        """
        matrix = by_causes([np.concatenate([view.changes[view.near] for view in views])
                            for views in bands.values()])
        off = np.concatenate([view.off_px[view.near] for views in bands.values()
                              for view in views])
        prior = np.append([_EDGE_SHARE * half_m(views[0].line.shape.width_m)
                           for views in bands.values()], [_TURN_RAD] * 3)
        causes, covariance = _posterior(matrix, off, prior, click_px)
        rest = off - matrix @ causes
        if len(rest) and robust_std(rest) > click_px:
            click_px = robust_std(rest)
            causes, covariance = _posterior(matrix, off, prior, click_px)
        return cls(causes, covariance, click_px)

    def of_line(self, line: int, changes: Array) -> tuple[Array, Array]:
        """Return how far points (n,) of a line are displaced, and the 1-sigmas (n,), px."""
        own = [line, *range(len(self.causes) - 3, len(self.causes))]
        variance = np.einsum('ni,ij,nj->n', changes, self.covariance[np.ix_(own, own)], changes)
        return changes @ self.causes[own], np.sqrt(variance)


def _posterior(matrix: Array, off_px: Array, prior_std: Array, std_px: float
               ) -> tuple[Array, Array]:
    """Return the mean and the covariance of causes of distances (n,), by linear regression."""
    normal = matrix.T @ matrix / std_px**2 + np.diag(prior_std**-2.0)
    covariance = np.linalg.inv(normal)
    return np.asarray(covariance @ (matrix.T @ off_px) / std_px**2), np.asarray(covariance)


def _is_off(views: Sequence[_View], common: _Common, line: int, most_sigmas: float) -> bool:
    """
    Return whether the far stretch of a line is off its clicks in both views alike.

    The nearer points must lie on theirs, where there are some.
    """
    far: list[float] = []
    for view in views:
        moved_px, std_px = common.of_line(line, view.changes)
        sigmas = (view.off_px - moved_px) / np.hypot(std_px, common.click_px)
        near, there = sigmas[view.near], sigmas[np.isfinite(sigmas) & view.unresolved]
        if len(there) < _LEAST_CLICKS or len(near) and abs(np.median(near)) > most_sigmas:
            return False
        far.append(float(np.median(there)))
    alike = np.sign(far[0]) == np.sign(far[1]) and min(np.abs(far)) > _OTHER_SHARE * most_sigmas
    return bool(alike and abs(np.mean(far)) > most_sigmas)
