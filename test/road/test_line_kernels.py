# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Lines of a road in both views: compiled kernels against plain numpy, and against the rig."""
from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.distortion import Lens, LENSES
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.line_kernels import (feet_on_lines, in_order, Lines, pixels_of_lines, REACH,
                                            RigViews)
from stereo_speed.road.model import drift_matrix, RoadModel, RoadShape
from stereo_speed.road.problem import DriftPrior, Picks, RoadProblem

K = np.array([[800.0, 0.4, 500.0], [0, 810.0, 390.0], [0, 0, 1]])
RATIONAL = [0.2, -0.1, 1e-3, 2e-4, 0.02, 0.5, -0.08, 0.05, 1e-3, -2e-3, 3e-3, 5e-4]
CALIBRATIONS = {
    'ideal': ('plumb_bob', []),
    'rational': ('rational_polynomial', RATIONAL),
    'fisheye': ('equidistant', [0.01, -0.02, 0.003, -0.001]),
    'tilted': ('rational_polynomial', [0.0] * 12 + [0.01, 0.02]),
    'stretched': ('stretched', [0.9]), 'unstretched': ('stretched', [0.0])}
RIGS = [(lens, lens) for lens in CALIBRATIONS] + [('rational', 'fisheye'), ('ideal', 'stretched')]
COMPILED = [lenses for lenses in RIGS if not {'tilted', 'stretched'} & set(lenses)]
FRAME = np.array([[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]])
# a bend of 60 m radius that climbs and ends beside the camera, partly behind it
MODEL = RoadModel(FRAME, np.array([0, 3.0, 22.0]), 24.0, 2, RoadShape(1, 2), tapered=True)
X = np.array([0.01, -0.02, 0.03, 0.1, -2.0, 1.5, 0.02, -0.03, 0.4, 0.02, 0.01])
DRIFT_RAD = np.array([4e-3, -2e-3, 1e-3])


class Stretched(Lens):
    """A lens model that the kernels do not know, with more coefficients than theirs have."""

    sizes = (1,)
    size = 20
    zeros_are_ideal = True

    def formula(self, xy):
        return xy * self.coefficients[0]


@pytest.fixture(autouse=True)
def stretched(monkeypatch):
    """Add that lens model to the known ones, as another package could."""
    monkeypatch.setitem(LENSES, 'stretched', Stretched)


def rig_of(lenses):
    cameras = []
    for side, lens in zip(('left', 'right'), lenses, strict=True):
        model, coefficients = CALIBRATIONS[lens]
        cameras.append(Camera(side, 1024, 768, K, np.array(coefficients), model))
    return StereoRig(*cameras, drift_matrix(np.array([0.03, 0.01, 0.0])),
                     np.array([-0.5, 0.02, 0.01]))


def lines_at(*roads):
    """Return the lines of roads in the form that the kernels take."""
    return Lines.of(MODEL, np.array(roads), MODEL.reference(np.array(roads)))


def picked(count=40):
    """Return numbers of lines, views and arc lengths of picks, in order along each line."""
    line, right = np.repeat([0, 0, 1, 1], count), np.repeat([False, True, False, True], count)
    return line, right, np.tile(np.linspace(-24.0, 24.0, count), 4)


@pytest.fixture
def feet(of_kernel):
    """Return one of the two functions for feet."""
    return of_kernel(feet_on_lines)


def straight(*across_m):
    """Return the line 3 m below the camera from 50 m to 10 m ahead, one for each place across."""
    z = np.linspace(50.0, 10.0, 41)
    points = np.stack([0 * z, 0 * z + 3, z], axis=-1)[None]
    lateral = np.broadcast_to([1.0, 0, 0], points.shape).copy()
    return Lines(points, lateral, -20.0, 1.0, np.array([across_m]), np.zeros((1, len(across_m))))


@pytest.mark.parametrize('lenses', COMPILED)
def test_compiled_pixels_equal_plain_ones(lenses):
    """For two roads at once, one of which is seen by a rig that has drifted."""
    pytest.importorskip('numba')
    line, right, s_m = picked()
    lines = lines_at(X, X + 0.01)
    views = RigViews.of(rig_of(lenses)).drifted(drift_matrix(np.stack([np.zeros(3), DRIFT_RAD])))
    got, wanted = (one(line, right, s_m, *lines, *views)
                   for one in (pixels_of_lines.compiled(), pixels_of_lines.plain))
    assert got.shape == (2, len(s_m), 2) and np.isnan(got).any() and np.isfinite(got).any()
    np.testing.assert_allclose(got, wanted, rtol=1e-9)


