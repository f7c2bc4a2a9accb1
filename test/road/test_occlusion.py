# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A parabola seen from 3 m above its near end: points beyond the tangent are hidden."""
from __future__ import annotations

import numpy as np
from stereo_speed.road.fitted import RoadFit
from stereo_speed.road.model import RoadModel, RoadShape
from stereo_speed.road.occlusion import hidden
from stereo_speed.road.problem import Picks, RoadProblem

FRAME = np.array([[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]])


def road(rig, radius_m):
    """Return a road of 80 m over a crest of a radius, with its top in the middle."""
    shape = RoadShape(vertical=1) if np.isfinite(radius_m) else RoadShape()
    model = RoadModel(FRAME, np.array([0, 3.0, 45.0]), 40.0, 2, shape)
    x = np.array([0, 0, 0, 0, -2.0, 2.0, -40.0 / radius_m])[:model.size]
    picks = Picks.of({n: (np.zeros((2, 2)), np.zeros((2, 2))) for n in 'ab'})
    return RoadFit(RoadProblem(rig, picks, model), x, 0.0)


def test_places_beyond_the_tangent_of_a_crest_are_hidden(make_scene):
    """Height h(u) = -u^2 / 2R at a distance u beyond the top, eye 3 m above the top at u = -45."""
    s = np.linspace(-38.0, 30.0, 35)
    got = hidden(road(make_scene().rig, 150.0), 0, False, s)
    u = -s
    tangent = -45.0 + np.sqrt(45.0**2 + 2 * 150.0 * 3.0)
    clear = np.abs(u - tangent) > 8.0
    np.testing.assert_array_equal(got[clear], (u > tangent)[clear])
    assert got.any() and not got.all()


def test_plane_hides_nothing(make_scene):
    assert not hidden(road(make_scene().rig, np.inf), 1, True, np.linspace(-38.0, 38.0, 9)).any()
