# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Lane paths of fitted roads and of surveyed lines."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.road.fitted import RoadFit
from stereo_speed.road.lanes import between, lane_of_paths, lane_of_road
from stereo_speed.road.model import RoadModel
from stereo_speed.road.path import StraightPath
from stereo_speed.road.problem import Picks, RoadProblem

FRAME = np.array([[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]])


@pytest.fixture(scope='module')
def fit(make_scene):
    """Return a straight road with lines at 2 m right and 1.5 m left, as if fitted."""
    rig, model = make_scene().rig, RoadModel(FRAME, np.array([0, 3.0, 40]), 25.0, 2)
    z = np.linspace(60, 20, 12)
    lines = {}
    for name, across in (('right', -2.0), ('left', 1.5)):
        points = np.stack([np.full(12, across), np.full(12, 3.0), z], axis=-1)
        lines[name] = rig.project(points)[:2]
    problem = RoadProblem(rig, Picks.of(lines), model)
    return RoadFit(problem, np.array([0, 0, 0, 0, -2.0, 1.5]), 0.0)


def test_middle_of_two_lines_of_a_road(fit):
    lane = lane_of_road('lane', fit, (0, 1), 20.0)
    assert lane.path.length_m == pytest.approx(40, abs=1e-3) and lane.residual_px < 1e-5
    np.testing.assert_allclose(lane.path.position(0.0), [-0.25, 3, 60], atol=1e-3)
    np.testing.assert_allclose(lane.path.tangent(9.0), [0, 0, -1], atol=1e-9)
    back = lane_of_road('lane', fit, (0, 1), None, reverse=True)
    np.testing.assert_allclose(back.path.position(0.0), [-0.25, 3, 20], atol=1e-3)
    np.testing.assert_allclose(back.heading_std_rad, lane.heading_std_rad, rtol=1e-3)


def test_spacing_and_numbers(fit):
    """The distance of the lines, with a 1-sigma from the covariance of their offsets."""
    assert fit.names == ('right', 'left') and fit.number('left') == 1
    distance, std = fit.spacing(1, 0)
    c = fit.covariance
    assert distance == pytest.approx(3.5)
    assert std == pytest.approx(np.sqrt(c[4, 4] + c[5, 5] - 2 * c[4, 5]))
    assert 0 < std < 0.2


def test_plane_of_the_road(fit):
    plane = fit.plane
    np.testing.assert_allclose(plane.normal, [0, 1, 0], atol=1e-12)
    assert plane.distance_m == pytest.approx(3.0)


def test_middle_of_two_paths(make_scene):
    """Halfway between, with up normal to both; its direction is as certain as the survey."""
    rig = make_scene().rig
    right = StraightPath(np.array([-2.0, 2, 60]), np.array([0.0, 0, -1]), 40.0)
    left = StraightPath(np.array([2.0, 2, 60]), np.array([0.0, 0, -1]), 40.0)
    middle = between(right, left)
    np.testing.assert_allclose(middle.position(10.0), [0, 2, 50], atol=1e-9)
    np.testing.assert_allclose(middle.frame(10.0)[:, 2], [0, -1, 0], atol=1e-9)
    lane = lane_of_paths('lane', (right, left), 25.0, rig, 0.02)
    np.testing.assert_allclose(lane.heading_std_rad, 0.02 * np.sqrt(2) / 40)
    twice = lane_of_paths('lane', (right, left), 25.0, rig, 0.04)
    assert 0 < lane.shape_std < 0.01 and twice.shape_std == pytest.approx(2 * lane.shape_std)
    np.testing.assert_allclose(lane.path.position(10.0), [0, 2, 50], atol=1e-9)
    assert lane_of_paths('one', (left,), None, rig, 0.0).path is left


def test_direction_is_uncertain_by_rotations_about_its_own_axes(make_scene):
    """A path straight ahead turns across by pan and up by tilt; roll turns it about itself."""
    lane = lane_of_paths('one', (StraightPath(
        np.array([0.0, 2, 60]), np.array([0.0, 0, -1]), 40.0, np.array([0.0, -1, 0])),), None,
        make_scene().rig, 0.0)
    tilt, pan, roll = 1e-3, 2e-3, 4e-3
    std = lane.heading_std_by(np.diag([tilt, pan, roll])**2)
    np.testing.assert_allclose(std, [pan, tilt])
    wider = lane.with_heading_std(std).with_heading_std(std)
    np.testing.assert_allclose(wider.heading_std_rad, np.sqrt(2) * std)
    assert wider.path is lane.path


def test_surveyed_lane_has_no_length_errors(make_scene):
    lane = lane_of_paths('one', (StraightPath(np.zeros(3), np.array([0, 0, 1.0]), 40.0),), None,
                         make_scene().rig, 0.0)
    assert lane.scale_std_at(np.array([1.0, 30.0])).tolist() == [0.0, 0.0]
