# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Systematic resampling: its defining property, and that it is unbiased."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.estimation.resampling import systematic


@pytest.mark.parametrize('seed', range(5))
def test_each_particle_is_drawn_floor_or_ceil_of_its_share(seed):
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.full(40, 0.3))
    counts = np.bincount(systematic(weights, 200, rng), minlength=40)
    assert counts.sum() == 200
    assert np.all(counts >= np.floor(200 * weights)) and np.all(counts <= np.ceil(200 * weights))


def test_mean_count_is_the_weight_within_monte_carlo():
    rng = np.random.default_rng(7)
    weights = np.array([0.05, 0.55, 0.4])
    runs = 4000
    counts = sum(np.bincount(systematic(weights, 7, rng), minlength=3) for _ in range(runs))
    # A count deviates by less than one draw, so its mean by less than 1 / sqrt(runs) each sigma.
    np.testing.assert_allclose(counts / runs, 7 * weights, atol=4 / np.sqrt(runs))


def test_impossible_particles_are_never_drawn():
    weights = np.array([0.0, 0.5, 0.0, 0.5, 0.0])
    drawn = systematic(weights, 1000, np.random.default_rng(3))
    assert set(drawn) == {1, 3}
