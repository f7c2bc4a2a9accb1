# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The relief of a front: its functions, and what it is worth."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from stereo_speed.core.config import NoiseConfig, SecondConfig, TrackerConfig
from stereo_speed.lab.sim import simulate, straight_config, VehicleConfig
from stereo_speed.tracking.relief import NODES, NodeSums, relief_basis


def test_basis_interpolates_its_nodes_and_sums_to_one():
    across, down = np.meshgrid(np.linspace(0, 1, NODES[0]), np.linspace(0, 1, NODES[1]))
    at_nodes = relief_basis(np.column_stack([across.ravel(), down.ravel()]))
    np.testing.assert_allclose(at_nodes, np.eye(NODES[0] * NODES[1]), atol=1e-12)
    anywhere = relief_basis(np.random.default_rng(0).uniform(0, 1, (50, 2)))
    np.testing.assert_allclose(anywhere.sum(axis=1), 1.0)


@pytest.mark.parametrize('dense', [False, True])
def test_sums_over_samples_are_those_of_matrices(dense):
    rng = np.random.default_rng(1)
    basis = rng.standard_normal((5, 70)) if dense else np.ascontiguousarray(
        relief_basis(rng.uniform(0, 1, (70, 2))).T)
    weights = rng.uniform(-1, 2, 70)
    np.testing.assert_allclose(NodeSums(basis)(weights), basis @ np.diag(weights) @ basis.T,
                               atol=1e-12)


@pytest.mark.slow
def test_fronts_with_relief_are_measured_within_their_sigma_and_better_than_as_planes(drive):
    squares = {0.04: 0.0, 0.0001: 0.0}
    for seed in range(4):
        sequence = simulate(
            replace(straight_config('55 mph'), vehicles=(VehicleConfig(relief_m=0.15),)),
            np.random.default_rng(seed))
        for std_m in squares:
            # A plane is so far off that the second estimate would reject it.
            config = TrackerConfig(noise=NoiseConfig(relief_std_m=std_m),
                                   second=SecondConfig(enabled=False))
            _, (result,) = drive(sequence, config=config)
            error_mps = result.speed_mps - float(sequence.truth[0]['speed'])
            squares[std_m] += error_mps ** 2
            if std_m == 0.04:
                assert abs(error_mps) < stats.norm.isf(0.0005) * result.speed_std_mps
    assert squares[0.0001] > 4 * squares[0.04]
