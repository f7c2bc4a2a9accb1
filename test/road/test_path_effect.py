# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The linear effect of a path's errors on speeds, against complete solutions."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stereo_speed.road.path import SplinePath
from stereo_speed.road.path_effect import path_effect, PLACES, seen_stretch
from stereo_speed.site.refine.speed_effect import Setup, speed_error


def bend(curvature, turn=(0.0, 0.0, 0.0), bow_m=0.0):
    """Return a bend that comes from 60 m to 15 m, rotated about its middle and bent."""
    s = np.linspace(0.0, 45.0, 60)
    points = np.stack([np.sin(curvature * s) * s / 2, np.full_like(s, 3.0), 60 - s], axis=-1)
    points[:, 0] += bow_m * (1 - (2 * s / 45 - 1)**2)
    middle = points[30]
    return SplinePath(Rotation.from_rotvec(turn).apply(points - middle) + middle)


@pytest.mark.parametrize('changes', [
    {'turn': (0.0, 0.002, 0.0)}, {'turn': (0.002, 0.0, 0.0)}, {'bow_m': 0.05}])
def test_linear_effect_equals_the_whole_solution(make_scene, changes):
    rig, used, true = make_scene().rig, bend(0.01), bend(0.01, **changes)
    s = np.linspace(0.0, 1.0, PLACES)
    stretch = seen_stretch(rig, true.position(np.linspace(0, true.length_m, 101)))
    at = true.length_m * (stretch[0] + (stretch[1] - stretch[0]) * s)
    there = true.position(at)
    here = used.arc_length(there)
    points = used.position(here)
    effect = path_effect(rig, points, used.frame(here), here)
    got = effect.speed(there - points, at - here)
    wanted = speed_error(Setup(true, rig), Setup(used, rig))
    assert abs(wanted) > 1e-4
    assert got == pytest.approx(wanted, rel=0.25, abs=2e-4)


def test_hardly_visible_path_has_no_effect(make_scene):
    assert seen_stretch(make_scene().rig, np.tile([0.0, 0, -10.0], (20, 1))) is None
