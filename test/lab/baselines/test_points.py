# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Points matched across views and over time, and the place of a front from them."""
from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_speed.core.records import StereoPair
from stereo_speed.geometry.camera import Camera
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.baselines.lucas_kanade import flow, FlowPoints, window_px
from stereo_speed.lab.baselines.places import agreeing, displacement, place_of_front
from stereo_speed.lab.baselines.points import Aim, carry, near_quad
from stereo_speed.lab.baselines.sift import match, SiftPoints

DISPARITY, MOVE = np.array([20.0, 0]), np.array([6.5, 4.0])
FRONT = np.array([[200.0, 150], [300, 150], [300, 200], [200, 200]])


def rig():
    k = np.array([[1800.0, 0, 255.5], [0, 1800.0, 191.5], [0, 0, 1]])
    cameras = [Camera(n, 512, 384, k, np.zeros(0), 'plumb_bob') for n in ('left', 'right')]
    return StereoRig(*cameras, np.eye(3), np.array([-0.5, 0, 0]))


def view(shift):
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (384, 512)).astype(np.float32), (0, 0), 2.0)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    move = np.array([[1.0, 0, shift[0]], [0, 1, shift[1]]])
    return np.round(cv2.warpAffine(texture, move, (512, 384), flags=cv2.INTER_CUBIC,
                                   borderMode=cv2.BORDER_REFLECT)).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(('source', 'tolerance'), [(FlowPoints, 0.05), (SiftPoints, 0.4)])
def test_points_keep_their_numbers_and_their_places(source, tolerance):
    points = source(rig())
    still = np.zeros(2)
    pairs = [StereoPair(k, k, k, view(m), view(m - DISPARITY))
             for k, m in enumerate((still, MOVE))]
    first = points.observe(pairs[0], Aim(FRONT, FRONT - DISPARITY + [1.0, 0], FRONT, 2.0))
    second = points.observe(pairs[1], Aim(FRONT + MOVE + 1, FRONT + MOVE - DISPARITY, FRONT, 2.0))
    for found in (first, second):
        assert found.matched.sum() >= 20
        off = (found.left - found.right)[found.matched] - DISPARITY
        assert np.median(np.abs(off)) < tolerance
    _, a, b = np.intersect1d(first.ids, second.ids, return_indices=True)
    assert len(a) >= 15
    assert np.median(np.abs(second.left[b] - first.left[a] - MOVE)) < tolerance


def test_flow_refuses_what_does_not_come_back():
    at = np.array([[100.0, 100.0], [200, 200]])
    there, good = flow(view(np.zeros(2)), np.full((384, 512), 90, np.uint8), at, at, 9)
    assert there.shape == (2, 2) and not good.any()
    assert window_px(10.0) == 9 and window_px(1000.0) == 21


def test_matches_are_mutual_distinct_and_near():
    descriptors = np.eye(4, 128, dtype=np.float32)
    places = np.array([[0.0, 0], [50, 0], [100, 0], [150, 0]])
    a, b = match(places, descriptors, places[::-1], descriptors[::-1], 5.0)
    np.testing.assert_array_equal(b, 3 - a)
    assert len(match(places + [8.0, 0], descriptors, places, descriptors, 5.0)[0]) == 0
    twins = np.concatenate([descriptors[:1], descriptors[:1]])
    assert len(match(places[:1], twins[:1], np.array([[1.0, 0], [4, 0]]), twins, 5.0)[0]) == 0


def test_carry_and_near_quad_by_hand():
    np.testing.assert_allclose(carry(FRONT, FRONT, 2 * FRONT + 3), 2 * FRONT + 3, atol=1e-3)
    inside = near_quad(np.array([[250.0, 175], [305, 175], [320, 175]]), FRONT, 6.0)
    assert inside.tolist() == [True, True, False]


def test_place_of_a_front_despite_outliers():
    rng, normal = np.random.default_rng(1), np.array([0.0, 0, -1])
    points = np.column_stack([rng.uniform(-0.8, 0.8, 40), rng.uniform(-0.3, 0.3, 40),
                              40 + 0.2 * rng.standard_normal(40)])
    points[:6, 2] += 15  # background
    centre = np.array([0.1, -0.2, 40.0])
    found = place_of_front(rig(), points, rig().project(centre[None])[0][0], normal, 0.1)
    assert not found.used[:6].any() and found.used[6:].sum() >= 30
    off = found.mean - centre
    assert off @ np.linalg.solve(found.cov, off) < 16
    assert place_of_front(rig(), points[:2], centre[:2], normal, 0.1) is None


def test_displacement_of_the_same_points():
    rng, normal, way = np.random.default_rng(2), np.array([0.0, 0, -1]), np.array([0.1, 0.2, -4.0])
    before = np.column_stack([rng.uniform(-1, 1, (30, 2)), np.full(30, 40.0)])
    after = before + way + 0.1 * rng.standard_normal(30)[:, None] * normal
    after[:4] += [0, 0, 9.0]
    found = displacement(rig(), before, after, normal, 0.1)
    assert not found.used[:4].any()
    np.testing.assert_allclose(found.mean, way, atol=5 * np.sqrt(np.diag(found.cov)).max())
    assert displacement(rig(), before[:2], after[:2], normal, 0.1) is None


def test_agreeing_tells_how_much_more_the_values_scatter():
    used, scale = agreeing(np.array([0.0, 0.1, -0.1, 9.0]), np.full(4, 0.1))
    assert used.tolist() == [True, True, True, False] and 1 <= scale < 2
