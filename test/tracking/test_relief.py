# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The relief of a front: its functions, and what it is worth."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from stereo_speed.core.config import NoiseConfig, TrackerConfig
from stereo_speed.lab.sim import simulate, straight_config, VehicleConfig
from stereo_speed.tracking.relief import NODES, relief_basis


def test_basis_interpolates_its_nodes_and_sums_to_one():
    across, down = np.meshgrid(np.linspace(0, 1, NODES[0]), np.linspace(0, 1, NODES[1]))
    at_nodes = relief_basis(np.column_stack([across.ravel(), down.ravel()]))
    np.testing.assert_allclose(at_nodes, np.eye(NODES[0] * NODES[1]), atol=1e-12)
    anywhere = relief_basis(np.random.default_rng(0).uniform(0, 1, (50, 2)))
    np.testing.assert_allclose(anywhere.sum(axis=1), 1.0)


@pytest.mark.slow
def test_a_front_with_relief_is_measured_within_its_sigma_and_better_than_as_a_plane(drive):
    sequence = simulate(
        replace(straight_config('55 mph'), vehicles=(VehicleConfig(relief_m=0.05),)),
        np.random.default_rng(0))
    errors = []
    for std_m in (0.04, 0.0001):
        config = TrackerConfig(noise=NoiseConfig(relief_std_m=std_m))
        _, (result,) = drive(sequence, config=config)
        errors.append(abs(result.speed_mps - float(sequence.truth[0]['speed'])))
        if std_m == 0.04:
            assert errors[0] < stats.norm.isf(0.0005) * result.speed_std_mps
    assert errors[1] > 2 * errors[0]
