# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The family of roads: shapes worked by hand, and interpolation between nodes."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stereo_speed.road.model import (drift_matrix, NODES, RoadModel, RoadShape, rotation,
                                     VERTICAL_CURVE, Weights)

FRAME = np.array([[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]])  # comes nearer, left is right of the image


def model_of(*shape):
    """Make a family around a level road 2 m below the camera."""
    return RoadModel(FRAME, np.array([0, 2.0, 40]), 30.0, 2, RoadShape(*shape))


def test_constant_curvature_is_a_circle():
    """Frames are rotations, and extending the family changes nothing."""
    model = model_of(1)
    x = np.array([0, 0, 0, 0, -1.0, 2.0, 30.0 / 41])
    points, frames = model.reference(x)
    centre = np.array([41.0, 2, 40])  # to the left of travel
    np.testing.assert_allclose(np.linalg.norm(points - centre, axis=-1), 41, atol=1e-5)
    np.testing.assert_allclose(
        frames @ np.swapaxes(frames, -1, -2), np.tile(np.eye(3), (len(points), 1, 1)), atol=1e-12)
    wide, wide_x = model.reshaped(RoadShape(3, 2, 1, 2), x)
    np.testing.assert_allclose(wide.reference(wide_x)[0], points)
    assert model.offsets(x).tolist() == [-1.0, 2.0]
    at = Weights.at(model.s_m, np.array([1.234, -7.0]))(points)
    want = 41 * (1 - np.cos(np.array([1.234, -7.0]) / 41))
    np.testing.assert_allclose(at[:, 0], want, atol=1e-5)


def test_grade_and_crest():
    """A grade climbs by its tangent; a crest adds a parabola; crossfall tilts the left axis."""
    model = model_of(0, 2, 1)
    x = np.zeros(model.size)
    x[-3:] = 0.05, 0.02, -0.03
    points, frames = model.reference(x)
    s = model.s_m
    # height above the middle: the integral of sin(0.05 - 0.03 s / 30)
    want = 30 / 0.03 * (np.cos(0.05 - 0.03 * s / 30) - np.cos(0.05))
    np.testing.assert_allclose(2 - points[:, 1], want, atol=1e-6)
    middle = frames[NODES // 2]
    np.testing.assert_allclose(middle[:, 1] @ [0, -1, 0], np.cos(0.05) * np.sin(0.02), atol=1e-12)
    assert model.tilt(x).tolist() == [0.05, 0.02]
    assert model_of(0, 0, 1).tilt(np.arange(7.0)).tolist() == [0.0, 0.0]


def test_vertical_curve_lies_between_two_grades():
    """24 m long, about 6 m past the middle, from level to 5 % down; angles within it are exact."""
    model = model_of(0, 0, 0, 0, VERTICAL_CURVE)
    x = np.zeros(model.size)
    x[model.places.vertical_curve] = 6 / 30, np.log(24 / 30), -0.05
    s = model.s_m
    grade = np.arcsin(-model.reference(x)[1][:, 1, 0])
    want = -0.05 * (np.clip((s - 6) / 24 + 0.5, 0, 1) - 0.25)
    ends = np.minimum(np.abs(s + 6), np.abs(s - 18)) < s[1] - s[0]
    np.testing.assert_allclose(grade[~ends], want[~ends], atol=1e-12)
    # rounded over two nodes: there the error is an eighth of the change between two nodes
    np.testing.assert_allclose(grade, want, atol=0.05 / 24 * (s[1] - s[0]) / 8 + 1e-12)


@pytest.mark.parametrize('tilt', [0, 2])
def test_built_road_is_near_the_polynomial(tilt):
    """Where it was seen, the heights of both agree within a few mm."""
    model = model_of(min(tilt, 1), tilt, 2)
    x = np.zeros(model.size)
    x[model.places.vertical] = 0.04, -0.02
    shape = RoadShape(min(tilt, 1), tilt, 0, 0, VERTICAL_CURVE)
    seen_m = -20.0, 30.0
    other, y = model.as_built(shape, x, seen_m)
    assert other.shape == shape and len(y) == other.size
    points, want = other.reference(y)[0], model.reference(x)[0]
    seen = (model.s_m > seen_m[0]) & (model.s_m < seen_m[1])
    np.testing.assert_allclose(points[seen], want[seen], atol=0.02)


def test_changing_crossfall_banks_the_left_axis():
    """By the integral of the twist, which is its value at half the length."""
    model = model_of(0, 0, 0, 2)
    x = np.zeros(model.size)
    x[-2:] = 0.06, 0.02
    _, frames = model.reference(x)
    u = model.s_m / 30
    np.testing.assert_allclose(-frames[:, 1, 1], np.sin(0.06 * u + 0.01 * u**2), atol=1e-12)


def test_lines_of_a_tapered_road_diverge_evenly():
    """By its taper at half the length, on either side; reduced families drop it."""
    model, x = model_of(1).reshaped(RoadShape(1), np.array([0, 0, 0, 0, -1.0, 2.0, 0.1]), True)
    x[model.places.tapers] = 0.0, 0.03
    lines = np.array([0, 1, 1])
    np.testing.assert_allclose(model.offsets_at(x, lines, np.array([-30.0, -30.0, 15.0])),
                               [-1.0, 1.97, 2.015])
    again, y = model.reshaped(RoadShape(), x)
    assert again.size == 6 and y.tolist() == [0, 0, 0, 0, -1.0, 2.0]


def test_stacked_roads_equal_the_single_roads():
    model = model_of(2, 2, 1, 1)
    x = np.random.default_rng(0).normal(0, 0.05, (4, model.size))
    points, frames = model.reference(x)
    assert points.shape == (4, NODES, 3) and frames.shape == (4, NODES, 3, 3)
    for one, p, f in zip(x, points, frames):
        alone = model.reference(one)
        np.testing.assert_allclose(alone[0], p, atol=1e-12)
        np.testing.assert_allclose(alone[1], f, atol=1e-12)


def test_rotations_equal_scipy():
    vectors = np.random.default_rng(1).normal(0, 1.0, (5, 3))
    np.testing.assert_allclose(rotation(vectors), Rotation.from_rotvec(vectors).as_matrix(),
                               atol=1e-12)
    np.testing.assert_allclose(rotation(np.zeros((2, 3))), np.tile(np.eye(3), (2, 1, 1)))


def test_drift_equals_that_of_the_rig(make_scene):
    """The matrix maps points to where the rig with the same drift sees them."""
    rig, drift = make_scene().rig, np.array([0.01, -0.02, 0.03])
    points = np.array([[1.0, 2, 30], [-4, 1, 60]])
    np.testing.assert_allclose(rig.to_right(points) @ drift_matrix(drift),
                               rig.drifted(drift).to_right(points), atol=1e-12)


@pytest.mark.parametrize('power', [0, 1, 2, 3])
def test_cubics_are_interpolated_exactly(power):
    """Between the nodes and a little beyond."""
    nodes = np.linspace(-33, 33, NODES)
    s = np.array([-34.0, -33.0, 0.1, 12.34, 33.0, 33.5])
    values = np.tile(((nodes / 33)**power)[:, None], 3)
    np.testing.assert_allclose(Weights.at(nodes, s)(values)[:, 0], (s / 33)**power, atol=1e-10)
