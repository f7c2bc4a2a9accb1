# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Elimination of the relief, against the solution for all unknowns at once."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.tracking.photometry import Equations
from stereo_speed.tracking.pose_equations import without_relief

POSES, NODES, LINES = 6, 4, 2


@pytest.fixture
def images():
    """Return equations of random images for poses, relief and lines."""
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(30, POSES + NODES + LINES))
    return Equations(rows.T @ rows, rows.T @ rng.normal(size=30), -7.0)


def test_elimination_leaves_the_solution_of_all_unknowns(images):
    held = np.linspace(1.0, 3.0, NODES + LINES)
    H = images.H + np.diag(np.append(np.zeros(POSES), held))
    mean, covariance = np.linalg.solve(H, images.right), np.linalg.inv(H)
    alone = without_relief(images, held, NODES)
    poses = np.linalg.solve(alone.H, alone.right)
    np.testing.assert_allclose(poses, mean[:POSES], rtol=1e-9)
    np.testing.assert_allclose(alone.relief(poses), mean[POSES:-LINES], rtol=1e-9)
    np.testing.assert_allclose(alone.relief_variances(np.linalg.inv(alone.H)),
                               np.diag(covariance)[POSES:-LINES], rtol=1e-9)


def test_density_is_that_of_the_eliminated_gaussian():
    """By the integral over one unknown of exp(right x - h x^2 / 2), up to sqrt(2 pi)."""
    one = Equations(np.array([[2.0, 0.5], [0.5, 3.0]]), np.array([1.0, 2.0]), -7.0)
    wanted = -7.0 + 0.5 * 2.0 ** 2 / (3.0 + 1.0) - 0.5 * np.log(3.0 + 1.0)
    assert without_relief(one, np.array([1.0]), 1).log_density == pytest.approx(wanted)
