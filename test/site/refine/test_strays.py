# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Found points beside the road, and the last ones of a line that alone show how it goes on."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.road.fitted import RoadFit
from stereo_speed.road.problem import Picks, RoadProblem
from stereo_speed.site.refine.config import RefineConfig
from stereo_speed.site.refine.markings import LocatedLine
from stereo_speed.site.refine.section_model import BAND, Shape
from stereo_speed.site.refine.strays import without_strays

COUNT, STD_PX, WIDTH_M = 12, 0.1, 0.15
LAST = 0  # the farthest point, as lines go with the traffic
X_M = {'left': 1.5, 'right': -2.0}


def lines_of(drawn, off_m, far_m):
    """Return a road, and its lines as found, with points of the left one displaced."""
    points = {}
    for name in ('right', 'left'):
        for right in (0, 1):
            z = np.linspace(far_m.get(name, 45.0), 12.0, COUNT)
            x = np.full(COUNT, X_M[name])
            for (number, view), by_m in off_m.items():
                if name == 'left' and view == right:
                    x[number] += by_m
            at = np.column_stack([x, np.full(COUNT, 3.0), z])
            points[name, right] = drawn.rig.project(at)[right]
    std = np.full(COUNT, STD_PX)
    picks = Picks.of({n: (points[n, 0], points[n, 1]) for n in ('right', 'left')},
                     {n: (std, std) for n in ('right', 'left')})
    fit = RoadFit(RoadProblem(drawn.rig, picks, drawn.fit.problem.model), drawn.fit.x, 0.0)
    shape = Shape(BAND, WIDTH_M, 0.7, 1)
    return fit, {n: tuple(LocatedLine(points[n, r], std, np.zeros(COUNT), shape, 0.1, 99, 99)
                          for r in (0, 1)) for n in ('right', 'left')}


BOTH = {(LAST, 0): 0.06, (LAST, 1): 0.06}  # 1.1 px or 11 sigmas at 45 m, less than the width
SHORTER = {'right': 38.0}  # beyond it, nothing but the left line shows the road


@pytest.mark.parametrize('off_m, far_m, dropped', [
    (BOTH, SHORTER, (0, 0)),
    ({(LAST, 0): -0.06, (LAST, 1): -0.06}, SHORTER, (0, 0)),
    (BOTH, {}, (1, 1)),  # the other line goes on as before
    ({(LAST, 0): 0.06}, SHORTER, (1, 0)),  # one view alone
    ({(LAST, 0): 0.06, (LAST, 1): -0.06}, SHORTER, (1, 1)),
    ({(LAST, 0): 0.2, (LAST, 1): 0.2}, SHORTER, (1, 1)),  # beside the marking
    ({(5, 0): 0.06, (5, 1): 0.06}, SHORTER, (1, 1)),  # in the middle of the line
    ({}, SHORTER, (0, 0))])
def test_points_off_the_road_are_dropped_unless_they_alone_show_it(drawn, off_m, far_m, dropped):
    fit, found = lines_of(drawn, off_m, far_m)
    kept = without_strays(fit, found, RefineConfig())
    assert tuple(COUNT - len(view.uv_px) for view in kept['left']) == dropped
    assert tuple(len(view.uv_px) for view in kept['right']) == (COUNT, COUNT)
    gone = {number for number, _ in off_m} if any(dropped) else set()
    for right, count in enumerate(dropped):
        if count:
            here = np.delete(found['left'][right].uv_px, sorted(gone), axis=0)
            np.testing.assert_array_equal(kept['left'][right].uv_px, here)


def test_line_that_is_mostly_elsewhere_is_dropped(drawn):
    """Seven of its twelve points are off in the right view."""
    fit, found = lines_of(drawn, {(number, 1): 0.3 for number in range(3, 10)}, {})
    assert set(without_strays(fit, found, RefineConfig())) == {'right'}


def test_single_line_has_strays_as_others_do(drawn):
    fit, found = lines_of(drawn, BOTH, {})
    picks = Picks.of({'left': tuple(view.uv_px for view in found['left'])},
                     {'left': tuple(view.std_px for view in found['left'])})
    model = drawn.fit.problem.model
    alone = RoadFit(RoadProblem(drawn.rig, picks, type(model)(
        model.frame, model.centre_m, model.half_length_m, 1)), np.delete(drawn.fit.x, 4), 0.0)
    kept = without_strays(alone, {'left': found['left']}, RefineConfig())
    assert [len(view.uv_px) for view in kept['left']] == [COUNT - 1] * 2