@pytest.mark.parametrize('drift_rad', [np.zeros(3), DRIFT_RAD])
@pytest.mark.parametrize('lenses', COMPILED)
def test_compiled_feet_equal_plain_ones(lenses, drift_rad):
    """For picks a few pixels beside their lines, some of which nothing is near to."""
    pytest.importorskip('numba')
    line, right, s_m = picked()
    lines = lines_at(X)
    views = RigViews.of(rig_of(lenses)).drifted(drift_matrix(drift_rad[None]))
    uv_px = pixels_of_lines.plain(line, right, s_m, *lines, *views)[0]
    uv_px[np.isnan(uv_px)] = 9e3
    uv_px += np.random.default_rng(3).normal(0, 3, uv_px.shape)
    uv_px[7] = np.nan
    got, wanted = (one(line, right, uv_px, *lines, *views)
                   for one in (feet_on_lines.compiled(), feet_on_lines.plain))
    assert wanted[2][7] == 1e3 and not wanted[1][7].any()
    near = np.abs(wanted[2]) < 20
    assert near.any() and not near.all()
    for a, b in zip(got, wanted, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize('lenses', RIGS)
def test_pixels_are_those_of_the_drifted_rig(lenses):
    """The rig projects points that lie on nodes, without interpolation."""
    lines, rig = lines_at(X), rig_of(lenses)
    assert (RigViews.of(rig) is None) == (lenses not in COMPILED)
    nodes = np.arange(5, 76, 5)
    s_m = MODEL.s_m[nodes]
    picks = Picks(('a',), np.zeros((len(s_m), 2)), np.zeros(len(s_m), dtype=np.intp),
                  np.arange(len(s_m)) % 2 == 1, np.ones(len(s_m)))
    problem = RoadProblem(rig, picks, MODEL, DriftPrior.loose(0.01))
    x = np.append(X, DRIFT_RAD)
    got = problem.at(x, s_m)
    points = lines.points_m[0, nodes] + (
        lines.offset_m[0, 0] + lines.taper[0, 0] * s_m)[:, None] * lines.lateral[0, nodes]
    views = rig.drifted(DRIFT_RAD).project(points)[:2]
    wanted = np.where(picks.right[:, None], views[1], views[0])
    seen = np.isfinite(got).all(axis=-1)
    assert seen.sum() > 8
    np.testing.assert_allclose(got[seen], wanted[seen], atol=1e-6)
    other = x + 0.01  # two roads and rigs at once, each with its own
    np.testing.assert_allclose(problem.at(np.stack([other, x]), s_m),
                               np.stack([problem.at(other, s_m), got]), rtol=1e-9)
    assert np.nanmax(np.abs(problem.at(other, s_m) - got)) > 1
    still = RoadProblem(rig, picks, MODEL)
    np.testing.assert_allclose(still.at(X, s_m), problem.at(np.append(X, np.zeros(3)), s_m),
                               rtol=1e-9)


@pytest.mark.parametrize('lenses', RIGS)
def test_feet_of_picks_on_their_lines(lenses):
    """Through any lens, a foot is where the pick was made, and the residual is none."""
    rig, (line, right, s_m) = rig_of(lenses), picked()
    x, drift = np.append(X, DRIFT_RAD), DriftPrior.loose(0.01)

    def problem(uv_px):
        return RoadProblem(rig, Picks(('a', 'b'), uv_px, line, right, np.ones(len(uv_px))), MODEL,
                           drift)
    uv_px = problem(np.zeros((len(s_m), 2))).at(x, s_m)
    seen = np.isfinite(uv_px).all(axis=-1) & (s_m < 15)
    assert seen.sum() > 80
    line, right, s_m = line[seen], right[seen], s_m[seen]
    found = problem(uv_px[seen]).feet(x)
    np.testing.assert_allclose(found.s_m, s_m, atol=1e-4)
    np.testing.assert_allclose(found.residual_px, 0, atol=1e-6)
    beside = problem(uv_px[seen] + 0.5)
    slope = beside.jacobian(x)
    for j, step in enumerate(1e-6 * np.eye(len(x))):
        moved = (beside.rigid(x + step) - beside.rigid(x - step)) / 2e-6
        np.testing.assert_allclose(slope[:, j], moved, rtol=0.01, atol=0.01 * np.abs(moved).max())


def test_kernels_are_not_given_lines_that_are_none():
    picks = Picks(('a', 'b', 'c'), np.zeros((1, 2)), np.array([2]), np.zeros(1, bool), np.ones(1))
    with pytest.raises(ValueError, match='picks of lines 2 to 2, the model has 2'):
        RoadProblem(rig_of(('ideal', 'ideal')), picks, MODEL)


def test_feet_by_hand(feet):
    """On a straight line below the camera; nothing is picked on the other one, or at the right."""
    views = RigViews.of(rig_of(('ideal', 'ideal')))
    lines = straight(0.0, 2.0)
    z = np.array([40.0, 25.5, 12.25])
    uv_px = np.stack([500 + 0.4 * 3 / z + 2, 390 + 810 * 3 / z], axis=-1)  # 2 px to the right
    s_m, normal, residual = feet(np.zeros(3, int), np.zeros(3, bool), uv_px, *lines, *views)
    np.testing.assert_allclose(s_m, 30 - z, atol=1e-3)
    np.testing.assert_allclose(normal, [[-1, 0]] * 3, atol=1e-3)
    np.testing.assert_allclose(residual, -2, atol=1e-5)


def test_feet_are_searched_up_to_a_reach(feet):
    """A pick beyond it has its foot there; picks just beyond the nodes have their own."""
    views, lines = RigViews.of(rig_of(('ideal', 'ideal'))), straight(1.0)
    z = np.array([200.0, 53.0, 8.5])
    uv_px = np.stack([500 + 800 / z, 390 + 810 * 3 / z], axis=-1)
    s_m = feet(np.zeros(3, int), np.zeros(3, bool), uv_px, *lines, *views)[0]
    assert s_m[0] == REACH * -20
    np.testing.assert_allclose(s_m[1:], [-23.0, 21.5], atol=0.02)


def test_feet_of_a_hairpin_are_on_the_leg_of_their_order(feet):
    """A pick on the near leg is 10 px closer to the far one, which its successor lies before."""
    s = np.arange(-20.0, 21.0)
    ahead = 30.0 - np.abs(s)  # to the far end and back, 0.3 m beside
    points = np.stack([0.15 * np.clip(s, -1, 1), 0 * s + 3, ahead], axis=-1)[None]
    lines = Lines(points, np.zeros_like(points), -20.0, 1.0, np.zeros((1, 1)), np.zeros((1, 1)))
    views = RigViews.of(rig_of(('ideal', 'ideal')))
    place = np.array([-15.0, -12, -9, 9, 12, 15])
    uv_px = pixels_of_lines.plain(np.zeros(6, int), np.zeros(6, bool), place, *lines, *views)[0]
    uv_px[1, 0] = uv_px[4, 0]
    s_m = feet(np.zeros(6, int), np.zeros(6, bool), uv_px, *lines, *views)[0]
    np.testing.assert_allclose(s_m, place, atol=0.5)
    alone = feet(np.zeros(1, int), np.zeros(1, bool), uv_px[1:2], *lines, *views)[0]
    np.testing.assert_allclose(alone, 12, atol=0.5)


def test_order_of_picks_determines_the_leg_of_a_hairpin():
    """The second pick is nearer to the last column, but its successor lies before that."""
    cost = np.array([[[0.0, 5, 9, 9], [9, 2, 5, 0], [9, 9, 0, 9]]])
    assert in_order(cost).tolist() == [[0, 1, 2]]
    rng = np.random.default_rng(0)
    cost = rng.uniform(size=(3, 4, 5))
    for group, got in zip(cost, in_order(cost), strict=True):
        ways = [w for w in product(range(5), repeat=4) if list(w) == sorted(w)]
        assert tuple(got) == min(ways, key=lambda w: sum(group[range(4), w]))
