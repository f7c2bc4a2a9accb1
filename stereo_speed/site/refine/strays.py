# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Found points that are not of the road which the others make, as of a rail or a shadow."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .config import RefineConfig
from .markings import Found
from ...core.records import Array
from ...estimation.robust import robust_std
from ...road.fitted import RoadFit

_MOST_DROPPED = 0.5  # share of dropped points from which a line does not belong to the road
LEAST_POINTS = 3  # fewest points of a line in a view


def without_strays(fit: RoadFit, found: Found, config: RefineConfig) -> Found:
    """
    Return the lines without points far off the road, as of a rail, a shadow or behind a crest.

    A line that would lose too many of its points is not a line of this road and is dropped.

    :param fit: road fitted to these lines.
    :param found: lines as found, by name.
    """
    picks, out = fit.problem.picks, dict(found)
    off = np.abs(fit.off) / max(robust_std(fit.off), 1.0)
    on_road = (off < config.stray_sigmas) | _only_witnesses(fit, found, config)
    for number, name in enumerate(fit.names):
        if name in found:
            good = [on_road[picks.of_line(number, right)] for right in (False, True)]
            if all(g.all() for g in good):
                continue
            if any(g.sum() < max((1 - _MOST_DROPPED) * len(g), LEAST_POINTS) for g in good):
                del out[name]
            else:
                left, right = (line.take(g) for line, g in zip(found[name], good))
                out[name] = left, right
    return out


def _only_witnesses(fit: RoadFit, found: Found, config: RefineConfig) -> NDArray[np.bool_]:
    """
    Return the picks (n,) that alone show how the road goes on beyond its other lines.

    What both views show alike there, no farther off than the marking is wide, is rather a change
    of the road that its family lacks, as where a run-off ends, than something beside the marking.
    """
    picks, s_m, off = fit.problem.picks, fit.feet.s_m, fit.off
    out = np.zeros(len(s_m), dtype=bool)
    for line, name in enumerate(fit.names):
        others_m = s_m[picks.line != line]
        if name not in found or not len(others_m):
            continue
        beyond = (s_m < others_m.min()) | (s_m > others_m.max())
        views = [np.flatnonzero(picks.of_line(line, right)) for right in (False, True)]
        for right, (mine, other) in enumerate((views, views[::-1])):
            ordered = other[np.argsort(s_m[other])]
            there = np.interp(s_m[mine], s_m[ordered], off[ordered])
            alike = np.abs(off[mine] - there) < config.stray_sigmas
            width_px = _width_px(fit, line, bool(right), found[name][right].shape.width_m)
            near = np.abs(fit.feet.residual_px[mine]) < width_px
            out[mine] = beyond[mine] & near & alike
    return out


def _width_px(fit: RoadFit, line: int, right: bool, width_m: float) -> Array:
    """Return how wide a line is across its direction at each of its picks (n,) in a view, px."""
    mine = fit.problem.picks.of_line(line, right)
    s_m, normal = fit.feet.s_m[mine], fit.feet.normal[mine]
    sides = fit.seen(fit.points(line, s_m, np.tile([0.0, width_m], (len(s_m), 1))), right)
    return np.asarray(np.abs(np.sum((sides[:, 1] - sides[:, 0]) * normal, axis=-1)))
