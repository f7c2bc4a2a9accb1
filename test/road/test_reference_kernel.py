# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reference lines: the compiled kernel against plain numpy, and closed forms."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.road.model import drift_matrix
from stereo_speed.road.reference_kernel import along


@pytest.fixture
def kernel(of_kernel):
    """Return one of the two functions."""
    return of_kernel(along)


def test_compiled_reference_lines_equal_plain_ones():
    pytest.importorskip('numba')
    rng = np.random.default_rng(5)
    angles = rng.normal(0, 0.3, (3, 4, 41))
    axes = np.stack([drift_matrix(v) for v in rng.normal(0, 1, (4, 3))])
    args = *angles, axes, rng.normal(0, 9, (4, 3)), 0.7
    for got, wanted in zip(along.compiled()(*args), along.plain(*args), strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-12)


def test_level_circle_in_closed_form(kernel):
    """A radius of 50 m, banked by 0.1 rad: the directions, and the points to Simpson's order."""
    s = np.linspace(-20, 20, 81)
    heading = (s / 50)[None]
    origin = np.array([[1.0, 2, 3]])
    points, frames = kernel(heading, 0 * heading, 0 * heading + 0.1, np.eye(3)[None], origin, 1.0)
    node = s[::2] / 50
    circle = 50 * np.stack([np.sin(node), 1 - np.cos(node), 0 * node], axis=-1)
    np.testing.assert_allclose(points[0], origin + circle, atol=1e-8)
    left = np.stack([-np.sin(node) * np.cos(0.1), np.cos(node) * np.cos(0.1),
                     0 * node + np.sin(0.1)], axis=-1)
    np.testing.assert_allclose(frames[0, :, :, 1], left, atol=1e-12)
    np.testing.assert_allclose(frames[0].transpose(0, 2, 1) @ frames[0],
                               np.broadcast_to(np.eye(3), (41, 3, 3)), atol=1e-12)


def test_grade_in_closed_form(kernel):
    """A straight line that climbs at 0.1 rad, in a frame whose x axis is the camera's z axis."""
    axes = np.array([[0, -1.0, 0], [0, 0, -1], [1, 0, 0]])
    zero = np.zeros((1, 21))
    points, frames = kernel(zero, zero + 0.1, zero, axes[None], np.array([[1.0, 2, 30]]), 2.0)
    s = 2.0 * np.arange(-5, 6)
    np.testing.assert_allclose(
        points[0], np.stack([1 + 0 * s, 2 - np.sin(0.1) * s, 30 + np.cos(0.1) * s], -1),
        atol=1e-12)
    np.testing.assert_allclose(frames[0, 3, :, 0], [0, -np.sin(0.1), np.cos(0.1)], atol=1e-12)
    np.testing.assert_allclose(frames[0, 3, :, 1], [-1, 0, 0], atol=1e-12)
