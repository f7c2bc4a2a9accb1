# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The relief of a front: its functions, and what it is worth."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.lab.sim import simulate, straight_config, VehicleConfig
from stereo_speed.tracking.relief import NODES, relief_basis


def test_basis_interpolates_its_nodes_and_sums_to_one():
    across, down = np.meshgrid(np.linspace(0, 1, NODES[0]), np.linspace(0, 1, NODES[1]))
    at_nodes = relief_basis(np.column_stack([across.ravel(), down.ravel()]))
    np.testing.assert_allclose(at_nodes, np.eye(NODES[0] * NODES[1]), atol=1e-12)
    anywhere = relief_basis(np.random.default_rng(0).uniform(0, 1, (50, 2)))
    np.testing.assert_allclose(anywhere.sum(axis=1), 1.0)


@pytest.mark.slow
def test_a_front_with_relief_is_measured_as_well_as_a_flat_one(drive):
    config = replace(straight_config('55 mph'), vehicles=(VehicleConfig(relief_m=0.05),))
    errors = []
    for seed in range(2):
        sequence = simulate(config, np.random.default_rng(seed))
        _, (result,) = drive(sequence)
        errors.append(result.speed_mps - float(sequence.truth[0]['speed']))
    # On a plane the same passes are 0.1 m/s off.
    assert np.sqrt(np.mean(np.square(errors))) < 0.03, errors
