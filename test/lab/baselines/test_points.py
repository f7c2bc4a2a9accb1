# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Regions, homographies and epipolar distances of points."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.lab.baselines.points import (
    crop_around, ExpectedFront, near_quad, off_epipolar_px, Points, transfer)

FRONT = np.array([[200.0, 150], [300, 150], [300, 200], [200, 200]])


def test_transfer_by_hand():
    np.testing.assert_allclose(transfer(FRONT, FRONT, 2 * FRONT + 3), 2 * FRONT + 3, atol=1e-3)
    assert transfer(FRONT[:0], FRONT, FRONT).shape == (0, 2)


def test_point_may_lie_outside_a_quad_by_the_slack():
    inside = near_quad(np.array([[250.0, 175], [305, 175], [320, 175]]), FRONT, 6.0)
    assert inside.tolist() == [True, True, False]
    assert near_quad(FRONT[:0], FRONT, 6.0).shape == (0,)


def test_regions_contain_their_corners_and_know_their_origin():
    image = (np.arange(100)[:, None] + np.arange(120)).astype(np.uint8)
    part, origin = crop_around(image, np.array([[40.2, 50.0], [60.0, 70.9]]), 3.0)
    u, v = origin.astype(int)
    np.testing.assert_array_equal(part, image[v:v + part.shape[0], u:u + part.shape[1]])
    assert u <= 37 and v <= 47 and u + part.shape[1] > 63 and v + part.shape[0] > 73
    assert part.flags.c_contiguous
    outside, _ = crop_around(image, np.array([[500.0, 500.0]]), 3.0)
    assert min(outside.shape) >= 2


def test_epipolar_distance_of_parallel_cameras_is_the_row_difference(parallel):
    rng = np.random.default_rng(0)
    left, right = rng.uniform(100, 600, (2, 9, 2))
    np.testing.assert_allclose(off_epipolar_px(parallel, left, right),
                               np.abs(left[:, 1] - right[:, 1]), atol=1e-9)
    assert off_epipolar_px(parallel, left[:0], right[:0]).shape == (0,)


def test_points_can_be_selected():
    right = np.array([[1.0, 2], [np.nan, np.nan], [3, 4]])
    points = Points(np.array([4, 5, 6]), right + 10, right)
    assert points.matched.tolist() == [True, False, True]
    assert points.only(points.matched).ids.tolist() == [4, 6]


def test_width_is_that_in_the_left_view():
    assert ExpectedFront(FRONT, 2 * FRONT, FRONT, 0.0).width_px == pytest.approx(100.0)
