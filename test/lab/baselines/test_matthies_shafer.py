# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Covariance of triangulation: closed form for parallel cameras, and Monte Carlo."""
from __future__ import annotations

import numpy as np

from stereo_speed.lab.baselines.hartley_sturm import triangulate
from stereo_speed.lab.baselines.matthies_shafer import covariances
from stereo_speed.lab.sim.config import DISTORTED, straight_config
from stereo_speed.lab.sim.scene import SimScene


def test_depth_sigma_equals_the_textbook_formula(parallel):
    depth = np.array([20.0, 40.0, 80.0])
    points = np.column_stack([np.full(3, 0.25), np.zeros(3), depth])  # between the cameras
    sigma = np.sqrt(covariances(parallel, points, 0.5)[:, 2, 2])
    np.testing.assert_allclose(sigma, depth ** 2 / (1800 * 0.5) * 0.5 * np.sqrt(2), rtol=1e-3)


def test_monte_carlo_with_distorted_converging_cameras():
    rig = SimScene(straight_config(rig=DISTORTED)).rig
    rng, n, std = np.random.default_rng(0), 3000, 0.1
    point = np.array([[-1.5, 0.5, 30.0]])
    left, right, _, _ = rig.project(np.repeat(point, n, axis=0))
    found = triangulate(rig, left + std * rng.standard_normal((n, 2)),
                        right + std * rng.standard_normal((n, 2)))
    root = np.linalg.cholesky(covariances(rig, point, std)[0])
    white = np.linalg.solve(root, (found - point).T)
    # The sample covariance of whitened errors is 1 within 5 of its own sigmas, sqrt(2 / n).
    np.testing.assert_allclose(white @ white.T / n, np.eye(3), atol=5 * np.sqrt(2 / n))
