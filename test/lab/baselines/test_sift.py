# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""SIFT points matched across views and over time."""
from __future__ import annotations

import numpy as np

from stereo_speed.lab.baselines.settings import SiftSettings
from stereo_speed.lab.baselines.sift import match, SiftPoints

RATIO = SiftSettings().most_ratio


def test_points_keep_their_numbers_and_their_positions(parallel, textured):
    first, second = textured(SiftPoints(parallel, SiftSettings()))
    textured.check(first, second, tolerance_px=0.4)


def test_stricter_limits_leave_fewer_matches(parallel, textured):
    usual = textured(SiftPoints(parallel, SiftSettings()))[0]
    for stricter in ({'most_ratio': 0.1}, {'most_epipolar_px': 0.01}, {'least_contrast': 0.1}):
        found = textured(SiftPoints(parallel, SiftSettings(**stricter)))[0]
        assert found.matched.sum() < usual.matched.sum(), stricter


def test_matches_are_mutual_distinct_and_near():
    descriptors = np.eye(4, 128, dtype=np.float32)
    places = np.array([[0.0, 0], [50, 0], [100, 0], [150, 0]])
    _, b = match(places, descriptors, places[::-1], descriptors[::-1], 5.0, RATIO)
    np.testing.assert_array_equal(b, 3 - np.arange(4))
    assert not len(match(places + [8.0, 0], descriptors, places, descriptors, 5.0, RATIO)[0])


def test_similar_keypoint_elsewhere_prevents_a_match():
    one = np.eye(1, 128, dtype=np.float32)
    twins = np.concatenate([one, one])
    elsewhere, here = np.array([[1.0, 0], [4, 0]]), np.array([[1.0, 0], [1.5, 0]])
    assert not len(match(np.zeros((1, 2)), one, elsewhere, twins, 5.0, RATIO)[0])
    assert len(match(np.zeros((1, 2)), one, here, twins, 5.0, RATIO)[0]) == 1


def test_no_keypoints_give_no_matches():
    none, one = np.zeros((0, 128), np.float32), np.eye(1, 128, dtype=np.float32)
    for first, second in ((none, one), (one, none)):
        a, b = match(np.zeros((len(first), 2)), first, np.zeros((len(second), 2)), second,
                     5.0, 1.0)
        assert len(a) == len(b) == 0
