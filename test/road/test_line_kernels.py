# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Lines of a road in both views: compiled kernels against plain numpy, and against the rig."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.line_kernels import feet_on_lines, Lines, pixels_of_lines, Views
from stereo_speed.road.model import drift_matrix, RoadModel, RoadShape
from stereo_speed.road.problem import DriftPrior, Picks, RoadProblem
from stereo_speed.road.reference_kernel import along

K = np.array([[800.0, 0.4, 500.0], [0, 810.0, 390.0], [0, 0, 1]])
LENSES = {
    'ideal': ('plumb_bob', []),
    'rational': ('rational_polynomial', [0.2, -0.1, 1e-3, 2e-4, 0.02, 0.5, -0.08, 0.05]),
    'fisheye': ('equidistant', [0.01, -0.02, 0.003, -0.001]),
    'tilted': ('rational_polynomial', [0.0] * 12 + [0.01, 0.02])}
COMPILED = [name for name in LENSES if name != 'tilted']
FRAME = np.array([[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]])
# a bend of 60 m radius that climbs and ends beside the camera, partly behind it
MODEL = RoadModel(FRAME, np.array([0, 3.0, 22.0]), 24.0, 2, RoadShape(1, 2), tapered=True)
X = np.array([0.01, -0.02, 0.03, 0.1, -2.0, 1.5, 0.02, -0.03, 0.4, 0.02, 0.01])
DRIFT_RAD = np.array([4e-3, -2e-3, 1e-3])


def rig_of(lens):
    model, coefficients = LENSES[lens]
    cameras = [Camera(side, 1024, 768, K, np.array(coefficients), model)
               for side in ('left', 'right')]
    return StereoRig(*cameras, drift_matrix(np.array([0.03, 0.01, 0.0])),
                     np.array([-0.5, 0.02, 0.01]))


def lines_at(*roads):
    """Return the lines of roads in the form that the kernels take."""
    points, frames = MODEL.reference(np.array(roads))
    nodes = MODEL.s_m
    return Lines(points, np.ascontiguousarray(frames[..., 1]), nodes[0], nodes[1] - nodes[0],
                 np.array([x[4:6] for x in roads]), np.array([x[6:8] for x in roads]) / 24.0)


def picked(count=40):
    """Return numbers of lines, views and arc lengths of picks, in order along each line."""
    line, right = np.repeat([0, 0, 1, 1], count), np.repeat([False, True, False, True], count)
    return line, right, np.tile(np.linspace(-24.0, 24.0, count), 4)


@pytest.mark.parametrize('lens', COMPILED)
def test_compiled_pixels_equal_plain_ones(lens):
    """For two roads at once, one of which is seen by a rig that has drifted."""
    pytest.importorskip('numba')
    line, right, s_m = picked()
    lines = lines_at(X, X + 0.01)
    views = Views.of(rig_of(lens)).drifted(drift_matrix(np.stack([np.zeros(3), DRIFT_RAD])))
    got, wanted = (one(line, right, s_m, *lines, *views)
                   for one in (pixels_of_lines.compiled(), pixels_of_lines.plain))
    assert got.shape == (2, len(s_m), 2) and np.isnan(got).any() and np.isfinite(got).any()
    np.testing.assert_allclose(got, wanted, rtol=1e-9)


@pytest.mark.parametrize('lens', COMPILED)
def test_compiled_feet_equal_plain_ones(lens):
    """For picks a few pixels beside their lines, some of which nothing is near to."""
    pytest.importorskip('numba')
    line, right, s_m = picked()
    lines, views = lines_at(X), Views.of(rig_of(lens))
    uv_px = np.nan_to_num(pixels_of_lines.plain(line, right, s_m, *lines, *views)[0], nan=9e3)
    uv_px += np.random.default_rng(3).normal(0, 3, uv_px.shape)
    got, wanted = (one(line, right, uv_px, *lines, *views)
                   for one in (feet_on_lines.compiled(), feet_on_lines.plain))
    for a, b in zip(got, wanted):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize('lens', LENSES)
def test_pixels_are_those_of_the_drifted_rig(lens):
    """The rig projects points that lie on nodes, without interpolation."""
    lines, rig = lines_at(X), rig_of(lens)
    nodes = np.arange(5, 76, 5)
    s_m = MODEL.s_m[nodes]
    picks = Picks(('a',), np.zeros((len(s_m), 2)), np.zeros(len(s_m), dtype=np.intp),
                  np.arange(len(s_m)) % 2 == 1, np.ones(len(s_m)))
    problem = RoadProblem(rig, picks, MODEL, DriftPrior.loose(0.01))
    got = problem.at(np.append(X, DRIFT_RAD), s_m)[0]
    points = lines.points_m[0, nodes] + (
        lines.offset_m[0, 0] + lines.taper[0, 0] * s_m)[:, None] * lines.left[0, nodes]
    views = rig.drifted(DRIFT_RAD).project(points)[:2]
    wanted = np.where(picks.right[:, None], views[1], views[0])
    seen = np.isfinite(got).all(axis=-1)
    assert seen.sum() > 8
    np.testing.assert_allclose(got[seen], wanted[seen], atol=1e-6)


def test_compiled_reference_lines_equal_plain_ones():
    pytest.importorskip('numba')
    rng = np.random.default_rng(5)
    angles = rng.normal(0, 0.3, (3, 4, 41))
    axes = np.stack([drift_matrix(v) for v in rng.normal(0, 1, (4, 3))])
    args = *angles, axes, rng.normal(0, 9, (4, 3)), 0.7
    for got, wanted in zip(along.compiled()(*args), along.plain(*args)):
        np.testing.assert_allclose(got, wanted, atol=1e-12)
