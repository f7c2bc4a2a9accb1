# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Vehicles that keep their speed until they brake, beside each onset solved by itself."""
from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp
from stereo_speed.estimation.gaussian import condition, NormalEquations
from stereo_speed.tracking.onset import with_onsets

TIMES_S = np.array([0.0, 0.1, 0.25, 0.3])
RATE, PER_S, STD_MPS2 = 0.3, 0.4, 4.0


def solved(speeds_mps, std_mps, onset=None):
    """Return what measured speeds tell, without an onset, or with the acceleration as the last."""
    n = len(TIMES_S)
    prior = NormalEquations(n + (onset is not None))
    prior.row([0], [1.0], 20.0, 5.0)
    for k, gap_s in enumerate(np.diff(TIMES_S)):
        if onset is not None and k >= onset:
            prior.row([k + 1, k, n], [1.0, -1.0, -gap_s], 0.0, RATE * np.sqrt(gap_s))
        else:
            prior.row([k + 1, k], [1.0, -1.0], 0.0, RATE * np.sqrt(gap_s))
    if onset is not None:
        prior.row([n], [1.0], 0.0, STD_MPS2)
    return condition(prior, np.eye(n) / std_mps ** 2, np.asarray(speeds_mps) / std_mps ** 2)


@pytest.mark.parametrize('speeds_mps', [(20.0, 20.1, 19.2, 18.8), (20.0, 20.2, 20.1, 20.1)])
@pytest.mark.parametrize('std_mps', [0.05, 1.0])
def test_mixture_is_that_of_each_onset_by_itself(speeds_mps, std_mps):
    steady = solved(speeds_mps, std_mps)
    begun = [solved(speeds_mps, std_mps, onset) for onset in range(3)]
    log_shares = np.log([1.0, *PER_S * np.diff(TIMES_S)]) - PER_S * TIMES_S[-1] + [
        one.log_evidence for one in (steady, *begun)]
    weights = np.exp(log_shares - logsumexp(log_shares))
    means = np.array([one.mean[:4] for one in (steady, *begun)])
    mean = weights @ means
    covariance = sum(w * (one.covariance[:4, :4] + np.outer(m - mean, m - mean))
                     for w, m, one in zip(weights, means, (steady, *begun)))
    found = with_onsets(steady, TIMES_S, np.arange(4), RATE, PER_S, STD_MPS2)
    np.testing.assert_allclose(found.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-7, atol=1e-12)
    assert found.log_evidence == pytest.approx(logsumexp(log_shares), abs=1e-8)


def test_newest_speed_is_less_certain_than_without_onsets():
    """Nothing yet shows whether it has begun to brake."""
    steady = solved((20.0,) * 4, 1.0)
    found = with_onsets(steady, TIMES_S, np.arange(4), RATE, PER_S, STD_MPS2)
    assert found.covariance[3, 3] > steady.covariance[3, 3] * 1.03
    assert found.mean[3] == pytest.approx(steady.mean[3], abs=0.05)
