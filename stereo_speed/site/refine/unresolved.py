# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The far stretches of lines, where a marking is narrower than a pixel.

There it cannot be told from the border of the asphalt, or from a lamp's reflection beside it, a
pixel or two away: either is a band that keeps its distance from the clicks.  A person who has
followed the marking from its near end knows which one it is.
"""
from __future__ import annotations

from dataclasses import replace
from typing import Mapping, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .clicked import Feet
from .markings import Found, LocatedLine
from ..file import PickedLine
from ...core.records import Array
from ...road.fitted import RoadFit

_RESOLVED_PX = 1.0  # width of a marking from which it is seen as one
_LEAST_POINTS = 3  # fewest points of a line in a view


def clicks_where_unresolved(road: RoadFit, clicked: Mapping[str, PickedLine], found: Found,
                            most_sigmas: float) -> Found:
    """
    Return the lines with their clicks in place of far points that contradict these.

    If a point does, all points of its line that do not resolve the marking are replaced, in both
    views. What all lines have in common, such as a rotation of the rig since the clicks, is no
    contradiction.

    :param road: road near the lines, from which distances are counted.
    :param clicked: the lines as clicked, by name.
    :param found: the lines as found; edges stay.
    :param most_sigmas: largest distance of a point from the clicked line, in sigmas of clicks
        combined with the usual distance where markings are resolved.
    """
    bands = {name: [_View.of(road, clicked[name], bool(right), line)
                    for right, line in enumerate(found[name])]
             for name in road.names if name in found and found[name][0].shape.width_m}
    near_px = np.concatenate([np.zeros(1), *(
        np.abs(view.off_px[~view.thin]) for views in bands.values() for view in views)])
    common_px = float(np.nanmedian(near_px))
    out = dict(found)
    for name, views in bands.items():
        if any(view.contradicts(common_px, most_sigmas) for view in views):
            left, right = (view.clicked(common_px) for view in views)
            if min(len(left.s_m), len(right.s_m)) >= _LEAST_POINTS:
                out[name] = left, right
            else:
                del out[name]
    return out


class _View(NamedTuple):
    """
    One line in one view.

    :param line: the line as found.
    :param off_px: (n,) distances of its points from the clicked line, px.
    :param thin: (n,) whether the marking is too narrow there to be resolved.
    :param click_std_px: (n,) 1-sigmas of the clicked line there, px.
    :param clicks: the line as clicked, as far as the marking is too narrow.
    """

    line: LocatedLine
    off_px: Array
    thin: NDArray[np.bool_]
    click_std_px: Array
    clicks: LocatedLine

    @classmethod
    def of(cls, road: RoadFit, clicked: PickedLine, right: bool, line: LocatedLine) -> _View:
        """Return a line in a view; for arguments see :func:`clicks_where_unresolved`."""
        stds = clicked.views_std_px
        clicks_px = clicked.views_px[right]
        # Those of a refined site are more precise, but may have been taken on another day.
        std_px = np.maximum(np.zeros(len(clicks_px)) if stds is None else stds[right],
                            road.problem.prior.pick_std_px)
        clicks, found = (Feet.of(road, clicked.name, right, uv)
                         for uv in (clicks_px, line.uv_px))
        order = np.argsort(clicks.at_m)
        beside_m, there_px = (
            np.interp(found.at_m, clicks.at_m[order], values[order])
            for values in (clicks.off_px / clicks.px_per_m, std_px))
        thin = clicks.px_per_m * line.shape.width_m < _RESOLVED_PX
        return cls(line, found.off_px - beside_m * found.px_per_m,
                   found.px_per_m * line.shape.width_m < _RESOLVED_PX, there_px,
                   replace(line, uv_px=clicks_px[thin], std_px=std_px[thin],
                           s_m=clicks.at_m[thin]))

    def contradicts(self, common_px: float, most_sigmas: float) -> bool:
        """Return whether a point where the marking is too narrow is off the clicked line."""
        std_px = np.sqrt(self.line.std_px**2 + self.click_std_px**2 + common_px**2)
        return bool((np.abs(self.off_px) > most_sigmas * std_px)[self.thin].any())

    def clicked(self, common_px: float) -> LocatedLine:
        """Return the line with its clicks where the marking is too narrow."""
        kept = self.line.take(~self.thin)
        both = replace(
            kept, uv_px=np.concatenate([kept.uv_px, self.clicks.uv_px]),
            std_px=np.append(kept.std_px, np.hypot(self.clicks.std_px, common_px)),
            s_m=np.append(kept.s_m, self.clicks.s_m))
        return both.take(np.argsort(both.s_m))
