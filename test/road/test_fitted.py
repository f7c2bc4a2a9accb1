# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What families of roads are worth."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.stats import norm

from stereo_speed.road.fitted import log_any_scale

STD = 0.5


def by_integration(at, std):
    """Return the log evidence of a coefficient seen at ``at`` with ``std``, summed over scales."""
    x = np.linspace(-4, 4, 800001)
    likelihood = norm.pdf(at, x, std)
    scales = [trapezoid(likelihood * norm.pdf(x, 0, scale * STD), x)
              for scale in (1.0, 0.1, 0.01)]
    return np.log(np.mean(scales) / scales[0])


@pytest.mark.parametrize('at', [0.0, 0.004, 0.03, 0.3, 1.2])
def test_evidence_of_any_scale_is_the_integral_over_all(at):
    """Of an estimate that is precise compared with all scales."""
    assert log_any_scale(np.array([at]), np.array([1e-3**2]), np.array([STD])) == pytest.approx(
        by_integration(at, 1e-3), abs=1e-3)


def test_slight_changes_are_hardly_less_probable_than_none():
    """A hundredth of the largest 1-sigma: a factor of 3 is lost to the other scales."""
    one = log_any_scale(np.array([0.005]), np.array([1e-8]), np.array([STD]))
    assert one == pytest.approx(np.log((100 * np.exp(-0.5) + 10 * np.exp(-0.005) + 1) / 3),
                                abs=1e-3)
    assert log_any_scale(np.array([0.005] * 2), np.full(2, 1e-8), np.full(2, STD)
                         ) == pytest.approx(2 * one)


def test_straight_roads_and_arcs_gain_nothing():
    assert log_any_scale(np.zeros(0), np.zeros(0), np.zeros(0)) == 0.0
