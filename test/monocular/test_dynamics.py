# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Adaptive dynamics (eq. 15-18): straight and round contours by hand, and a property."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.monocular.distance import DistanceField
from stereo_speed.monocular.dynamics import certainty, contour_rotation, contour_velocity

ROOT10 = np.sqrt(10)


@pytest.fixture()
def straight(maps):
    """Return a field whose contours are the columns: d = x - 99.5."""
    return DistanceField(maps.two_kinds(maps.pixels()[0] - 99.5))


@pytest.mark.parametrize(('velocity', 'rate', 'frames', 'wanted'), [
    ((0, 3), 0.0, 1, (0, 3)),
    ((0, -3), 0.0, 1, (0, -3)),
    ((1, 3), 1.0, 1, (1, 3)),  # already meets it
    ((1, 3), 0.0, 1, (0, ROOT10)),  # turned on to the contour, as far as before
    ((1, -3), 0.0, 1, (0, -ROOT10)),
    ((0.6, 3), -0.6, 1, (-0.6, 3)),
    ((0, 3), 0.5, 2, (0.5, np.sqrt(8.75))),  # 6 px on, 1 px of them aside
    ((0, 0), 0.0, 1, (0, 0)),
    ((2, 0.1), 0.0, 1, (2, 0.1)),  # across the contour: a sharp turn is not followed
    ((2, 0), 2.0, 1, (2, 0)),
], ids=str)
def test_straight_contour_by_hand(straight, velocity, rate, frames, wanted):
    for x in (120.0, 80.25):  # d grows with x on both sides of the boundary
        found = contour_velocity(straight, np.array([[x, 80.0]]), np.array([velocity], float),
                                 np.array([rate]), float(frames))
        np.testing.assert_allclose(found, [wanted], atol=2e-3)


def test_circle_is_followed_all_round(maps):
    """A chord of length v turns by 2 asin(v / 2r), and the tangent with it."""
    field = DistanceField(maps.two_kinds(maps.circle_distance(50.0)))
    radius, speed = 62.0, 4.0
    turn = 2 * np.arcsin(speed / (2 * radius))
    for way in (1, -1):
        point = np.array([[maps.CENTRE[0] + radius, maps.CENTRE[1]]])
        velocity = np.array([[0.0, way * speed]])
        turned, steps = 0.0, round(2 * np.pi / turn)
        for _ in range(steps):
            velocity = contour_velocity(field, point, velocity, np.zeros(1), 1.0)
            assert np.linalg.norm(velocity) == pytest.approx(speed)
            turned += contour_rotation(field, point, point + velocity)[0]
            point = point + velocity
            assert abs(np.hypot(*(point[0] - maps.CENTRE)) - radius) < 0.6
        angle = np.arctan2(*(point[0] - maps.CENTRE)[::-1])
        assert np.degrees(angle) == pytest.approx(way * np.degrees(steps * turn - 2 * np.pi),
                                                  abs=2)
        assert turned == pytest.approx(way * steps * turn, abs=0.1)


def test_circle_approached_at_a_rate(maps):
    """Eq. 15 by the cosine rule: on the circle r + rate, at the distance v."""
    field = DistanceField(maps.two_kinds(maps.circle_distance(50.0)))
    radius, speed, rate = 60.0, 5.0, 1.5
    point = np.array([[maps.CENTRE[0] + radius, maps.CENTRE[1]]])
    found = contour_velocity(field, point, np.array([[rate, np.sqrt(speed ** 2 - rate ** 2)]]),
                             np.array([rate]), 1.0)[0]
    x = ((radius + rate) ** 2 - radius ** 2 - speed ** 2) / (2 * radius)
    np.testing.assert_allclose(found, [x, np.sqrt(speed ** 2 - x ** 2)], atol=0.25)


def test_rotation_equals_that_of_the_tangent(maps, straight):
    field = DistanceField(maps.two_kinds(maps.circle_distance(50.0)))

    def at(degrees):
        turn = np.radians(degrees)
        return maps.CENTRE + 62 * np.stack([np.cos(turn), np.sin(turn)], axis=-1)

    start = np.arange(0, 360, 5.0)
    for step in (5.0, 30.0, -60.0):
        found = np.degrees(contour_rotation(field, at(start), at(start + step)))
        np.testing.assert_allclose(found, step, atol=8)
        assert found.mean() == pytest.approx(step, abs=1e-3)  # the errors cancel all round
    # a tangent has no direction: right across the circle nothing has turned
    np.testing.assert_allclose(np.degrees(contour_rotation(field, at(start), at(start + 180))), 0,
                               atol=8)
    points = np.array([[120.0, 60.0]])
    np.testing.assert_allclose(contour_rotation(straight, points, points + 7.3), 0, atol=1e-6)


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_predicted_contour_is_reached_on_smooth_maps(maps, seed):
    field = DistanceField(maps.smooth_map(seed, blur_px=20.0))
    rng = np.random.default_rng(seed)
    point = rng.uniform((15, 15), (maps.WIDTH - 15, maps.HEIGHT - 15), (4000, 2))
    aside = rng.uniform(-0.4, 0.4, 4000)
    normal = maps.unit_normal(field, point)
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
    speed = rng.uniform(1, 6, (4000, 1))
    velocity = speed * (np.cos(aside)[:, None] * tangent + np.sin(aside)[:, None] * normal)
    rate = speed[:, 0] * np.sin(aside + rng.normal(0, 0.1, 4000))
    moved = contour_velocity(field, point, velocity, rate, 1.0)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=-1), speed[:, 0])
    turned = np.sum(moved * velocity, axis=-1) / speed[:, 0] ** 2
    # where contours are known and bend gently
    certain = [certainty(field.level_and_gradient(p)[1]) == 1 for p in (point, point + moved)]
    sure = certain[0] & certain[1] & (turned > 0.85)
    assert sure.mean() > 0.7
    missed = np.abs(field.level(point + moved) - field.level(point) - rate)[sure]
    kept = np.abs(field.level(point + velocity) - field.level(point) - rate)[sure]
    assert np.median(missed) < 0.02 and np.quantile(missed, 0.95) < 0.15
    assert np.median(kept) > 0.2  # the value without it


def test_motion_on_a_ridge_is_unchanged():
    labels = np.full((60, 80), 128, np.uint8)
    labels[20:41] = 255
    field = DistanceField(labels)
    point, velocity = np.array([[40.0, 30.0]]), np.array([[2.0, 1.0]])
    np.testing.assert_allclose(
        contour_velocity(field, point, velocity, np.array([0.3]), 1.0), velocity)
    assert contour_rotation(field, point, point + velocity) == 0


def test_box_in_the_middle_of_a_bent_lane_rotates_with_it(maps):
    """Both edges of the lane are equally near there, and have the same direction."""
    lane = np.abs(maps.circle_distance(55.0)) - 11
    field = DistanceField(maps.two_kinds(lane))
    turn = np.radians(np.arange(0, 361, 6.0))
    for radius in (55.0, 51.0):  # in the middle, and beside it
        points = maps.CENTRE + radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        found = np.degrees(contour_rotation(field, points[:-1], points[1:]))
        assert found.sum() == pytest.approx(360, abs=20)
        np.testing.assert_allclose(np.cumsum(found), np.arange(6, 361, 6), atol=20)


def test_certainty_by_hand():
    gradient = np.array([[0.0, 0.5], [0.7, 0.0], [0.0, -0.9], [0.6, 0.8], [0.0, 0.0]])
    np.testing.assert_allclose(certainty(gradient), [0, 0.5, 1, 1, 0])
