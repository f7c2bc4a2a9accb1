# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The relief of a front: its functions, and its effect."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import cho_factor
from stereo_speed.core.tracker_config import NoiseConfig, SecondConfig, TrackerConfig
from stereo_speed.lab.sim import simulate, straight_config, VehicleConfig
from stereo_speed.tracking.relief import (
    node_variances, node_weights, NODES, NodeSums, relief_basis)


def test_basis_interpolates_its_nodes_and_sums_to_one():
    across, down = np.meshgrid(np.linspace(0, 1, NODES[0]), np.linspace(0, 1, NODES[1]))
    at_nodes = relief_basis(np.column_stack([across.ravel(), down.ravel()]))
    np.testing.assert_allclose(at_nodes, np.eye(NODES[0] * NODES[1]), atol=1e-12)
    anywhere = relief_basis(np.random.default_rng(0).uniform(0, 1, (50, 2)))
    np.testing.assert_allclose(anywhere.sum(axis=1), 1.0)


@pytest.mark.parametrize('dense', [False, True])
def test_sums_over_samples_equal_matrix_products(dense):
    rng = np.random.default_rng(1)
    basis = rng.standard_normal((5, 70)) if dense else np.ascontiguousarray(
        relief_basis(rng.uniform(0, 1, (70, 2))).T)
    weights = rng.uniform(-1, 2, 70)
    np.testing.assert_allclose(NodeSums(basis)(weights), basis @ np.diag(weights) @ basis.T,
                               atol=1e-12)


def test_node_prior_weakens_with_distance_from_the_plane():
    """By hand, with 2 degrees of freedom: 3 / (2 + 1), 3 / (2 + 100)."""
    np.testing.assert_allclose(node_weights(0.04 ** 2 * np.array([1.0, 100.0]), 0.04, 2.0),
                               [1, 3 / 102])
    np.testing.assert_allclose(node_weights(np.array([0.0, 1.0]), 0.04, 1e9), 1.0, atol=1e-5)


def test_relief_far_behind_the_plane_is_found_node_by_node():
    """Each node is seen to 5 cm: one 0.7 m behind, one nearly in the plane, one unseen."""
    seen_m, information = np.array([-0.7, 0.03, 0.0]), np.array([400.0, 400.0, 0.0])
    weights = np.ones(3)
    for _ in range(20):
        whole = information + weights / 0.04 ** 2
        found_m = information * seen_m / whole
        weights = node_weights(np.square(found_m) + 1 / whole, 0.04, 2.0)
    assert found_m[0] < -0.65 and 0 < found_m[1] < 0.5 * seen_m[1]
    assert weights[2] == pytest.approx(1.0)  # unseen parts are unchanged


def test_relief_variances_equal_the_joint_inverse():
    """Against the inverse of the joint information."""
    root = np.random.default_rng(2).standard_normal((9, 9))
    whole = root @ root.T + np.eye(9)
    own, mixed = whole[5:, 5:], whole[5:, :5]
    inverse = np.linalg.inv(whole)
    found = node_variances(
        cho_factor(own, lower=True), np.linalg.solve(own, mixed), inverse[:5, :5])
    np.testing.assert_allclose(found, np.diag(inverse)[5:])


@pytest.mark.slow
def test_fronts_with_relief_are_measured_better_than_as_planes(drive):
    squares = {0.04: 0.0, 0.0001: 0.0}
    for seed in range(4):
        sequence = simulate(
            replace(straight_config('55 mph'), vehicles=(VehicleConfig(relief_m=0.15),)),
            np.random.default_rng(seed))
        for std_m in squares:
            # The error of a plane is so large that the second estimate would reject it.
            config = TrackerConfig(noise=NoiseConfig(relief_std_m=std_m),
                                   second=SecondConfig(enabled=False))
            _, (result,) = drive(sequence, config=config)
            error_mps = result.speed_mps - float(sequence.truth[0]['speed'])
            squares[std_m] += error_mps ** 2
            if std_m == 0.04:
                assert abs(error_mps) < stats.norm.isf(0.0005) * result.speed_std_mps
    assert squares[0.0001] > 4 * squares[0.04]
