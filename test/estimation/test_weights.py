# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Weights by hand, and the case in which no weight is possible."""
from __future__ import annotations

import numpy as np
import pytest

from stereo_speed.estimation.weights import (
    DegenerateWeightsError, effective_sample_size, mean_and_covariance, normalise_log_weights)


def test_normalised_by_hand_even_far_below_underflow():
    weights = normalise_log_weights(np.log([1.0, 3.0]) - 5000)
    np.testing.assert_allclose(weights, [0.25, 0.75])


@pytest.mark.parametrize('bad', [[-np.inf, -np.inf], [0.0, np.nan], [0.0, np.inf]])
def test_impossible_weights_are_an_error(bad):
    with pytest.raises(DegenerateWeightsError, match='largest log weight'):
        normalise_log_weights(np.array(bad))


def test_effective_sample_size_of_even_weights_and_a_single_one():
    assert effective_sample_size(np.full(50, 0.02)) == pytest.approx(50)
    assert effective_sample_size(np.eye(50)[3]) == pytest.approx(1)


def test_moments_equal_numpy():
    rng = np.random.default_rng(0)
    states, counts = rng.normal(size=(30, 3)), rng.integers(1, 9, 30)
    mean, cov = mean_and_covariance(counts / counts.sum(), states)
    np.testing.assert_allclose(mean, np.average(states, axis=0, weights=counts))
    np.testing.assert_allclose(cov, np.cov(states.T, fweights=counts, ddof=0))
